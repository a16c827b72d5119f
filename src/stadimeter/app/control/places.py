"""Where running instances listen: a Unix socket each, in a folder that only their user can use."""

from __future__ import annotations

import os
import socket
import stat
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from stadimeter.errors import ControlError

ENDING = ".sock"
PATH_MAX_BYTES = 107
"""The kernel takes no longer path of a socket."""

SERVICE_FOLDER = Path("/run/stadimeter")
"""Where the service of deploy/ listens."""


def runtime_folder(environ: Mapping[str, str] = os.environ) -> Path:
    """Return the folder in which an instance listens.

    Args:
        environ: The environment.

    Returns:
        ``$RUNTIME_DIRECTORY``, which systemd makes for a service; else a folder in ``$XDG_RUNTIME_DIR``; else one of
        the user's own among the temporary files.
    """
    for_service = environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    if for_service:
        return Path(for_service)
    of_user = environ.get("XDG_RUNTIME_DIR")
    if of_user:
        return Path(of_user) / "stadimeter"
    return Path(tempfile.gettempdir()) / f"stadimeter-{os.getuid()}"


def usable_folder(folder: Path) -> Path:
    """Make a folder if it is not there, and see that nobody else can put a socket into it.

    Args:
        folder: The folder.

    Returns:
        The folder.

    Raises:
        ControlError: It cannot be made, or others may write there.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.lstat()
    except OSError as error:
        raise ControlError(f"{folder} cannot be used for a socket: {error.strerror or error}") from error
    is_ours = stat.S_ISDIR(found.st_mode) and found.st_uid in {os.getuid(), 0}
    if not is_ours or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise ControlError(f"{folder} cannot be used for a socket: others may write there")
    return folder


def socket_path(configuration: Path, folder: Path) -> Path:
    """Return where an instance listens.

    Args:
        configuration: Its configuration.
        folder: The folder.

    Returns:
        A path named after the configuration, and after the process too if another instance listens there already.

    Raises:
        ControlError: The path would be too long.
    """
    path = folder / f"{configuration.stem}{ENDING}"
    if is_alive(path):
        path = folder / f"{configuration.stem}-{os.getpid()}{ENDING}"
    if len(os.fsencode(path)) > PATH_MAX_BYTES:
        raise ControlError(f"{path} is too long for a socket: {PATH_MAX_BYTES} bytes at most")
    return path


def running(environ: Mapping[str, str] = os.environ, service_folder: Path = SERVICE_FOLDER) -> list[Path]:
    """Return where instances listen that can be asked.

    Args:
        environ: The environment.
        service_folder: Where the service listens.

    Returns:
        Their sockets, by name.
    """
    folders = dict.fromkeys((runtime_folder(environ), service_folder))
    return [path for folder in folders for path in _sockets(folder) if is_alive(path)]


def is_alive(path: Path) -> bool:
    """Return whether somebody listens at a socket.

    Args:
        path: The socket.

    Returns:
        True also if they listen, and we may not ask them.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as trial:
        trial.settimeout(1.0)
        try:
            trial.connect(os.fspath(path))
        except (PermissionError, TimeoutError, BlockingIOError):
            return True
        except OSError:
            return False
        return True


def _sockets(folder: Path) -> Iterator[Path]:
    try:
        yield from sorted(folder.glob(f"*{ENDING}"))
    except OSError:
        return
