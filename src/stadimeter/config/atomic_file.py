"""Writing a file whole or not at all, and appending to one likewise."""

from __future__ import annotations

import errno
import fcntl
import os
import stat
from collections.abc import Iterator, Mapping
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
    places = {path: Path(os.path.realpath(path)) for path in files}
    temporary = {path: place.with_name(f".{place.name}.part") for path, place in places.items()}
    with ExitStack() as closing:
        opened: dict[Path, BinaryIO] = {}
        try:
            for place in places.values():
                _refuse_other_than_file(place)
            for path in sorted(files, key=places.__getitem__):  # every saver's order, so that no two block each other
                opened[path] = closing.enter_context(_open_locked(temporary[path]))
            for path, data in files.items():
                _fill(opened[path], data, like or places[path])
            for path, place in places.items():
                temporary[path].replace(place)
                del opened[path]  # the hidden name is free again: another saver may have it by now
                _sync_folder(place.parent)
        except BaseException:
            for path in opened:
                temporary[path].unlink(missing_ok=True)
            raise


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


def _refuse_other_than_file(path: Path) -> None:
    """Raise `OSError` for what a file would take the place of and that no program could make again."""
    with suppress(FileNotFoundError):
        mode = path.lstat().st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, "it is a directory", str(path))
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "it is no regular file, and is left alone", str(path))


def _fill(file: BinaryIO, data: bytes, like: Path) -> None:
    file.truncate()
    _take_after(like, file.fileno())
    file.write(data)
    file.flush()
    os.fsync(file.fileno())


def _open_locked(path: Path) -> BinaryIO:
    """Open a file that no other saver writes, and wait for one that does. It may hold what a power cut left there."""
    while True:
        file = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666), "r+b")
        try:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(file, fcntl.LOCK_EX)
            # It may have got its final name while we waited, or was removed: its hidden name is free or another's then
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                    return file
        except BaseException:
            file.close()  # else its lock holds up every saver after us
            raise
        file.close()


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
