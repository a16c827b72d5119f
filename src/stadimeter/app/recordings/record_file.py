"""A file that grows by whole records. An older one of that name is kept under another, and no record is cut in half.

Losing what was recorded is worse than an untidy folder: a service that crashes is started again at once, with the same
file name, and the record of the crash must survive that. So nothing that holds a record is ever overwritten or deleted.
"""

from __future__ import annotations

import fcntl
import os
import stat
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from io import FileIO
from itertools import count
from pathlib import Path

from stadimeter.config.files import rename_to_free_name
from stadimeter.errors import JournalError

# The length of the beginning of a file that tells whose it is.
HEAD_BYTES = 4096

# Of recordings with pictures.
ENDING = ".mcap"

# The longest file name that Linux takes.
NAME_BYTES_MAX = 255

# Without waiting: the opening of a pipe that has no reader would never end.
_OPENING = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOCTTY | os.O_NONBLOCK


class RecordFile:
    """A file that grows by whole records. The writer of the library ``mcap`` takes it for a file, too.

    The data of one `write` is written whole or not at all. An older file of that name gets another name with the first
    record, and not before: a run whose camera is missing renames nothing. Only the user can read a new file.

    A character device such as ``/dev/null`` will do as well. A pipe will not: its reader could hold up the writer.

    Args:
        kind: Its name in messages, such as ``journal``.
        is_ours: Decides from the first bytes of a file, up to 4 KiB, whether it is of that kind, or may have become
            one if a power cut had not ended it.

    Attributes:
        kept_as: The new name of the older file; None if there was none.

    Raises:
        JournalError: It cannot be written, or holds something else than one of that kind.
    """

    def __init__(self, path: Path, kind: str, is_ours: Callable[[bytes], bool]) -> None:
        self.kept_as: Path | None = None
        self._path = path
        self._kind = kind
        self._is_ours = is_ours
        self._size = 0
        self._is_new = not os.path.lexists(path)
        self._file = self._opened(path)
        self._real_path = Path(os.path.realpath(path))
        if self._is_taken() and not os.access(self._real_path.parent, os.W_OK | os.X_OK):
            self._file.close()
            raise JournalError(f"{path}: the older {kind} cannot be kept: its folder cannot be written")

    def write(self, data: bytes) -> int:
        """Write some records whole; return how many bytes that was. `JournalError` leaves the earlier ones intact."""
        if self._size == 0:
            self._begin()
        try:
            rest = memoryview(data)
            while rest:  # a disk that fills up takes a part of it, and says why with the next part
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            self._drop_fragment()
            raise self._failure(error, f"; the {self._kind} ends here, intact") from error
        self._size += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self._size

    def flush(self) -> None:
        """Do nothing: what was written is with the operating system already."""

    def close(self) -> None:
        """Close the file, and remove one that was made here and is empty. May be called any number of times."""
        if self._is_new and self._size == 0 and not self._file.closed and self._is_still_empty():
            self._path.unlink()
        self._file.close()

    def _is_still_empty(self) -> bool:
        """Check whether the name still stands for our file, and is still empty."""
        ours = os.fstat(self._file.fileno())
        try:
            found = os.lstat(self._path)
        except OSError:
            return False
        return os.path.samestat(ours, found) and found.st_size == 0

    def older_file(self) -> str:
        """Return in words where an older file is now; empty if there was none."""
        return f"{self._path} held an older {self._kind}, which is now {self.kept_as}" if self.kept_as else ""

    def _opened(self, path: Path) -> FileIO:
        try:
            file = FileIO(os.open(path, _OPENING, 0o600), "r+")
            mode = os.fstat(file.fileno()).st_mode
            head = file.read(HEAD_BYTES) if stat.S_ISREG(mode) else b""
        except OSError as error:
            raise self._failure(error, "", f"the {self._kind} cannot be written: ") from error
        if stat.S_ISCHR(mode):
            os.set_blocking(file.fileno(), True)
        elif not stat.S_ISREG(mode) or not (self._is_ours(head) or _holds_nothing(head)):
            file.close()
            raise JournalError(f"{path} holds something else than a {self._kind}; choose another file")
        return file

    def _begin(self) -> None:
        """Take the name for ourselves. Another run may have begun to write there since the file was opened."""
        if not stat.S_ISREG(os.fstat(self._file.fileno()).st_mode):
            return
        self._file.close()
        self._file = self._opened(self._real_path)
        while self._is_taken():
            self._file.close()
            try:
                numbered = (_numbered(self._real_path, number) for number in count(1))
                self.kept_as = rename_to_free_name(self._real_path, numbered)
            except OSError as error:
                raise self._failure(error, "", f"the older {self._kind} cannot be kept: ") from error
            self._file = self._opened(self._real_path)

    def _is_taken(self) -> bool:
        """Check whether the open file holds something, or will: another run that is about to write has locked it."""
        about = os.fstat(self._file.fileno())
        if not stat.S_ISREG(about.st_mode) or about.st_size:
            return about.st_size > 0
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:  # this file system has no locks
            return False
        return os.fstat(self._file.fileno()).st_size > 0

    def _failure(self, error: OSError, after: str = "", before: str = "") -> JournalError:
        return JournalError(f"{self._path}: {before}{error.strerror or error}{after}")

    def _drop_fragment(self) -> None:
        with suppress(OSError):  # a device cannot be cut; the reader stops where a record is not whole
            os.ftruncate(self._file.fileno(), self._size)
        self._file.close()


def _holds_nothing(head: bytes) -> bool:
    """Check whether a file is empty, or has a length only: some file systems leave zeros after a power cut."""
    return not head.strip(b"\0")


def _numbered(path: Path, number: int) -> str:
    stem, ending = path.stem, f"-{number}{path.suffix}"
    while len(stem) > 1 and len(os.fsencode(stem + ending)) > NAME_BYTES_MAX:
        stem = stem[:-1]
    return stem + ending


def delete_old(folder: Path, keep_s: float, folder_bytes: float, names: str = f"*{ENDING}", newest: str = "") -> None:
    """Delete the recordings of a folder that ended longer ago, and the oldest while all together are too large.

    Args:
        names: Which files are meant.
        newest: The one that is being written, however the clock was set meanwhile.
    """
    found = ((file.stat(), file) for file in folder.glob(names))
    newest_first = sorted(found, key=lambda each: (each[1].name != newest, -each[0].st_mtime))
    total_bytes = 0
    for about, file in newest_first:
        total_bytes += about.st_size
        if file.name != newest and (total_bytes > folder_bytes or time.time() - about.st_mtime > keep_s):
            file.unlink(missing_ok=True)


# The first bytes of an MCAP file, and its last ones if it was finished.
MAGIC = b"\x89MCAP0\r\n"

# How the name of the program begins that recordings say they were written by.
LIBRARY = "stadimeter"

# Up to the end of the program's name: before it, an opcode and the lengths of record, profile and name.
HEADER_BYTES_MIN = len(MAGIC) + 1 + 8 + 4 + 4 + len(LIBRARY)

# The opcode of the first record of an MCAP file.
_HEADER = 1


def writer_of(head: bytes) -> str | None:
    """Return the program that an MCAP file says it was written by; None if this is no beginning of one."""
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


def is_ours(head: bytes) -> bool:
    """Check whether a file is a recording of ours, or the beginning of one that a cut ended too early to tell."""
    if len(head) < HEADER_BYTES_MIN:
        return MAGIC.startswith(head[: len(MAGIC)])
    return (writer_of(head) or "").startswith(LIBRARY)
