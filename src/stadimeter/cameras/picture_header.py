"""What the header of a picture says about how its colour is stored."""

from __future__ import annotations

import re

from stadimeter.core.frame import Subsampling

_JPEG_START = b"\xff\xd8"
_JPEG_LENGTHS = re.compile(rb"\xff+([^\x00\xff])")
_FRAME_HEADERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_SCAN = 0xDA
_BRIGHTNESS_AND_COLOUR = 3


def subsampling_of(data: bytes) -> Subsampling:
    """Return how coarsely a picture file stores colour, from its first bytes up to its pixels.

    A JPEG says it in its frame header (ITU-T T.81, B.2.2): how many samples of each component a block has, brightness
    first. Lossy WebP is always 4:2:0. All other kinds store every pixel.
    """
    if data.startswith(_JPEG_START):
        return _of_jpeg(data)
    return "4:2:0" if data.startswith(b"RIFF") and data[12:16] == b"VP8 " else "4:4:4"


def _of_jpeg(data: bytes) -> Subsampling:
    at = len(_JPEG_START)
    while (marker := _JPEG_LENGTHS.match(data, at)) and marker[1][0] != _SCAN:
        at = marker.end()
        if marker[1][0] in _FRAME_HEADERS:
            return _of_frame_header(data[at : at + 17])
        at += int.from_bytes(data[at : at + 2], "big")
    return "4:4:4"


def _of_frame_header(header: bytes) -> Subsampling:
    if len(header) < 17 or header[7] != _BRIGHTNESS_AND_COLOUR:
        return "4:4:4"
    brightness, *colours = (divmod(header[9 + 3 * component], 16) for component in range(3))
    across, down = (max(brightness[axis] // max(colour[axis], 1) for colour in colours) for axis in (0, 1))
    if (across, down) <= (1, 1):
        return "4:4:4"
    return "4:2:2" if (across, down) == (2, 1) else "4:2:0"
