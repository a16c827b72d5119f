"""Asking a running instance: for commands of the command line, and for other programs; and the form of an answer."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from msgspec import Struct

from stadimeter.app.places import check_peer, explain_left_out, left_since, running
from stadimeter.errors import ControlError

# A loop that runs answers within a cycle.
ANSWER_WAIT_S = 10.0

CONNECT_WAIT_S = 2.0
HELLO_WAIT_S = 2.0


class Instance(Struct, frozen=True):
    """A running instance.

    Attributes:
        configuration_age_s: How long ago it began to go by its configuration; None if it does not say.
        digest: The SHA-256 of that configuration's text; empty if it does not say.
    """

    socket: Path
    configuration: Path
    pid: int
    configuration_age_s: float | None = None
    digest: str = ""

    def __str__(self) -> str:
        """Return it for people to choose by."""
        return f"{self.configuration} (process {self.pid}, {self.socket})"


def ask(path: Path, op: str, args: Mapping[str, object] | None = None, wait_s: float = ANSWER_WAIT_S) -> Any:
    """Ask a running instance for an operation such as ``ack``.

    Raises `ControlError` if it does not run, may be another user's, does not answer, or refuses.
    """
    return fetch(path, op, args, wait_s)[0]


def fetch(
    path: Path, op: str, args: Mapping[str, object] | None = None, wait_s: float = ANSWER_WAIT_S
) -> tuple[Any, bytes]:
    """Ask as `ask` does, and return the bytes too that are attached to the answer, such as a picture."""
    request = json.dumps({"transaction": op, "op": op, "args": args or {}}).encode() + b"\n"
    try:
        with _connected(path) as connection:
            check_peer(path, connection)
            connection.settimeout(wait_s)
            connection.sendall(request)
            line, attached = _answer(connection)
    except ControlError:
        raise
    except TimeoutError as error:
        raise ControlError(f"{path}: no answer within {wait_s:g} s; does it hang?") from error
    except PermissionError as error:
        raise ControlError(f"{path}: this user may not ask there; try sudo, or the user that runs it") from error
    except OSError as error:
        raise ControlError(f"{path}: no instance listens there: {error.strerror or error}") from error
    return _data(path, line), attached


def find(
    configuration: Path | None = None, sockets: Iterable[Path] | None = None, *, names_others: bool = True
) -> Path:
    """Find the running instance that is meant.

    Without a configuration, the only one. ``sockets`` names where instances may listen; None to look for them.

    Raises:
        ControlError: None runs, or several do, or the one that began last was killed. The message lists those that
            run, unless it is for people who may not know of them.
    """
    found = running() if sockets is None else list(sockets)
    if not found:
        words = "no instance of stadimeter is running; start one with `stadimeter run CONFIG`"
        raise ControlError("; ".join(filter(None, (words, explain_left_out() if names_others else ""))))
    left = left_since(found[0]) if configuration is None and sockets is None and len(found) == 1 else []
    if configuration is None and len(found) == 1 and not left:
        return found[0]
    instances = [instance for path in found if (instance := _try_introduce(path)) is not None]
    meant = [each for each in instances if configuration is None or each.configuration == configuration.resolve()]
    if configuration is not None and len(meant) == 1:
        return meant[0].socket
    listed = "".join(f"\n  {instance}" for instance in meant or instances)
    if configuration is not None and not meant:
        others = f"; these run:{listed or ' none that may be asked'}" if names_others else ""
        raise ControlError(f"{_none(len(found) - len(instances))} with {configuration}{others}")
    words = "several instances run"
    if left:
        words = f"the instance that began last was killed, or had no power ({', '.join(map(str, left))})"
    raise ControlError(f"{words}; say which one with --config or --socket{f':{listed}' if names_others else ''}")


def _none(silent: int) -> str:
    """Say that no instance runs; the configuration of one that does not answer is unknown."""
    if not silent:
        return "no instance runs"
    which = "one that runs does" if silent == 1 else f"{silent} that run do"
    return f"{which} not answer: wait, or end it if it hangs; no other runs"


def describe_reload(taken: Mapping[str, Any]) -> str:
    """Say what became of the rules in a reload, such as ``2 rules kept; changed: near; removed: far``."""
    kept = len(taken["kept"])
    parts = [f"{kept} rule{'' if kept == 1 else 's'} kept"]
    parts += [f"{what}: {', '.join(taken[what])}" for what in ("changed", "added", "removed") if taken[what]]
    return "; ".join(parts)


def introduce(path: Path) -> Instance:
    """Ask an instance who it is; `ControlError` if it does not say."""
    told = ask(path, "hello", wait_s=HELLO_WAIT_S)
    try:
        age_s = told.get("configuration_age_s")
        return Instance(
            path,
            Path(told["configuration"]),
            int(told["pid"]),
            configuration_age_s=None if age_s is None else float(age_s),
            digest=str(told.get("digest", "")),
        )
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ControlError(f"{path}: that is no instance of stadimeter; its answer makes no sense") from error


def _try_introduce(path: Path) -> Instance | None:
    try:
        return introduce(path)
    except ControlError:
        return None


def _connected(path: Path) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        connection.settimeout(CONNECT_WAIT_S)
        connection.connect(os.fspath(path))
    except OSError:
        connection.close()
        raise
    return connection


def _answer(connection: socket.socket) -> tuple[bytes, bytes]:
    """Return the line of an answer, empty where none came, and the bytes behind it."""
    with connection.makefile("rb") as stream:
        line = stream.readline()
        return line, stream.read(_size(line))


def _size(line: bytes) -> int:
    try:
        return attached_bytes(json.loads(line))
    except (ValueError, AttributeError):
        return 0  # it is no answer, which is said of the line


def _data(path: Path, line: bytes) -> Any:
    if not line:
        raise ControlError(f"{path}: it ended before it answered")
    try:
        answer = json.loads(line)
        is_done = answer["status"] == "ok"
    except (ValueError, KeyError, TypeError) as error:
        raise ControlError(f"{path}: that is no instance of stadimeter; its answer makes no sense") from error
    if not is_done:
        raise ControlError(str(answer.get("error", "it refused, and did not say why")))
    return answer.get("data")


# The form of answers on a control socket and the pipe of the workbench process -----------------------
#
# A line says with ``"bytes": N`` that N raw bytes follow it, such as a picture: base64 would cost a third more, and
# time.


# More bytes than this never follow a line.
BYTES_MAX = 64 * 1024 * 1024


def encode_answer(answer: Mapping[str, Any], attached: bytes = b"") -> bytes:
    """Return an answer as it is sent: one line, in ASCII, and the bytes that belong to it."""
    return encode_line(answer, len(attached)) + attached


def encode_line(answer: Mapping[str, Any], attached_bytes: int = 0) -> bytes:
    """Return the line of an answer alone, which says how many bytes will follow it."""
    head = {**answer, "bytes": attached_bytes} if attached_bytes else answer
    return json.dumps(head, separators=(",", ":"), allow_nan=False).encode("ascii") + b"\n"


def attached_bytes(answer: Mapping[str, Any]) -> int:
    """Return the number of bytes that follow a line; `ValueError` if that is no number of bytes that may follow."""
    size = answer.get("bytes", 0)
    if not isinstance(size, int) or isinstance(size, bool) or not 0 <= size <= BYTES_MAX:
        raise ValueError(f"{size!r} bytes cannot follow a line")
    return size
