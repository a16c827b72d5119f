"""A state file seen from outside: whose it is, before SQLite is let near it.

SQLite writes to what it opens, and makes files beside it. So the first bytes are read here, and a file that is not ours
is never opened. Reading them blocks on nothing, whatever has the name: a folder, a pipe or a device is no state file.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Mapping
from contextlib import suppress
from enum import Enum, auto
from itertools import count
from pathlib import Path

from stadimeter.app.service_folders import state_directory
from stadimeter.config.atomic_file import rename_to_free_name
from stadimeter.errors import StateError

# Says whose file it is: ``Stad``.
APPLICATION_ID = 0x53746164

# A full state file has about 2 MiB, with the longest texts ten. What is larger we did not write, and do not read.
SIZE_MAX = 32 * 2**20

ENDING = ".sqlite3"

# What SQLite keeps beside a file.
BESIDE = ("-wal", "-shm", "-journal")

# Where a SQLite file has its application id; see https://www.sqlite.org/fileformat.html#the_database_header.
_HEADER_BYTES = 100
_MAGIC = b"SQLite format 3\0"
_ID_AT = 68

# So many bytes of those by which we know our own may be wrong: a memory card that flips one makes it no stranger's.
_FLIPPED_MAX = 1


class Kind(Enum):
    """What has the name of a state file."""

    NOTHING = auto()
    """No file, or an empty one."""
    OURS = auto()
    """A state file, whole or not."""
    FOREIGN = auto()
    """Something else."""


def kind_of(path: Path) -> Kind:
    """Look at a file, without changing it or waiting for it.

    Raises `StateError` if it is a folder, a pipe or a device, or cannot be looked at: a name too long, a loop of links.
    """
    try:
        header = _header(path)
    except FileNotFoundError:
        return Kind.NOTHING
    except (OSError, ValueError) as error:
        raise StateError(f"{path} cannot be used: {getattr(error, 'strerror', None) or error}") from error
    if not header:
        return Kind.NOTHING
    known = _MAGIC + APPLICATION_ID.to_bytes(4, "big")
    found = header[: len(_MAGIC)] + header[_ID_AT : _ID_AT + 4]
    wrong = sum(here != there for here, there in zip(found, known, strict=False)) + len(known) - len(found)
    return Kind.OURS if wrong <= _FLIPPED_MAX else Kind.FOREIGN


def _header(path: Path) -> bytes:
    if not stat.S_ISREG(path.stat().st_mode):  # before it is opened: that alone resets some devices
        raise ValueError("it is no regular file")
    file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        return os.read(file, _HEADER_BYTES) if stat.S_ISREG(os.fstat(file).st_mode) else b""
    finally:
        os.close(file)


def too_large(path: Path) -> bool:
    """Return whether a state file, or its log, has more bytes than we ever write."""
    for file in (path, *(path.with_name(path.name + ending) for ending in BESIDE)):
        with suppress(FileNotFoundError):  # SQLite removes its log when another process closes the file
            if file.stat().st_size > SIZE_MAX:
                return True
    return False


def put_aside(path: Path, why: str) -> Path:
    """Rename a state file, and what SQLite keeps beside it, such as to ``run.sqlite3.damaged-1``; return that name.

    Raises `StateError` if the folder is read-only, for example.
    """
    try:
        aside = rename_to_free_name(path, (f"{path.name}.{why}-{number}" for number in count(1)))
        for ending in BESIDE:
            with suppress(FileNotFoundError):
                path.with_name(path.name + ending).rename(aside.with_name(aside.name + ending))
    except OSError as error:
        raise StateError(f"{path} cannot be put aside: {error.strerror or error}") from error
    return aside


def state_file(configuration: Path, environ: Mapping[str, str] = os.environ) -> Path | None:
    """Return the state file of a configuration, named after it; None for a user without a home.

    It is in ``$STATE_DIRECTORY``, which systemd makes for a service; else in ``$XDG_STATE_HOME/stadimeter``, by default
    ``~/.local/state/stadimeter``.
    """
    name = f"{configuration.stem}{ENDING}"
    for_service = state_directory(environ)
    if for_service is not None:
        return for_service / name
    of_user = environ.get("XDG_STATE_HOME")
    if of_user:
        return Path(of_user) / "stadimeter" / name
    try:
        return Path.home() / ".local" / "state" / "stadimeter" / name
    except RuntimeError:  # no home
        return None
