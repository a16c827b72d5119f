"""Reading one picture from a file."""

from __future__ import annotations

import re
from pathlib import Path

from msgspec import Struct

from stadimeter.config.camera_file import optics_in
from stadimeter.config.untrusted_file import (
    HEAD_BYTES,
    KINDS,
    PICTURE_MAX_BYTES,
    decode_picture,
    is_picture,
    is_video,
    open_untrusted,
    read_untrusted,
)
from stadimeter.core.frame import Image, Optics, Subsampling
from stadimeter.errors import PictureError, UnreadableError

# Endings of the names of pictures in a folder, in lower case.
PICTURE_SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".pbm", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp"})

_JPEG_START = b"\xff\xd8"
_JPEG_LENGTHS = re.compile(rb"\xff+([^\x00\xff])")
_FRAME_HEADERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_SCAN = 0xDA
_BRIGHTNESS_AND_COLOUR = 3


class Picture(Struct, frozen=True, kw_only=True, eq=False):
    """A picture file."""

    image: Image  # 8 bits a channel, blue first, shape ``(height, width, 3)``
    subsampling: Subsampling  # how coarsely the file stores colour
    optics: Optics | None = None  # how the camera was set, if the file says it


def load_picture(path: Path | str) -> Picture:
    """Read a picture as 8 bits a channel, blue first, shape ``(height, width, 3)``.

    Grey pictures get three equal channels, the upper 8 of 16 bits are kept, and transparency is dropped: each pixel
    keeps the colour that is stored for it. A picture whose EXIF data say that the camera was turned is turned upright.

    A JPEG or PNG that was cut short is refused, and a JPEG that is damaged inside. OpenCV would fill the missing part,
    and a target at the edge of that part would be measured.

    Raises:
        PictureError: The file is missing, empty, cut short, not a picture, or larger than is read; the message names it
            and the cause.
    """
    path = Path(path)
    file = _bytes_of(path)
    try:
        image = decode_picture(file)
    except PictureError as error:
        raise PictureError(f"the picture {path} {error}") from error
    return Picture(image=image, subsampling=subsampling_of(file), optics=optics_in(file))


def check_file(path: Path, kind: str) -> bytes:
    """Return the first bytes of a regular file, enough for `is_picture`; `kind` names it in the message.

    Raises:
        PictureError: It is missing, a folder, a device or empty, or may not be looked at.
    """
    try:
        with open_untrusted(path) as file:
            head = file.read(HEAD_BYTES)
    except UnreadableError as error:
        raise PictureError(f"the {kind} {path} cannot be read: {error.reason}") from error
    if not head:
        raise PictureError(f"the {kind} {path} is empty: the file has no bytes")
    return head


def _bytes_of(path: Path) -> bytes:
    # The beginning is looked at before the file is loaded: a video may be named by mistake.
    head = check_file(path, "picture")
    if is_video(head):
        raise PictureError(
            f"this is a video: {path}; `stadimeter measure` takes videos, and `stadimeter snapshot --live"
            f" video,path={path} --count 10 -o FILE.png` takes pictures out of one"
        )
    if not is_picture(head):
        raise PictureError(f"{path} is not a picture of a kind that is read: {KINDS}")
    try:
        return read_untrusted(path, PICTURE_MAX_BYTES)
    except UnreadableError as error:
        raise PictureError(f"the picture {path} cannot be read: {error.reason}") from error


def subsampling_of(data: bytes) -> Subsampling:
    """Find how coarsely a picture file stores colour, from its first bytes up to its pixels.

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
