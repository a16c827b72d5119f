"""Writing a file whole or not at all."""

from __future__ import annotations

import fcntl
import os
import stat
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import BinaryIO


def write_atomically(path: Path, data: bytes, like: Path | None = None) -> None:
    """Write or replace a file, or leave what was there as it was: never half a file, not even after a power cut.

    The bytes go to a hidden file beside it, which takes its name once they are on the disk. A cut may leave that hidden
    file behind; the next save uses it again. The file keeps its owner and mode. A link stays a link: the file that it
    leads to is replaced.

    Args:
        like: The file whose owner and mode it gets; None for those that it has.

    Raises:
        OSError: It cannot be written there.
    """
    _write_all({path: data}, like)


def write_all_atomically(files: Mapping[Path, bytes]) -> None:
    """Write or replace several files, each as `write_atomically` does: all of them, or none if one cannot be written.

    All are on the disk before the first one takes its name. A power cut in the moment between two names leaves the
    first of them new and the others as they were.

    Raises:
        OSError: One of them cannot be written there.
    """
    _write_all(files, None)


def _write_all(files: Mapping[Path, bytes], like: Path | None) -> None:
    places = {path: Path(os.path.realpath(path)) for path in files}
    temporary = {path: place.with_name(f".{place.name}.part") for path, place in places.items()}
    with ExitStack() as closing:
        # Locked in one order by everybody, so that no two savers wait for each other.
        in_order = sorted(files, key=places.__getitem__)
        opened = {path: closing.enter_context(_locked(temporary[path])) for path in in_order}
        try:
            for path, data in files.items():
                _fill(opened[path], data, like or places[path])
            for path, place in places.items():
                temporary[path].replace(place)
                _sync_folder(place.parent)
        except BaseException:
            for each in temporary.values():
                each.unlink(missing_ok=True)
            raise


def _fill(file: BinaryIO, data: bytes, like: Path) -> None:
    file.truncate()
    _take_after(like, file.fileno())
    file.write(data)
    file.flush()
    os.fsync(file.fileno())


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
