"""Commands for a running instance: operator commands such as ``alarm ack``, and ``reload`` and ``status``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from stadimeter.app.control.client import in_words
from stadimeter.cli.control_options import (
    ByOption,
    ConfigOption,
    JsonOption,
    SocketOption,
    WhyOption,
    asked,
    asked_of,
    asked_of_all,
    print_answer,
    who,
)
from stadimeter.cli.exits import plain_errors
from stadimeter.config.units import parse_duration
from stadimeter.errors import ConfigError, Problem

RuleName = Annotated[str | None, typer.Argument(metavar="RULE", help="The rule, by its name in the configuration.")]
All = Annotated[bool, typer.Option("--all", help="Every rule that it applies to, instead of RULE.")]

CHECK_WAIT_S = 60.0
"""A configuration with many targets takes a small computer some seconds to check."""

ALARM = """Acknowledge, reset or shelve an alarm of a running instance, and more.

Every command names a rule of the configuration, or says `--all`. It is recorded who gave it, when and why.
"""

ON_ONE_RULE: Mapping[str, str] = {
    "ack": """Acknowledge an alarm of a running instance: a person has seen it.

    For rules with `ack = "required"`. An event records who acknowledged it, when and why.

    **Example**

    - `stadimeter alarm ack too-close --why "moved the ladder"`

    **Exit code**: 0 done; 2 there is nothing to acknowledge, no such rule, or no running instance.
    """,
    "reset": """End a latched alarm of a running instance. Its condition must be over.

    **Example**

    - `stadimeter alarm reset too-close`

    **Exit code**: 0 done; 2 it is not latched, its condition still holds, no such rule, or no running instance.
    """,
    "unshelve": """Let a shelved rule of a running instance act again.

    **Example**

    - `stadimeter alarm unshelve --all`

    **Exit code**: 0 done; 2 it is not shelved, no such rule, or no running instance.
    """,
    "take-out": """Take a rule of a running instance out of service, until it is put back.

    The rule is still evaluated, but drives nothing and notifies no one, also after a restart. A rule of severity
    `safety` cannot be taken out.

    **Example**

    - `stadimeter alarm take-out too-close --why "the door is being repaired"`

    **Exit code**: 0 done; 2 it is a safety rule, no such rule, or no running instance.
    """,
    "put-back": """Put a rule of a running instance back into service.

    **Example**

    - `stadimeter alarm put-back too-close`

    **Exit code**: 0 done; 2 it is not out of service, no such rule, or no running instance.
    """,
}
"""The operator commands that take a rule and nothing else, each with its help."""


def register(app: typer.Typer) -> None:
    """Add the commands; those for alarms also by the names that they had without ``alarm`` before them."""
    alarm = typer.Typer(name="alarm", help=ALARM, no_args_is_help=True, rich_markup_mode="markdown")
    for group in (alarm, app):
        for op, words in ON_ONE_RULE.items():
            group.command(op, help=words)(_on_one_rule(op))
        group.command("shelve")(shelve)
    app.add_typer(alarm)
    app.command("stop-outputs")(stop_outputs)
    app.command("reload")(reload)
    app.command("status")(status)


def _on_one_rule(op: str) -> Callable[..., None]:
    """Return the function of an operator command; its arguments are those of the command line."""

    def command(
        rule: RuleName = None,
        every: All = False,
        by: ByOption = None,
        why: WhyOption = "",
        config: ConfigOption = None,
        socket: SocketOption = None,
        as_json: JsonOption = False,
    ) -> None:
        args = {"rule": _rule(rule, every=every), "by": who(by), "why": why}
        _operate(op, args, config, socket, as_json=as_json)

    return command


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
    """Shelve a rule of a running instance: for a while it is still evaluated, but drives nothing.

    It notifies no one either, and acts again by itself when the time is over. A rule of severity `safety` cannot be
    shelved.

    **Example**

    - `stadimeter alarm shelve too-close --for "30 min" --why "painting"`

    **Exit code**: 0 done; 2 the rule does not allow it, no such rule, or no running instance.
    """
    with plain_errors():
        args = {
            "rule": _rule(rule, every=every),
            "by": who(by),
            "why": why,
            "one_shot": one_shot,
            "for_s": _for_s(for_),
        }
        _operate("shelve", args, config, socket, as_json=as_json)


def stop_outputs(
    release: Annotated[bool, typer.Option("--release", help="Let them act again.")] = False,
    by: ByOption = None,
    why: WhyOption = "",
    config: ConfigOption = None,
    socket: SocketOption = None,
    as_json: JsonOption = False,
) -> None:
    """Put every output of a running instance at its safe value, until they are released.

    Every actuator goes to its `safe` level, a base stands still, and all holds end. No rule stands before that, of
    whatever severity; alarms are raised and announced as ever. It outlasts a reload, and a restart of a run that keeps
    its state. If several instances run and none is named, all are stopped. It is no emergency stop: that is a switch in
    the supply.

    **Examples**

    - `stadimeter stop-outputs --why "a child is in the room"`

    - `stadimeter stop-outputs --release`

    **Exit code**: 0 done, also if it was done already; 2 no instance runs, or one of them does not answer.
    """
    op, args = "release-outputs" if release else "stop-outputs", {"by": who(by), "why": why}
    if release or config is not None or socket is not None:
        _operate(op, args, config, socket, as_json=as_json)
        return
    with plain_errors():
        data = asked_of_all(op, args)
    print_answer(data, data["words"], as_json=as_json)


def reload(config: ConfigOption = None, socket: SocketOption = None, as_json: JsonOption = False) -> None:
    """Apply the edited configuration of a running instance without a restart, if it passes `check`.

    If anything is wrong with the file, nothing changes. Rules that mean the same as before keep their state: an alarm
    stays active, acknowledged or shelved. A changed rule starts afresh, and the alarm of a removed rule clears.

    The camera, targets, actuators, the base and the messenger cannot be changed while they are in use: the answer
    names the keys that need a restart, and then nothing is changed at all.

    **Example**

    - `stadimeter reload`

    **Exit code**: 0 reloaded; 2 the file is wrong or needs a restart, or no instance runs.
    """
    with plain_errors():
        data = asked("reload", {}, config, socket, CHECK_WAIT_S)
    for warning in data["warnings"]:
        typer.echo(f"warning: {warning}", err=True)
    print_answer(data, f"reloaded: {in_words(data)}", as_json=as_json)


def status(config: ConfigOption = None, socket: SocketOption = None, as_json: JsonOption = False) -> None:
    """Print the state of every rule of a running instance, and the reason.

    The first line names its configuration, how long ago that was loaded, and whether the file has changed since.

    **Example**

    - `stadimeter status`

    **Exit code**: 0 done; 2 no instance runs, or several do, or the one that began last was killed.
    """
    with plain_errors():
        data, who_answers = asked_of("status", {}, config, socket)
    print_answer(data, "\n".join((who_answers, *_lines(data))), as_json=as_json)


def _operate(op: str, args: Mapping[str, object], config: Path | None, socket: Path | None, *, as_json: bool) -> None:
    with plain_errors():
        data = asked(op, args, config, socket)
    print_answer(data, data["words"], as_json=as_json)


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
