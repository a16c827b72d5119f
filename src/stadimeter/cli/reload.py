"""The commands ``reload`` and ``status``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import typer

from stadimeter.app.control.client import in_words
from stadimeter.cli.control_options import ConfigOption, JsonOption, SocketOption, asked, tell
from stadimeter.cli.exits import told_plainly

CHECK_WAIT_S = 60.0
"""A configuration with many targets takes a small computer some seconds to check."""


def register(app: typer.Typer) -> None:
    """Add the commands.

    Args:
        app: The command line.
    """
    app.command("reload")(reload)
    app.command("status")(status)


def reload(config: ConfigOption = None, socket: SocketOption = None, as_json: JsonOption = False) -> None:
    """Have a running instance take over its changed configuration, without a restart.

    The file is checked first. If anything is wrong with it, nothing changes and the run goes on as it was. Rules that
    mean the same as before go on as if nothing had happened: an alarm stays active, acknowledged or shelved. A rule
    that was changed begins anew, and the alarm of one that was removed clears.

    What is no rule (the camera, targets, actuators, the base, the messenger) cannot be changed while it is in use: the
    answer says what needs a restart, and then nothing is changed at all.

    **Example**

    - `stadimeter reload`

    **Exit code**: 0 it was taken over; 2 the file is wrong or needs a restart, or no instance runs.
    """
    with told_plainly():
        data = asked("reload", {}, config, socket, CHECK_WAIT_S)
    for warning in data["warnings"]:
        typer.echo(f"warning: {warning}", err=True)
    tell(data, f"taken over: {in_words(data)}", as_json=as_json)


def status(config: ConfigOption = None, socket: SocketOption = None, as_json: JsonOption = False) -> None:
    """Print what every rule of a running instance is doing, and why.

    **Example**

    - `stadimeter status`

    **Exit code**: 0 done; 2 no instance runs, or several do.
    """
    with told_plainly():
        data = asked("status", {}, config, socket)
    tell(data, "\n".join(_lines(data)), as_json=as_json)


def _lines(data: Mapping[str, Any]) -> Iterator[str]:
    yield "outputs may act" if data["safety"] == "active" else f"outputs are safe: {data['safety_reason']}"
    for target in data["targets"]:
        distance_m = target["distance_m"]
        yield f"{target['target']}: {target['status']}" + ("" if distance_m is None else f", {distance_m:.2f} m")
    for each in data["deliveries"]:
        if each["waiting"] or each["given_up"]:
            yield f"{each['to']}: not delivered yet: {each['waiting']}, given up: {each['given_up']}"
    for rule in data["rules"]:
        marks = [] if rule["acknowledged"] else ["unacknowledged"]
        marks += ["first of its group"] if rule["first_out"] else []
        marked = ", ".join([rule["status"], *marks, *rule["gates"]])
        yield f"{rule['rule']}: {marked}: {rule['reason']}"
