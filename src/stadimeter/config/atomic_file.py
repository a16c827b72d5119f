"""Writing a file whole or not at all."""

from __future__ import annotations

import fcntl
import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO


def write_atomically(path: Path, data: bytes) -> None:
    """Write or replace a file, or leave what was there as it was: never half a file, not even after a power cut.

    The bytes go to a hidden file beside it, which takes its name once they are on the disk. A cut may leave that hidden
    file behind; the next save uses it again. The file keeps its owner and mode. A link stays a link: the file that it
    leads to is replaced.

    Raises:
        OSError: It cannot be written there.
    """
    path = Path(os.path.realpath(path))
    temporary = path.with_name(f".{path.name}.part")
    with _locked(temporary) as file:
        try:
            file.truncate()
            _take_after(path, file.fileno())
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    _sync_folder(path.parent)


def _locked(path: Path) -> BinaryIO:
    """Open a file for nobody but us, and wait for whoever writes it. It may hold what a cut left there."""
    while True:
        file = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666), "r+b")
        with suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_EX)
        if path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat()):
            return file
        file.close()  # it got its name meanwhile, or was removed


def _take_after(path: Path, descriptor: int) -> None:
    """Give an open file the owner and mode of another, so that whoever could read that one can read this one."""
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
