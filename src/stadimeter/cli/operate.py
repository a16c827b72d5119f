"""Commands for a running instance: operator commands such as ``alarm ack``, and ``reload`` and ``status``."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from stadimeter.app.control.client import describe_reload
from stadimeter.cli.control_options import (
    ByOption,
    ConfigOption,
    JsonOption,
    SocketOption,
    WhyOption,
    ask_all,
    ask_and_introduce,
    ask_instance,
    print_answer,
    who,
)
from stadimeter.cli.exits import plain_errors
from stadimeter.config.units import parse_duration
from stadimeter.errors import ConfigError, Problem
from stadimeter.operator_actions import OperatorAction

RuleName = Annotated[str | None, typer.Argument(metavar="RULE", help="The rule, by its name in the configuration.")]
For = Annotated[
    str | None,
    typer.Option("--for", metavar="TIME", help='For how long, such as "30 min"; else as long as the rule allows.'),
]
OneShot = Annotated[
    bool, typer.Option("--one-shot", help="Only until the alarm has returned to normal, or the time is over.")
]
All = Annotated[bool, typer.Option("--all", help="Every rule that it applies to, instead of RULE.")]

# A configuration with many targets takes a small computer some seconds to check.
CHECK_WAIT_S = 60.0

ALARM = """Acknowledge, reset or shelve an alarm of a running instance, and more.

Every command names a rule of the configuration, or says `--all`. It is recorded who gave it, when and why.
"""


def register(app: typer.Typer) -> None:
    """Add the commands; those for alarms also by the names that they had without ``alarm`` before them."""
    alarm = typer.Typer(name="alarm", help=ALARM, no_args_is_help=True, rich_markup_mode="markdown")
    for group in (alarm, app):
        for action in OperatorAction:
            if not action.is_on_outputs:
                group.command(action.command, help=action.help)(_alarm_command(action))
    app.add_typer(alarm)
    app.command("stop-outputs", help=OperatorAction.STOP_OUTPUTS.help)(stop_outputs)
    app.command("reload")(reload)
    app.command("status")(status)


def _alarm_command(action: OperatorAction) -> Callable[..., None]:
    """Return the function of an operator command; its arguments are those of the command line."""

    def command(
        rule: RuleName = None,
        every: All = False,
        for_: For = None,
        one_shot: OneShot = False,
        by: ByOption = None,
        why: WhyOption = "",
        config: ConfigOption = None,
        socket: SocketOption = None,
        as_json: JsonOption = False,
    ) -> None:
        args: dict[str, object] = {"rule": _rule(rule, every=every), "by": who(by), "why": why}
        with plain_errors():
            if action.is_timed:
                args |= {"one_shot": one_shot, "for_s": _for_s(for_)}
            _operate(action.command, args, config, socket, as_json=as_json)

    if not action.is_timed:
        signature = inspect.signature(command, eval_str=True)
        options = [option for name, option in signature.parameters.items() if name not in {"for_", "one_shot"}]
        vars(command)["__signature__"] = signature.replace(parameters=options)
    return command


def stop_outputs(
    release: Annotated[bool, typer.Option("--release", help="Let them act again.")] = False,
    by: ByOption = None,
    why: WhyOption = "",
    config: ConfigOption = None,
    socket: SocketOption = None,
    as_json: JsonOption = False,
) -> None:
    """Stop every output of one running instance, or of all; or release them. The table of actions has the help."""
    action = OperatorAction.RELEASE_OUTPUTS if release else OperatorAction.STOP_OUTPUTS
    args = {"by": who(by), "why": why}
    if release or config is not None or socket is not None:
        _operate(action.command, args, config, socket, as_json=as_json)
        return
    with plain_errors():
        data = ask_all(action.command, args)
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
        data = ask_instance("reload", {}, config, socket, CHECK_WAIT_S)
    for warning in data["warnings"]:
        typer.echo(f"warning: {warning}", err=True)
    print_answer(data, f"reloaded: {describe_reload(data)}", as_json=as_json)


def status(config: ConfigOption = None, socket: SocketOption = None, as_json: JsonOption = False) -> None:
    """Print the state of every rule of a running instance, and the reason.

    The first line names its configuration, how long ago that was loaded, and whether the file has changed since.

    **Example**

    - `stadimeter status`

    **Exit code**: 0 done; 2 no instance runs, or several do, or the one that began last was killed.
    """
    with plain_errors():
        data, who_answers = ask_and_introduce("status", {}, config, socket)
    print_answer(data, "\n".join((who_answers, *_lines(data))), as_json=as_json)


def _operate(op: str, args: Mapping[str, object], config: Path | None, socket: Path | None, *, as_json: bool) -> None:
    with plain_errors():
        data = ask_instance(op, args, config, socket)
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
