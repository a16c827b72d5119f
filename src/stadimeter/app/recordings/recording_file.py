"""The file under a recording: an old one is kept until there is something new, and no record is cut in half."""

from __future__ import annotations

import os
import stat
import struct
from contextlib import suppress
from io import FileIO
from pathlib import Path

from stadimeter.errors import JournalError

MAGIC = b"\x89MCAP0\r\n"
"""The first bytes of an MCAP file, and its last ones if it was finished."""

LIBRARY = "stadimeter"
"""How the name of the program begins that recordings say they were written by."""

_HEADER = 1
"""The opcode of the first record of an MCAP file."""

LONGEST_HEADER = 4096
"""The first record of an MCAP file is within its first bytes, so many."""


def writer_of(head: bytes) -> str | None:
    """Return what program an MCAP file says that it was written by.

    Args:
        head: The first few kilobytes of the file.

    Returns:
        The program; None if this is no beginning of an MCAP file.
    """
    if not head.startswith(MAGIC):
        return None
    try:
        opcode, _ = struct.unpack_from("<BQ", head, len(MAGIC))
        (profile_length,) = struct.unpack_from("<I", head, len(MAGIC) + 9)
        begin = len(MAGIC) + 13 + profile_length
        (length,) = struct.unpack_from("<I", head, begin)
    except struct.error:
        return None
    return head[begin + 4 : begin + 4 + length].decode(errors="replace") if opcode == _HEADER else None


class RecordingFile:
    """A file that grows by whole records, for the writer of the library ``mcap``.

    What is given to one `write` is written whole or not at all. An old recording of that name is replaced by the first
    one, and not before: a run whose camera is missing destroys nothing.

    Args:
        path: The file.

    Raises:
        JournalError: It cannot be written, or holds something else than a recording of ours.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._size = 0
        try:
            self._file = FileIO(path, "r+" if path.exists() and not path.is_dir() else "w+")
        except OSError as error:
            raise JournalError(f"{path}: the recording cannot be written: {error.strerror or error}") from error
        if not _may_replace(self._file):
            self._file.close()
            raise JournalError(f"{path} holds something else than a recording; choose another file")

    def write(self, data: bytes) -> int:
        """Write some records.

        Args:
            data: The records.

        Returns:
            How many bytes were written: all.

        Raises:
            JournalError: They could not be written whole, for a full disk for example. What was written before is
                intact.
        """
        if self._size == 0:
            self._begin()
        try:
            written = self._file.write(data) if data else 0
        except OSError as error:
            self._drop_fragment()
            reason = error.strerror or str(error)
            raise JournalError(f"{self._path}: {reason}; the recording ends here, intact") from error
        if written != len(data):
            self._drop_fragment()
            raise JournalError(f"{self._path}: the disk is full; the recording ends here, intact")
        self._size += written
        return written

    def tell(self) -> int:
        """Return how many bytes were written."""
        return self._size

    def flush(self) -> None:
        """Do nothing: what was written is with the operating system already."""

    def close(self) -> None:
        """Close the file. May be called any number of times."""
        self._file.close()

    def _begin(self) -> None:
        with suppress(OSError):  # a device or pipe has no beginning to go back to
            self._file.seek(0)
            self._file.truncate()

    def _drop_fragment(self) -> None:
        with suppress(OSError):  # a device or pipe cannot be cut; the reader stops where a record is not whole
            os.ftruncate(self._file.fileno(), self._size)
        self._file.close()


def _may_replace(file: FileIO) -> bool:
    """Return whether a file is empty, a recording of ours, or no file that could hold anything, such as a device."""
    if not file.seekable() or not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        return True
    head = file.read(LONGEST_HEADER)
    return not head or (writer_of(head) or "").startswith(LIBRARY)
