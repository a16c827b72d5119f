"""Commands that tell a running instance what people have seen and want: ``ack``, ``reset``, ``shelve`` and others."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stadimeter.cli.control_options import (
    ByOption,
    ConfigOption,
    JsonOption,
    SocketOption,
    WhyOption,
    asked,
    tell,
    who,
)
from stadimeter.cli.exits import told_plainly
from stadimeter.config.units import parse_duration
from stadimeter.errors import ConfigError, Problem

RuleName = Annotated[str | None, typer.Argument(metavar="RULE", help="The rule, by its name in the configuration.")]
All = Annotated[bool, typer.Option("--all", help="Every rule that it applies to, instead of RULE.")]


def register(app: typer.Typer) -> None:
    """Add the commands.

    Args:
        app: The command line.
    """
    app.command("ack")(ack)
    app.command("reset")(reset)
    app.command("shelve")(shelve)
    app.command("unshelve")(unshelve)
    app.command("take-out")(take_out)
    app.command("put-back")(put_back)


def ack(
    rule: RuleName = None,
    every: All = False,
    by: ByOption = None,
    why: WhyOption = "",
    config: ConfigOption = None,
    socket: SocketOption = None,
    as_json: JsonOption = False,
) -> None:
    """Acknowledge an alarm of a running instance: somebody has seen it.

    For rules with `ack = "required"`. Who acknowledged it, when and why is an event like any other.

    **Example**

    - `stadimeter ack too-close --why "moved the ladder"`

    **Exit code**: 0 done; 2 there is nothing to acknowledge, no such rule, or no running instance.
    """
    _operate("ack", {"rule": _rule(rule, every=every), "by": who(by), "why": why}, config, socket, as_json=as_json)


def reset(
    rule: RuleName = None,
    every: All = False,
    by: ByOption = None,
    why: WhyOption = "",
    config: ConfigOption = None,
    socket: SocketOption = None,
    as_json: JsonOption = False,
) -> None:
    """End an alarm of a running instance that latched. Its condition must be over.

    **Example**

    - `stadimeter reset too-close`

    **Exit code**: 0 done; 2 it is not latched, its condition still holds, no such rule, or no running instance.
    """
    _operate("reset", {"rule": _rule(rule, every=every), "by": who(by), "why": why}, config, socket, as_json=as_json)


def shelve(
    rule: RuleName = None,
    every: All = False,
    for_: Annotated[
        str | None,
        typer.Option("--for", metavar="TIME", help='For how long, such as "30 min"; else as long as the rule allows.'),
    ] = None,
    one_shot: Annotated[
        bool, typer.Option("--one-shot", help="Only until the alarm has returned to normal, or the time is over.")
    ] = False,
    by: ByOption = None,
    why: WhyOption = "",
    config: ConfigOption = None,
    socket: SocketOption = None,
    as_json: JsonOption = False,
) -> None:
    """Keep a rule of a running instance quiet for a while: it goes on judging, but drives nothing.

    It tells nobody either, and comes back by itself. A rule of severity `safety` cannot be shelved.

    **Example**

    - `stadimeter shelve too-close --for "30 min" --why "painting"`

    **Exit code**: 0 done; 2 the rule does not allow it, no such rule, or no running instance.
    """
    with told_plainly():
        args = {
            "rule": _rule(rule, every=every),
            "by": who(by),
            "why": why,
            "one_shot": one_shot,
            "for_s": _for_s(for_),
        }
        _operate("shelve", args, config, socket, as_json=as_json)


def unshelve(
    rule: RuleName = None,
    every: All = False,
    by: ByOption = None,
    why: WhyOption = "",
    config: ConfigOption = None,
    socket: SocketOption = None,
    as_json: JsonOption = False,
) -> None:
    """Let a shelved rule of a running instance act again.

    **Example**

    - `stadimeter unshelve --all`

    **Exit code**: 0 done; 2 it is not shelved, no such rule, or no running instance.
    """
    _operate("unshelve", {"rule": _rule(rule, every=every), "by": who(by), "why": why}, config, socket, as_json=as_json)


def take_out(
    rule: RuleName = None,
    every: All = False,
    by: ByOption = None,
    why: WhyOption = "",
    config: ConfigOption = None,
    socket: SocketOption = None,
    as_json: JsonOption = False,
) -> None:
    """Take a rule of a running instance out of service, until somebody puts it back.

    It goes on judging, but drives nothing and tells nobody, also after a restart. A rule of severity `safety` cannot
    be taken out.

    **Example**

    - `stadimeter take-out too-close --why "the door is being repaired"`

    **Exit code**: 0 done; 2 it is a safety rule, no such rule, or no running instance.
    """
    _operate("take-out", {"rule": _rule(rule, every=every), "by": who(by), "why": why}, config, socket, as_json=as_json)


def put_back(
    rule: RuleName = None,
    every: All = False,
    by: ByOption = None,
    why: WhyOption = "",
    config: ConfigOption = None,
    socket: SocketOption = None,
    as_json: JsonOption = False,
) -> None:
    """Put a rule of a running instance back into service.

    **Example**

    - `stadimeter put-back too-close`

    **Exit code**: 0 done; 2 it is not out of service, no such rule, or no running instance.
    """
    _operate("put-back", {"rule": _rule(rule, every=every), "by": who(by), "why": why}, config, socket, as_json=as_json)


def _operate(op: str, args: dict[str, object], config: Path | None, socket: Path | None, *, as_json: bool) -> None:
    with told_plainly():
        data = asked(op, args, config, socket)
    tell(data, data["words"], as_json=as_json)


def _rule(rule: str | None, *, every: bool) -> str:
    """Return the rule that is meant; empty for every one. Meaning all of them must be said."""
    if (rule is None) is not every:
        raise typer.BadParameter("name a RULE, or say --all; one of them, and not both")
    return rule or ""


def _for_s(text: str | None) -> float | None:
    if text is None:
        return None
    try:
        for_s = parse_duration(text)
    except ValueError as error:
        raise ConfigError([Problem(str(error), key="--for")]) from error
    if for_s == 0:
        raise ConfigError([Problem(f"{text!r} is no time at all", key="--for")])
    return for_s
