"""The places of running instances: a Unix socket each, in a folder of their user, and the folders of a service."""

from __future__ import annotations

import os
import socket
import stat
import struct
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from stadimeter.errors import ControlError

# The kernel takes no longer path of a socket.
ENDING = ".sock"
PATH_MAX_BYTES = 107

# Where the service of deploy/ listens. Only root and systemd can make it, so that its owner can be believed.
SERVICE_FOLDER = Path("/run/stadimeter")

# Where other runs of root listen. Among the temporary files, any user could make the folder first.
ROOT_FOLDER = Path("/run/stadimeter-root")


def runtime_folder(environ: Mapping[str, str] = os.environ) -> Path:
    """Return the folder in which an instance listens.

    Returns:
        ``$RUNTIME_DIRECTORY``, which systemd makes for a service; else a folder in ``$XDG_RUNTIME_DIR``, unless
        that belongs to another user, as it may below ``sudo``; else one of our own: for root in ``/run``, for other
        users among the temporary files.
    """
    for_service = runtime_directory(environ)
    if for_service is not None:
        return for_service
    of_user = environ.get("XDG_RUNTIME_DIR")
    if of_user and _owner(Path(of_user)) in {None, os.getuid()}:
        return Path(of_user) / "stadimeter"
    return ROOT_FOLDER if os.getuid() == 0 else Path(tempfile.gettempdir()) / f"stadimeter-{os.getuid()}"


def _owner(folder: Path) -> int | None:
    try:
        return folder.stat().st_uid
    except FileNotFoundError:
        return None


def make_folder(folder: Path) -> Path:
    """Make a folder if it is not there; `ControlError` if that fails, or another user could put a socket there."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise ControlError(f"{folder} cannot be used for a socket: {error.strerror or error}") from error
    return check_folder(folder)


def check_folder(folder: Path) -> Path:
    """See that no other user can replace a socket in a folder; else `ControlError` says who could."""
    try:
        found = folder.lstat()
    except OSError as error:
        raise ControlError(f"{folder} cannot be used for a socket: {error.strerror or error}") from error
    if not stat.S_ISDIR(found.st_mode):
        raise ControlError(f"{folder} cannot be used for a socket: it is no folder")
    if found.st_uid not in trusted_users(folder):
        raise ControlError(f"{folder} cannot be used for a socket: it belongs to another user ({found.st_uid})")
    others_write = found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    if others_write and not found.st_mode & stat.S_ISVTX:  # where it is sticky, each user replaces only their own
        raise ControlError(f"{folder} cannot be used for a socket: others may write there")
    return folder


def trusted_users(folder: Path) -> frozenset[int]:
    """Return the users whose sockets in a folder can be believed: we, root, and in its own folder the service."""
    try:
        service = {SERVICE_FOLDER.lstat().st_uid} if folder == SERVICE_FOLDER else set()
    except OSError:
        service = set()
    return frozenset({os.getuid(), 0, *service})


def socket_path(configuration: Path, folder: Path) -> Path:
    """Return where an instance listens, after the configuration; with the process id if another listens there.

    Raises `ControlError` if the path would be too long.
    """
    path = folder / f"{configuration.stem}{ENDING}"
    if is_alive(path):
        path = folder / f"{configuration.stem}-{os.getpid()}{ENDING}"
    if len(os.fsencode(path)) > PATH_MAX_BYTES:
        raise ControlError(f"{path} is too long for a socket: {PATH_MAX_BYTES} bytes at most")
    return path


def running(environ: Mapping[str, str] = os.environ) -> list[Path]:
    """Return where instances listen that can be asked. Folders of other users are left out."""
    return [path for folder in _folders(environ) for path in _sockets(folder) if is_alive(path)]


def left_since(path: Path) -> list[Path]:
    """Return where instances listened that began after the one at a path, and were killed or lost their power."""
    try:
        began_ns = path.lstat().st_mtime_ns
        sockets = [each for folder in _folders() for each in _sockets(folder) if each.lstat().st_mtime_ns > began_ns]
    except OSError:
        return []
    return [each for each in sockets if not is_alive(each)]


def is_alive(path: Path) -> bool:
    """Check whether a process listens at a socket, also one that we may not ask."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as trial:
        trial.settimeout(1.0)
        try:
            trial.connect(os.fspath(path))
        except (PermissionError, TimeoutError, BlockingIOError):
            return True
        except OSError:
            return False
        return True


def explain_left_out(environ: Mapping[str, str] = os.environ) -> str:
    """Return why a folder in which instances listen was left out, in words; empty if none was."""
    folder = runtime_folder(environ)
    try:
        check_folder(folder)
    except ControlError as error:
        return str(error) if os.path.lexists(folder) else ""
    return ""


def check_peer(path: Path, connection: socket.socket) -> None:
    """Check that a connection leads to an instance of this program, before anything is sent.

    Another local user can listen at any path that is open to them, or put a link to a socket of root there. So the
    folder, the socket and the process that listens must all belong to a user whom we can believe.

    Raises:
        ControlError: It may be another program.
        OSError: The socket is gone.
    """
    folder = check_folder(path.parent.resolve())
    found = path.lstat()
    if not stat.S_ISSOCK(found.st_mode):
        raise ControlError(f"{path}: not asked: it is no socket")
    _pid, listener, _group = struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
    for user in (found.st_uid, listener):
        if user not in trusted_users(folder):
            raise ControlError(f"{path}: not asked: it belongs to another user ({user}), who may pose as the instance")


def _folders(environ: Mapping[str, str] = os.environ) -> Iterable[Path]:
    return dict.fromkeys((runtime_folder(environ), SERVICE_FOLDER))


def _sockets(folder: Path) -> list[Path]:
    try:
        return sorted(check_folder(folder).glob(f"*{ENDING}"))
    except (ControlError, OSError):
        return []


# The folders that systemd makes for a service: its state, which lasts, and its run, in memory -----


# That of the package's service.
SERVICE_STATE = Path("/var/lib/stadimeter")
STATE_ENDING = ".sqlite3"


def state_directory(environ: Mapping[str, str] = os.environ) -> Path | None:
    """Return the first folder of ``$STATE_DIRECTORY``; None outside a service."""
    return _first(environ.get("STATE_DIRECTORY", ""))


def state_file(configuration: Path, environ: Mapping[str, str] = os.environ) -> Path | None:
    """Return the state file of a configuration, named after it; None for a user without a home.

    It is in ``$STATE_DIRECTORY``, which systemd makes for a service; else in ``$XDG_STATE_HOME/stadimeter``, by default
    ``~/.local/state/stadimeter``.
    """
    name = f"{configuration.stem}{STATE_ENDING}"
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


def runtime_directory(environ: Mapping[str, str] = os.environ) -> Path | None:
    """Return the first folder of ``$RUNTIME_DIRECTORY``; None outside a service."""
    return _first(environ.get("RUNTIME_DIRECTORY", ""))


# The endings of what is beside a configuration whose site is certified: the certificate, and what was measured for one
# that is not finished.
CERTIFICATE, PLACEMENTS = ".certificate.json", ".placements.json"


def mounting_places(configuration: Path, environ: Mapping[str, str] = os.environ) -> list[Path]:
    """Return where the saved view of a camera may be: beside the configuration, or where only that can be written."""
    beside, state = configuration.with_suffix(".mounting"), state_directory(environ)
    return [beside, *([state / beside.name] if state is not None else [])]


def _first(folders: str) -> Path | None:
    first = folders.split(":", maxsplit=1)[0]
    return Path(first) if first else None
