"""A file that grows by whole records: an old one is kept until there is something new, and none is cut in half."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from contextlib import suppress
from io import FileIO
from pathlib import Path

from stadimeter.errors import JournalError

HEAD_BYTES = 4096
"""So much of a file is looked at to tell whose it is."""


class RecordFile:
    """A file that grows by whole records. The writer of the library ``mcap`` takes it for a file, too.

    What is given to one `write` is written whole or not at all. An old file of that name is replaced by the first
    one, and not before: a run whose camera is missing destroys nothing.

    Args:
        path: The file.
        kind: What it is called in messages, such as ``journal``.
        is_ours: Tells from the first bytes of a file that there is, up to 4 KiB, whether it may be replaced.

    Raises:
        JournalError: It cannot be written, or holds something else than one of that kind.
    """

    def __init__(self, path: Path, kind: str, is_ours: Callable[[bytes], bool]) -> None:
        self._path = path
        self._kind = kind
        self._size = 0
        try:
            self._file = FileIO(path, "r+" if path.exists() and not path.is_dir() else "w+")
        except OSError as error:
            raise JournalError(f"{path}: the {kind} cannot be written: {error.strerror or error}") from error
        if not _may_replace(self._file, is_ours):
            self._file.close()
            raise JournalError(f"{path} holds something else than a {kind}; choose another file")

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
            raise JournalError(f"{self._path}: {reason}; the {self._kind} ends here, intact") from error
        if written != len(data):
            self._drop_fragment()
            raise JournalError(f"{self._path}: the disk is full; the {self._kind} ends here, intact")
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


def _may_replace(file: FileIO, is_ours: Callable[[bytes], bool]) -> bool:
    """Return whether a file is empty, one of ours, or no file that could hold anything, such as a device."""
    if not file.seekable() or not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        return True
    head = file.read(HEAD_BYTES)
    return not head or is_ours(head)
