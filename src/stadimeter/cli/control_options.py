"""Options and output of the commands for a running instance."""

from __future__ import annotations

import getpass
import json
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Any

import typer

from stadimeter.app.control.client import ANSWER_WAIT_S, Instance, ask, find, introduced
from stadimeter.app.control.places import running
from stadimeter.app.recordings.recorded_configuration import sha256_of
from stadimeter.config.untrusted_file import CONFIGURATION_MAX_BYTES, read_untrusted_text
from stadimeter.core.words import rounded_duration
from stadimeter.errors import ControlError, UnreadableError

ConfigOption = Annotated[
    Path | None,
    typer.Option("--config", metavar="CONFIG", help="The configuration of the instance, if several run."),
]
SocketOption = Annotated[
    Path | None,
    typer.Option("--socket", metavar="PATH", help="The socket of the instance; by default it is found."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
ByOption = Annotated[
    str | None, typer.Option("--by", metavar="NAME", help="Who gives the command; by default the login name.")
]
WhyOption = Annotated[str, typer.Option("--why", metavar="TEXT", help="Why; it is recorded with the event.")]


def ask_instance(
    op: str,
    args: Mapping[str, object],
    config: Path | None,
    socket: Path | None,
    wait_s: float = ANSWER_WAIT_S,
) -> Any:
    """Ask the running instance: that at a socket, or with a configuration, or the only one."""
    return ask(_place(config, socket), op, args, wait_s)


def ask_and_introduce(
    op: str, args: Mapping[str, object], config: Path | None, socket: Path | None
) -> tuple[Mapping[str, Any], str]:
    """Ask the running instance as `ask_instance` does; return its answer with its name, also as a line for people."""
    place = _place(config, socket)
    instance = introduced(place)
    data = ask(place, op, args)
    told = {
        "configuration": str(instance.configuration),
        "configuration_age_s": instance.configuration_age_s,
        "is_file_changed": (is_changed := _is_file_changed(instance)),
        "pid": instance.pid,
    }
    return {"instance": told, **data}, _in_words(instance, is_changed=is_changed)


def ask_all(op: str, args: Mapping[str, object]) -> Mapping[str, Any]:
    """Ask every running instance at once to stop its outputs; raise `ControlError` if one does not answer.

    A stop must not wait until it is said whose: it asks even if another instance was killed, or hangs.
    """
    sockets = running()
    if len(sockets) < 2:
        answer: Mapping[str, Any] = ask(sockets[0], op, args) if sockets else ask_instance(op, args, None, None)
        return answer
    with ThreadPoolExecutor(len(sockets)) as pool:
        answers = [*zip(sockets, pool.map(lambda socket: _try_to_ask(socket, op, args), sockets), strict=True)]
    words = "\n".join(f"{socket.stem}: {answer['words']}" for socket, answer in answers)
    if any("error" in answer for _, answer in answers):
        raise ControlError(words)
    return {"words": words, "unconfirmed": [each for _, answer in answers for each in answer.get("unconfirmed", ())]}


def _try_to_ask(socket: Path, op: str, args: Mapping[str, object]) -> Mapping[str, Any]:
    """Return the answer of an instance, or in words why there is none."""
    try:
        return dict(ask(socket, op, args))
    except ControlError as error:
        return {"words": f"not stopped: {error}", "error": True}


def _place(config: Path | None, socket: Path | None) -> Path:
    """Return where the instance listens that is meant; one at a socket must have the configuration that is named."""
    if socket is None:
        return find(config)
    if config is not None and (other := introduced(socket).configuration) != config.resolve():
        raise ControlError(f"{socket}: the instance there runs {other}, and not {config}")
    return socket


def _is_file_changed(instance: Instance) -> bool:
    """Return whether the file is another one than the instance goes by; not if that cannot be seen from here."""
    try:
        text = read_untrusted_text(instance.configuration, CONFIGURATION_MAX_BYTES)
    except UnreadableError:
        return False
    return instance.digest not in {"", sha256_of(text)}


def _in_words(instance: Instance, *, is_changed: bool) -> str:
    age_s = instance.configuration_age_s
    since = "" if age_s is None else f", loaded {rounded_duration(age_s)} ago"
    changed = "; the file has changed since: `stadimeter reload` applies it" if is_changed else ""
    return f"{instance.configuration}{since} (process {instance.pid}){changed}"


def who(by: str | None) -> str:
    """Return who asks: as given, or the login name, below ``sudo`` that of the person."""
    if by is not None:
        return by
    try:
        return os.environ.get("SUDO_USER") or getpass.getuser()
    except (KeyError, OSError):  # a user without a name
        return f"user {os.getuid()}"


def print_answer(data: Any, words: str, *, as_json: bool) -> None:
    """Print an answer."""
    typer.echo(json.dumps(data, ensure_ascii=False) if as_json else words)
