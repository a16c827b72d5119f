"""Reads files that anybody may have made, and says how large each kind may be: the one place for both.

A path from a configuration or a command line may lead to a pipe, which would be waited for; to a device that never
ends, such as ``/dev/zero``; or to gigabytes, named by mistake or to use up the memory. Therefore every such file is
opened without waiting, only a regular one is read, and never more of it than its kind can have.

The bounds of what is in a file, such as the pixels of a picture, stand here too. Together they keep a run of any
command below 300 MB, of which 65 MB are the program itself.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from stadimeter.errors import UnreadableError

CONFIGURATION_MAX_BYTES = 850_000
"""Ten thousand rules fit in. Nothing of that size takes more than 300 MB, or more than some seconds to refuse."""

CAMERA_FILE_MAX_BYTES = 250_000
"""One that `calibrate` writes takes a hundredth of it."""

SECRET_MAX_BYTES = 50_000
"""A password, or the URL of a service."""

CERTIFICATES_MAX_BYTES = 4_000_000
"""The certificates of every public authority take a twentieth of it."""

JSON_MAX_BYTES = 4_000_000
"""A line of a journal, or a message of a recording that is no picture. The longest holds a configuration and its camera
file, with twice their characters where each is escaped; the objects that it is read into are ten times as large."""

CHUNK_MAX_BYTES = 24_000_000
"""A chunk of a recording, decompressed: one second of a run, or one picture of 18 MB."""

PICTURE_MAX_BYTES = 80_000_000
"""25 megapixels without compression take 75 MB."""

PICTURE_MAX_PIXELS = int(os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"])
"""25 million, as `stadimeter.__init__` says to OpenCV. Decoding takes up to 9 bytes for each. Cameras of a Raspberry Pi
have 12 to 16 megapixels."""


def open_untrusted(path: Path) -> BinaryIO:
    """Open a regular file for reading, without waiting for anything.

    Returns:
        The file, which is the caller's to close.

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

    Args:
        most_bytes: How large a file of its kind may be.

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

    Args:
        most_bytes: How large a file of its kind may be.

    Raises:
        UnreadableError: It is not UTF-8, then with the line; or as for `read_untrusted`.
    """
    try:
        return read_untrusted(path, most_bytes).decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise UnreadableError(path, "it is not UTF-8 text", line) from error


def lines_of(file: BinaryIO, most_bytes: int = JSON_MAX_BYTES) -> Iterator[bytes]:
    """Yield the lines of a file, each with the line feed that ends it.

    Args:
        most_bytes: How long a line may be.

    Yields:
        The lines. The last one may have no line feed.

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
    """Return whether there is a regular file, also for a path that there cannot be, of a name that is too long."""
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
