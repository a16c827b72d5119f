"""Files: read as if anybody may have made them, and written whole or not at all."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import secrets
import stat
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from stadimeter.errors import PictureError, UnreadableError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

# Reads files that anybody may have made, and says how large each kind may be: the one place for both ------------------
#
# A path from a configuration or a command line may lead to a pipe, which would be waited for; to a device that
# never ends, such as ``/dev/zero``; or to gigabytes, named by mistake or to use up the memory. Therefore every such
# file is opened without waiting, only a regular one is read, and never more of it than its kind can have.
#
# The bounds of what is in a file, such as the pixels of a picture, stand here too. Together they keep a run of any
# command below 300 MB, of which 65 MB are the program itself.

# Ten thousand rules fit in. Nothing of that size takes more than 300 MB, or more than some seconds to refuse.
CONFIGURATION_MAX_BYTES = 850_000

# One that `calibrate` writes takes a hundredth of it.
CAMERA_FILE_MAX_BYTES = 250_000

# A password, or the URL of a service.
SECRET_MAX_BYTES = 50_000

# The certificates of every public authority take a twentieth of it.
CERTIFICATES_MAX_BYTES = 4_000_000

# A line of a journal, or a message of a recording that is no picture. The longest holds a configuration and its camera
# file, with twice their characters where each is escaped; the objects that it is read into are ten times as large.
JSON_MAX_BYTES = 4_000_000

# A chunk of a recording, decompressed: one second of a run, or one picture of 18 MB.
CHUNK_MAX_BYTES = 24_000_000

# 25 megapixels without compression take 75 MB.
PICTURE_MAX_BYTES = 80_000_000

# 25 million, as `stadimeter.__init__` says to OpenCV. Decoding takes up to 9 bytes for each. Cameras of a Raspberry Pi
# have 12 to 16 megapixels.
PICTURE_MAX_PIXELS = int(os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"])


def open_untrusted(path: Path) -> BinaryIO:
    """Open a regular file for reading, without waiting for anything; the caller closes it.

    Raises:
        UnreadableError: It is not there, not a regular file, or may not be read.
    """
    try:
        mode = path.stat().st_mode  # first, since merely opening some devices does something
        if stat.S_ISREG(mode):
            return open(path, "rb", opener=_without_waiting)
    except (OSError, ValueError) as error:  # a name with a null character is a ValueError
        raise UnreadableError(path, _reason(error)) from error
    raise UnreadableError(path, "it is a folder" if stat.S_ISDIR(mode) else "it is not a regular file")


def read_untrusted(path: Path, most_bytes: int) -> bytes:
    """Read a whole file.

    Raises:
        UnreadableError: It is larger, or as for `open_untrusted`.
    """
    with open_untrusted(path) as file:
        try:
            data = file.read(most_bytes + 1) if os.fstat(file.fileno()).st_size <= most_bytes else None
        except OSError as error:
            raise UnreadableError(path, _reason(error)) from error
    if data is None or len(data) > most_bytes:
        raise UnreadableError(path, f"it is larger than {size_text(most_bytes)}, the most that is read of such a file")
    return data


def read_untrusted_text(path: Path, most_bytes: int) -> str:
    """Read a whole text, as UTF-8 with or without a byte order mark, its lines ended by line feeds.

    Raises:
        UnreadableError: It is not UTF-8, then with the line; or as for `read_untrusted`.
    """
    try:
        return read_untrusted(path, most_bytes).decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        byte = error.object[error.start : error.start + 1]
        kind = f"it has the byte 0x{byte.hex().upper()}, in Windows-1252 {byte.decode('cp1252', 'replace')}"
        kind = "UTF-16" if error.object[:2] in {b"\xff\xfe", b"\xfe\xff"} else kind
        raise UnreadableError(path, f"it is not UTF-8 text ({kind})", line) from error


def lines_of(file: BinaryIO, most_bytes: int = JSON_MAX_BYTES) -> Iterator[bytes]:
    """Yield the lines of a file, each with the line feed that ends it, if there is one.

    Raises:
        UnreadableError: A line is longer, with its number.
    """
    number = 0
    while line := file.readline(most_bytes + 1):
        number += 1
        if len(line) > most_bytes:
            raise UnreadableError(file.name, f"a line is longer than {size_text(most_bytes)}", number)
        yield line


def size_text(count: int) -> str:
    """Write a number of bytes as people do, such as ``4 MB``."""
    return f"{count / 1e6:.0f} MB" if count >= 1e6 else f"{count / 1e3:.0f} kB"


def is_file(path: Path) -> bool:
    """Check whether there is a regular file, also for a path that there cannot be, of a name that is too long."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK)


def _reason(error: OSError | ValueError) -> str:
    if isinstance(error, FileNotFoundError):
        return "there is no such file"
    return (getattr(error, "strerror", None) or str(error)).lower()


# The kinds of pictures that are read.
KINDS = "JPEG, PNG, BMP, TIFF, WebP, PBM, PGM or PPM"

# So much of a file is needed to know its kind: of a TIFF, the first directory.
HEAD_BYTES = 1024

_JPEG_START = b"\xff\xd8"
_PNG_START = b"\x89PNG\r\n\x1a\n"
# libjpeg's warning about the filling that some USB cameras put before the end marker: all pixels are there.
JPEG_FILLED = re.compile(r"[1-8] extraneous bytes before marker 0xd9")

# Numbers of a picture from 0 to 1 may have lights above 1; one from 0 to 255 without a larger number is black.
_SHARE_MAX = 8.0

# The last chunk of a PNG, with the CRC of nothing (Portable Network Graphics specification, 11.2.5).
_PNG_END = b"IEND\xaeB`\x82"

_PICTURE = re.compile(rb"\xff\xd8|\x89PNG\r\n\x1a\n|BM|II\*\0|MM\0\*|RIFF....WEBP|P[1-6]", re.DOTALL)


def is_picture(head: bytes) -> bool:
    """Check whether a file begins as a picture does that can be read here."""
    return bool(_PICTURE.match(head))


# Matroska and WebM, Flash, Ogg, Windows Media, MPEG, video without compression, and H.264 without a container.
_VIDEO = re.compile(rb"\x1aE\xdf\xa3|FLV|OggS|0&\xb2u|\0\0\x01[\xba\xb3]|YUV4MPEG2|\0\0\0\x01|RIFF....AVI ", re.DOTALL)
# HEIC and AVIF, also of several pictures, and raw files of Canon.
_PICTURE_BRANDS = (b"hei", b"hev", b"mif", b"msf", b"avi", b"crx")
# Raw files of cameras: some are TIFFs that state a version of DNG, or begin with a small preview (NewSubfileType 1).
_RAW = re.compile(
    rb"....ftypcrx |II\*\0\x10\0\0\0CR|FUJIFILMCCD-RAW|IIRO|IIU\0"
    rb"|II\*\0.*\x12\xc6\x01\0\x04\0|MM\0\*.*\xc6\x12\0\x01\0\0\0\x04"
    rb"|II\*\0\x08\0\0\0..\xfe\0\x04\0\x01\0\0\0\x01|MM\0\*\0\0\0\x08..\0\xfe\0\x04\0\0\0\x01\0\0\0\x01",
    re.DOTALL,
)


def other_kind(head: bytes) -> str:
    """Return the remedy for a picture of a kind that is not read, by its first bytes; empty for what is none."""
    if _RAW.match(head):
        return "it is a raw file of a camera: convert it to JPEG or 16-bit TIFF"
    if head[4:8] == b"ftyp" and head[8:12].startswith(_PICTURE_BRANDS):
        kind = "AVIF" if head[8:11] == b"avi" else "HEIC, as iPhones write it"
        return f"it is {kind}: convert it to JPEG, or set the telephone to write JPEG (on an iPhone: Most Compatible)"
    kinds = {b"GIF8": "GIF", b"%PDF": "PDF", b"<svg": "SVG", b"\xff\n": "JPEG XL", b"\0\0\0\x0cJXL": "JPEG XL"}
    return next((f"it is {name}: convert it to PNG" for begin, name in kinds.items() if head.startswith(begin)), "")


def is_video(head: bytes) -> bool:
    """Check whether a file begins as a video does. Some telephones store pictures in the container of MP4."""
    is_mp4 = head[4:8] == b"ftyp" and not head[8:12].startswith(_PICTURE_BRANDS)
    return is_mp4 or bool(_VIDEO.match(head))


def holds_video(path: Path) -> bool:
    """Check whether there is a file that begins as a video does."""
    try:
        with open_untrusted(path) as file:
            return is_video(file.read(HEAD_BYTES))
    except OSError:
        return False


def decode_picture(data: bytes) -> NDArray[np.uint8]:
    """Decode a picture as 8 bits a channel, blue first, upright as its EXIF data say, if all of it is there.

    Raises:
        PictureError: It is damaged, too large or no picture; the message goes on after the name of the picture.
    """
    import cv2  # noqa: PLC0415 - most commands read no picture
    import numpy as np  # noqa: PLC0415

    _refuse_damaged(data)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)
    except cv2.error as error:
        if "CV_IO_MAX_IMAGE" in error.err:
            most = f"{PICTURE_MAX_PIXELS / 1e6:.0f} megapixels, the most that is read"
            raise PictureError(f"has more than {most}; make it smaller") from error
        raise PictureError(f"cannot be decoded: {error.err}") from error
    if image is None:
        raise PictureError("is damaged and cannot be decoded; copy it again")
    levels = image if image.dtype == np.uint8 else _in_8_bits(image)
    return np.asarray(levels if levels.ndim > 2 else cv2.cvtColor(levels, cv2.COLOR_GRAY2BGR), np.uint8)


def _in_8_bits(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return a picture of more than 8 bits in 8, or raise `PictureError` if its numbers are no levels.

    Cameras put their 10, 12 or 14 bits into the lower bits of 16, so the largest number says how many there are. One
    that is really so dark in 16 bits gets brighter, which does no harm: outlines are where half of the light is.
    """
    most = float(image.max())
    if image.dtype == "uint16":
        bits = next(each for each in (8, 10, 12, 14, 16) if most < 2**each)
        return (image >> (bits - 8)).astype("uint8")
    if not 0.0 <= float(image.min()) <= most <= 255.0:  # not so with a NaN either
        raise PictureError(
            "holds numbers that are no levels of light from 0 to 1 or 0 to 255; save it with 8 or 16 bits"
        )
    return (image * (255.0 if most < _SHARE_MAX else 1.0)).clip(0.0, 255.0).round().astype("uint8")


def _refuse_damaged(data: bytes) -> None:
    """Raise `PictureError` for a JPEG or PNG of which something is missing; other kinds are not decoded then anyway.

    OpenCV fills in what is missing: the last block, or grey, to the end. Grey at an eighth of the size takes a third to
    a half of the time of decoding, and all of the code is read.
    """
    if data.startswith(_PNG_START) and _PNG_END not in data:
        raise PictureError("is cut short: its end is missing; copy it again")
    if not data.startswith(_JPEG_START):
        return
    import simplejpeg  # noqa: PLC0415 - most commands read no JPEG

    try:
        height_px, width_px, colours, _ = simplejpeg.decode_jpeg_header(data)
        if height_px * width_px <= PICTURE_MAX_PIXELS:  # else OpenCV refuses it without taking the memory
            simplejpeg.decode_jpeg(data, "CMYK" if colours in {"CMYK", "YCCK"} else "GRAY", min_factor=8)
    except ValueError as error:
        if not JPEG_FILLED.search(str(error)):
            raise PictureError(f"is cut short or damaged inside ({error}); copy it again") from error


def sha256_of(text: str) -> str:
    """Return the SHA-256 of a text in hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()


# Writing a file whole or not at all, and appending to one likewise ----------------------------------------------------


def write_atomically(path: Path, data: bytes, like: Path | None = None) -> None:
    """Write or replace a file, or leave what was there as it was: never half a file, not even after a power cut.

    The bytes go to a hidden file beside it, which takes its name once they are on the disk. A cut may leave that hidden
    file behind. The file keeps its owner and mode. A link stays a link: the file that it leads to is replaced.

    Args:
        like: The file whose owner and mode it gets; None for those that it has.

    Raises:
        OSError: It cannot be written there.
    """
    write_all_atomically({path: data}, like)


def write_all_atomically(files: Mapping[Path, bytes], like: Path | None = None) -> None:
    """Write or replace several files, each as `write_atomically` does: all of them, or none if one cannot be written.

    All are on the disk before the first one takes its name. A power cut in the moment between two names leaves the
    first of them new and the others as they were.

    Args:
        like: The file whose owner and mode all get; None for those that they have.

    Raises:
        OSError: One of them cannot be written there.
    """
    places = {Path(os.path.realpath(path)): data for path, data in files.items()}
    hidden = {place: place.with_name(f".{place.name}.{secrets.token_hex(4)}.part") for place in places}
    with ExitStack() as at_end:
        for place in places:
            refuse_other_than_file(place)
        for place, data in places.items():
            at_end.callback(hidden[place].unlink, missing_ok=True)
            with hidden[place].open("xb") as file:
                _take_after(like or place, file.fileno())
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
        for place in places:
            hidden[place].replace(place)
            _sync_folder(place.parent)


def append_whole(path: Path, data: bytes, *, is_lasting: bool) -> None:
    """Append to a file, which is made if need be; a disk that is full leaves it as it was.

    Args:
        is_lasting: Whether to wait until it would survive a power cut.

    Raises:
        OSError: It cannot be written there.
    """
    file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK, 0o640)
    try:
        found = os.fstat(file)
        if not stat.S_ISREG(found.st_mode):
            raise OSError(None, "it is no regular file")
        try:
            while data:
                data = data[os.write(file, data) :]
            if is_lasting:
                os.fdatasync(file)
        except OSError:
            os.ftruncate(file, found.st_size)
            raise
    finally:
        os.close(file)


def holds(path: Path, data: bytes) -> bool:
    """Check whether there is a file with exactly this content."""
    try:
        return path.read_bytes() == data
    except FileNotFoundError:
        return False


def rename_to_free_name(path: Path, names: Iterator[str]) -> Path:
    """Rename a file to the first of some names that is free in its folder; return its new path.

    The name is taken by an empty file first, which the renamed one then replaces. So nothing else is ever replaced, on
    every file system, even if two programs do this at once.

    Args:
        names: Never ends.

    Raises:
        OSError: It cannot be renamed.
    """
    for free in map(path.with_name, names):
        with suppress(FileExistsError):
            os.close(os.open(free, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
            break
    try:
        path.replace(free)
    except OSError:
        free.unlink()
        raise
    return free


def refuse_other_than_file(path: Path) -> None:
    """Raise `OSError` for what a file would take the place of and that no program could make again."""
    with suppress(FileNotFoundError):
        mode = path.lstat().st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, "it is a directory", str(path))
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "it is no regular file, and is left alone", str(path))


def _take_after(path: Path, descriptor: int) -> None:
    """Give an open file the owner and mode of another, so that the same users can read it."""
    with suppress(FileNotFoundError, PermissionError):
        old = path.stat()
        os.fchmod(descriptor, stat.S_IMODE(old.st_mode))
        os.fchown(descriptor, old.st_uid, old.st_gid)


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
