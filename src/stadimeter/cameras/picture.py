"""Reading one picture from a file, or saying why not."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import simplejpeg

from stadimeter.core.frame import Image
from stadimeter.errors import PictureError

PICTURE_SUFFIXES = frozenset(
    {".avif", ".bmp", ".jp2", ".jpeg", ".jpg", ".pbm", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp"}
)
"""What the name of a picture in a folder ends in, in lower case."""

LARGEST_PX = 64_000_000
"""No camera that a small computer could read has more pixels. Headers are easily damaged, or made to ask for memory."""

_PADDING = re.compile(r"[1-8] extraneous bytes before marker 0xd9")
"""What libjpeg says of the filling that some USB cameras put before the end marker: all pixels are there."""

_JPEG_START = b"\xff\xd8"
_JPEG_END = 0xD9
_JPEG_WITHOUT_LENGTH = (0x01, 0xD8)
# Inside compressed data FF is followed by 00 or by a restart marker, D0 to D7; FF before a marker is padding.
_JPEG_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")
_PNG_START = b"\x89PNG\r\n\x1a\n"


def read_picture(path: Path | str) -> Image:
    """Read a picture as 8 bits a channel, blue first.

    Grey pictures get three equal channels, the upper 8 of 16 bits are kept, and transparency is dropped: each pixel
    keeps the colour that is stored for it. A picture whose EXIF data say that the camera was turned is turned upright.

    A JPEG or PNG that was cut short is refused. OpenCV would fill the missing part with grey, and a target at the edge
    of that part would be measured.

    Args:
        path: The file.

    Returns:
        The picture, shape ``(height, width, 3)``.

    Raises:
        PictureError: The file is missing, empty, cut short, or not a picture; the message names it and the cause.
    """
    path = Path(path)
    data = _bytes_of(path)
    if not _is_whole(data):
        raise PictureError(f"the picture {path} is cut short: its end is missing; copy it again")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise PictureError(f"the picture {path} cannot be decoded: {error.err}") from error
    if image is None:
        raise PictureError(f"the picture {path} is damaged and cannot be decoded; copy it again")
    return np.asarray(image, np.uint8)


def decode_whole_jpeg(data: bytes) -> Image:
    """Decode a JPEG of a stream if all of it is there, and refuse it otherwise.

    Decoders fill in what is missing: with grey, with the last block, or with what was in their buffer, and libjpeg then
    only warns. Looking for the end marker is not enough, since a relay that was interrupted may put one at the end of
    half a picture. So every warning of libjpeg is an error here. Of pictures that were cut anywhere, with or without
    an end marker, all are refused; of those that lack up to 1.5 kB somewhere in the middle, 97 in 100 (the rest of the
    Huffman code then happens to give as many blocks as are needed). TCP loses no bytes in the middle; relays cut.

    Args:
        data: The JPEG.

    Returns:
        The picture, shape ``(height, width, 3)``, blue first.

    Raises:
        PictureError: It is damaged, or not a JPEG.
    """
    try:
        height_px, width_px, *_ = simplejpeg.decode_jpeg_header(data)
        if height_px * width_px > LARGEST_PX:
            raise PictureError(f"a picture of {width_px} × {height_px} pixels is too large")
        image = np.empty((height_px, width_px, 3), np.uint8)
        simplejpeg.decode_jpeg(data, "BGR", buffer=image)
    except ValueError as error:
        if not _PADDING.search(str(error)):
            raise PictureError(f"the picture is damaged: {error}") from error
    return image


def check_file(path: Path, kind: str) -> None:
    """Raise an error unless the path is that of a regular file with something in it.

    Args:
        path: The file.
        kind: What it should be, such as ``picture``; for the message.

    Raises:
        PictureError: It is missing, a folder, a device or empty, or may not be looked at.
    """
    try:
        if path.is_dir():
            raise PictureError(f"{path} is a folder, not a {kind}")
        if not path.exists():
            raise PictureError(f"there is no {kind} {path}")
        if not path.is_file():
            raise PictureError(f"{path} is not a regular file, so it is no {kind}")
        if path.stat().st_size == 0:
            raise PictureError(f"the {kind} {path} is empty: the file has no bytes")
    except OSError as error:
        raise PictureError(f"the {kind} {path} cannot be read: {error.strerror}") from error


def _bytes_of(path: Path) -> bytes:
    check_file(path, "picture")
    try:
        with path.open("rb"):
            pass
        # The signature is looked at before the file is loaded: a video named by mistake may be larger than the memory.
        if not cv2.haveImageReader(str(path)):
            raise PictureError(f"{path} is not a picture of a kind that OpenCV reads")
        return path.read_bytes()
    except OSError as error:
        raise PictureError(f"the picture {path} cannot be read: {error.strerror}") from error


def _is_whole(data: bytes) -> bool:
    if data.startswith(_JPEG_START):
        return _jpeg_has_its_end(data)
    if data.startswith(_PNG_START):
        return _png_has_its_end(data)
    return True  # the decoders of the other kinds refuse files that end early


def _jpeg_has_its_end(data: bytes) -> bool:
    """Walk the segments to the end marker (ITU-T T.81, annex B).

    Looking for the last two bytes is not enough: a thumbnail inside the file has an end marker of its own, and some
    cameras write more after the picture's end.
    """
    at = len(_JPEG_START)
    while marker := _JPEG_MARKER.search(data, at):
        at = marker.end()
        code = data[at - 1]
        if code == _JPEG_END:
            return True
        if code not in _JPEG_WITHOUT_LENGTH:
            at += int.from_bytes(data[at : at + 2], "big")
    return False


def _png_has_its_end(data: bytes) -> bool:
    """Walk the chunks to a complete ``IEND`` (Portable Network Graphics specification, section 5.3)."""
    at = len(_PNG_START)
    while at + 12 <= len(data):
        following = at + 12 + int.from_bytes(data[at : at + 4], "big")
        if data[at + 4 : at + 8] == b"IEND":
            return following <= len(data)
        at = following
    return False
