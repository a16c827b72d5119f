"""Commands for a running instance: operator commands such as ``alarm ack``, ``reload`` and ``status``."""

from __future__ import annotations

import getpass
import json
import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Any

import typer

from stadimeter.app.control.client import ANSWER_WAIT_S, Instance, ask, describe_reload, find, introduce
from stadimeter.app.places import running
from stadimeter.cli.completion import complete_rule, completing
from stadimeter.cli.exits import WRONG, configuration_path, plain_errors, read_option
from stadimeter.config.files import CONFIGURATION_MAX_BYTES, read_untrusted_text, sha256_of
from stadimeter.config.units import parse_duration
from stadimeter.core.words import rounded_duration
from stadimeter.errors import ConfigError, ControlError, DriverError, Problem, UnreadableError
from stadimeter.operator_actions import OperatorAction

ConfigOption = Annotated[
    Path | None, typer.Option("--config", metavar="CONFIG", help="The configuration of the instance, if several run.")
]
SocketOption = Annotated[
    Path | None, typer.Option("--socket", metavar="PATH", help="The socket of the instance; by default it is found.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
ByOption = Annotated[
    str | None, typer.Option("--by", metavar="NAME", help="Who gives the command; by default the login name.")
]
WhyOption = Annotated[str, typer.Option("--why", metavar="TEXT", help="Why; it is recorded with the event.")]


# A configuration with many targets takes a small computer some seconds to check.
CHECK_WAIT_S = 60.0

ALARM_ACTIONS = {action.command: action for action in OperatorAction if not action.is_on_outputs}
ALARM_HELP = f"""Acknowledge, reset or shelve an alarm.

Names a rule of the configuration, or says `--all`. It is recorded who gave the command, when and why. ACTION is one of

{chr(10).join(f"- `{name}`: {each.summary}. {each.more}" for name, each in ALARM_ACTIONS.items())}

**Examples**

{(chr(10) * 2).join(f"- `stadimeter alarm {each.example}`" for each in ALARM_ACTIONS.values())}

**Exit code**: 0 done; 2 the action does not apply to the rule as it is now, no such rule, or no running instance.
"""


def alarm(
    action: Annotated[str, typer.Argument(metavar="ACTION", autocompletion=completing(ALARM_ACTIONS))],
    rule: Annotated[
        str | None, typer.Argument(metavar="RULE", help="Its name in the configuration.", autocompletion=complete_rule)
    ] = None,
    value: Annotated[str, typer.Argument(metavar="VALUE", help='A threshold with its unit, such as "60 cm".')] = "",
    every: Annotated[bool, typer.Option("--all", help="Every rule that it applies to, instead of RULE.")] = False,
    key: Annotated[
        str, typer.Option("--key", metavar="NAME", help="Which threshold of the rule, such as `below`.")
    ] = "",
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
    """Act on an alarm; `ALARM_HELP` has the help."""
    meant = _one_of(ALARM_ACTIONS, action)
    given = {"for_s": for_ is not None, "one_shot": one_shot, "key": bool(key), "value": bool(value)}
    options = {"for_s": "--for", "one_shot": "--one-shot", "key": "--key", "value": "VALUE"}
    for name, is_given in given.items():
        if is_given and name not in meant.takes:
            raise typer.BadParameter(f"`alarm {action}` takes no {options[name]}")
    if meant.needs_value and not (rule and value):
        raise typer.BadParameter(f"name a RULE and a VALUE: stadimeter alarm {meant.example}")
    args: dict[str, object] = {"rule": _rule(rule, every=every), "by": who(by), "why": why}
    with plain_errors():
        taken = {"one_shot": one_shot, "for_s": _for_s(for_), "key": key, "value": value}
        args |= {name: taken[name] for name in meant.takes}
        data = ask_instance(meant.command, args, config, socket)
    print_answer(data, data["words"], as_json=as_json)


alarm.__doc__ = ALARM_HELP


def _one_of(actions: Mapping[str, OperatorAction], name: str) -> OperatorAction:
    if name not in actions:
        raise typer.BadParameter(f"{name!r} is no ACTION: {', '.join(actions)}")
    return actions[name]


OUTPUT_ACTIONS = {
    "stop": OperatorAction.STOP_OUTPUTS,
    "release": OperatorAction.RELEASE_OUTPUTS,
    "arm": OperatorAction.ARM,
    "disarm": OperatorAction.DISARM,
}
MadeSafe = Annotated[
    Path | None,
    typer.Argument(metavar="[CONFIG]", help="The configuration of the instance, if several run; that of `safe`."),
]


def outputs(
    action: Annotated[str, typer.Argument(metavar="ACTION", autocompletion=completing((*OUTPUT_ACTIONS, "safe")))],
    named: MadeSafe = None,
    by: ByOption = None,
    why: WhyOption = "",
    config: ConfigOption = None,
    socket: SocketOption = None,
    as_json: JsonOption = False,
) -> None:
    """Stop, release, arm or disarm outputs, or make them safe where no instance runs.

    ACTION is one of

    - `stop`: every actuator goes to its `safe` level, a base stands still, and all holds end, until released. No rule
      stands before that, of whatever severity; alarms are raised and announced as ever. It outlasts a reload, and a
      restart of a run that keeps its state. If several instances run and none is named, all are stopped. `stadimeter
      stop` does the same. It is no emergency stop: that is a switch in the supply.
    - `release`: stopped outputs may act again.
    - `arm`: with `safety.arm = "by-command"` or `"by-button"` a run begins disarmed, with every output at its safe
      value. A base whose driver failed disarms it again. Arming is refused while no fresh frames come, while the base
      is out of order, while outputs are stopped, and always with `"by-button"`: only a button arms then.
    - `disarm`: as `stop` until armed, for one instance, and not beyond the end of the run.
    - `safe`: where no run drives them, the outputs of CONFIG are made safe by hand, as the watchdog process of a run
      does when the run dies: pins are driven to the level at which they are off, and bases and boards get what stops
      them. Opening a serial port resets most Arduinos, which stops their motors too. While a run of CONFIG goes on,
      this is refused, since both would drive the outputs.

    **Examples**

    - `stadimeter outputs stop --why "a child is in the room"`

    - `stadimeter outputs release`

    - `stadimeter outputs arm --why "the floor is clear"`

    - `stadimeter outputs safe config/follow-ball.toml`

    **Exit code**: 0 done, also if it was done already; 2 refused, no instance runs, one of them does not answer, or an
    output could not be made safe.
    """
    which = config or named
    with plain_errors():
        if action == "safe":
            data = _make_safe(configuration_path(which))
        elif action == "stop" and which is None and socket is None:
            data = ask_all(OUTPUT_ACTIONS["stop"].command, {"by": who(by), "why": why})
        else:
            args = {"by": who(by), "why": why}
            data = ask_instance(_one_of(OUTPUT_ACTIONS, action).command, args, which, socket)
    print_answer(data, data["words"], as_json=as_json)


def stop(
    named: MadeSafe = None,
    by: ByOption = None,
    why: WhyOption = "",
    config: ConfigOption = None,
    socket: SocketOption = None,
    as_json: JsonOption = False,
) -> None:
    """Put every output at its safe value, until `stadimeter outputs release`.

    The same as `stadimeter outputs stop`, whose help says more. If several instances run and none is named, all are
    stopped: a stop does not wait for an answer.

    **Example**

    - `stadimeter stop --why "a child is in the room"`

    **Exit code**: 0 done, also if it was done already; 2 no instance runs, or one of them does not answer.
    """
    outputs("stop", named, by, why, config, socket, as_json)


def _make_safe(path: Path) -> Mapping[str, Any]:
    """Make every output of a configuration safe where no run drives it; say on standard error what could not be."""
    from stadimeter.app.service import held_lines  # noqa: PLC0415 - the other commands only ask a run
    from stadimeter.config.loader import load_configuration  # noqa: PLC0415
    from stadimeter.watchdog.plan import SafePlan  # noqa: PLC0415
    from stadimeter.watchdog.stops import make_safe  # noqa: PLC0415

    configuration = load_configuration(path, with_tests=False)
    try:
        socket = find(path)
    except ControlError:  # none runs, or none that could be asked
        pass
    else:
        raise DriverError(f"a run drives these outputs (it listens at {socket}): use `stadimeter stop`")
    lines = held_lines(configuration)
    plan = SafePlan(lines)
    troubles = [*plan.complaints, *make_safe(plan)]
    for trouble in troubles:
        typer.echo(f"error: {trouble}", err=True)
    if troubles:
        raise typer.Exit(WRONG)
    words = "\n".join(f"safe: {line}" for line in lines) or "nothing to do: every output is simulated"
    return {"words": words, "safe": lines}


def record(
    stops: Annotated[bool, typer.Option("--stop", help="End the recording under way.")] = False,
    clip: Annotated[bool, typer.Option("--clip", help="A clip: the seconds before now, and those after it.")] = False,
    by: ByOption = None,
    why: WhyOption = "",
    config: ConfigOption = None,
    socket: SocketOption = None,
    as_json: JsonOption = False,
) -> None:
    """Record with pictures: from now on, or a clip of the seconds around now.

    A recording goes on until `--stop`, or until it is an hour long. `--clip` needs `[black_box]` in the configuration,
    which says how many seconds; while a clip is under way already, that one becomes longer. Both are recordings like
    any other, whose name is printed.

    **Examples**

    - `stadimeter record`

    - `stadimeter record --stop`

    - `stadimeter record --clip --why "what was that?"`

    **Exit code**: 0 done; 2 it cannot be recorded now, the run has no black box, or no instance runs.
    """
    if clip and stops:
        raise typer.BadParameter("say --clip or --stop, and not both")
    with plain_errors():
        if clip:
            data = ask_instance(OperatorAction.CLIP.command, {"by": who(by), "why": why}, config, socket)
        else:
            data = ask_instance("record", {"do": "stop" if stops else "start"}, config, socket, CHECK_WAIT_S)
    print_answer(
        data,
        data.get("words") or f"{'recorded' if stops else 'recording'}: {data.get('path') or data['file']}",
        as_json=as_json,
    )


def confirm(
    by: ByOption = None,
    why: WhyOption = "",
    config: ConfigOption = None,
    socket: SocketOption = None,
    as_json: JsonOption = False,
) -> None:
    """Confirm that the camera of a running instance may be as it is now: its present view is saved.

    A check of the mounting has found that it was turned, zoomed or refocused, so its distances count
    as unconfirmed. Measure one of them by tape before you confirm, and calibrate anew if it was zoomed or
    refocused.

    **Example**

    - `stadimeter site confirm --why "aimed at the gate on purpose"`

    **Exit code**: 0 done; 2 there is nothing to confirm, or no instance runs.
    """
    with plain_errors():
        args = {"by": who(by), "why": why}
        data = ask_instance(OperatorAction.CONFIRM_MOUNTING.command, args, config, socket)
    print_answer(data, data["words"], as_json=as_json)


def reload(config: ConfigOption = None, socket: SocketOption = None, as_json: JsonOption = False) -> None:
    """Apply the edited configuration without a restart, if it passes `check`.

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
    """Print the state of every rule, and the reason.

    The first line names its configuration, how long ago that was loaded, and whether the file has changed since.

    **Example**

    - `stadimeter status`

    **Exit code**: 0 done; 2 no instance runs, or several do, or the one that began last was killed.
    """
    with plain_errors():
        data, who_answers = ask_and_introduce("status", {}, config, socket)
    print_answer(data, "\n".join((who_answers, *_lines(data))), as_json=as_json)


def _rule(rule: str | None, *, every: bool) -> str:
    """Return the rule that is meant; empty for every one. Meaning all of them must be said."""
    if (rule is None) is not every:
        raise typer.BadParameter("name a RULE, or say --all; one of them, and not both")
    return rule or ""


def _for_s(text: str | None) -> float | None:
    if text is None:
        return None
    for_s = read_option(parse_duration, text, "--for")
    if for_s == 0:
        raise ConfigError([Problem(f"{text!r} is no time at all", key="--for")])
    return for_s


def _lines(data: Mapping[str, Any]) -> Iterator[str]:
    yield "outputs may act" if data["safety"] == "active" else f"outputs are safe: {data['safety_reason']}"
    for target in data["targets"]:
        distance_m = target["distance_m"]
        yield f"{target['target']}: {target['status']}" + ("" if distance_m is None else f", {distance_m:.2f} m")
    if (mounting := data.get("mounting")) is not None and mounting["status"] != "as_saved":
        words = "distances are unconfirmed" if mounting["status"] == "unconfirmed" else "the mounting is not judged"
        yield f"{words}: {mounting['reason']}"
    for name, value in data.get("figures", {}).items():
        yield f"{name}: {'unknown' if value is None else f'{value:.3g}'}"
    if data["alarm_undelivered"]:
        yield "an alarm has not reached broker or service"
    for each in data["deliveries"]:
        if each["waiting"] or each["given_up"]:
            yield f"{each['to']}: not delivered yet: {each['waiting']}, given up: {each['given_up']}"
    yield from _commands_lines(data.get("commands"))
    for rule in data["rules"]:
        marks = [] if rule["acknowledged"] else ["unacknowledged"]
        marks += ["first of its group"] if rule["first_out"] else []
        moved = ((key, each) for key, each in rule["thresholds"].items() if each["set_by"] is not None)
        marks += [f"{key} set to {each['value']:.6g} {each['unit']}" for key, each in moved]
        marked = ", ".join([rule["status"], *marks, *rule["inhibits"]])
        yield f"{rule['rule']}: {marked}: {rule['reason']}"


def _commands_lines(commands: Mapping[str, Any] | None) -> Iterator[str]:
    """Yield what there is to know of commands that came as messages, if any were refused or cannot come."""
    if commands and commands["trouble"]:
        yield f"commands over MQTT: {commands['trouble']}"
    if commands and commands["refused"]:
        refused = ", ".join(f"{count} {why.replace('_', ' ')}" for why, count in commands["refused"].items())
        yield f"commands over MQTT: {commands['done']} done, refused: {refused}"


def ask_instance(
    op: str, args: Mapping[str, object], config: Path | None, socket: Path | None, wait_s: float = ANSWER_WAIT_S
) -> Any:
    """Ask the running instance: that at a socket, or with a configuration, or the only one."""
    return ask(_place(config, socket), op, args, wait_s)


def ask_and_introduce(
    op: str, args: Mapping[str, object], config: Path | None, socket: Path | None
) -> tuple[Mapping[str, Any], str]:
    """Ask the running instance as `ask_instance` does; return its answer with its name, also as a line for people."""
    place = _place(config, socket)
    instance = introduce(place)
    data = ask(place, op, args)
    told = {
        "configuration": str(instance.configuration),
        "configuration_age_s": instance.configuration_age_s,
        "digest": instance.digest,
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
    if config is not None and (other := introduce(socket).configuration) != config.resolve():
        raise ControlError(f"{socket}: the instance there runs {other}, and not {config}")
    return socket


def _is_file_changed(instance: Instance) -> bool:
    """Check whether the file is another one than the instance goes by; not if that cannot be seen from here."""
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
    """Name the person who asks: as given, or the login name, below ``sudo`` that of the person."""
    if by is not None:
        return by
    try:
        return os.environ.get("SUDO_USER") or getpass.getuser()
    except (KeyError, OSError):  # a user without a name
        return f"user {os.getuid()}"


def print_answer(data: Any, words: str, *, as_json: bool) -> None:
    """Print an answer."""
    typer.echo(json.dumps(data, ensure_ascii=False) if as_json else words)
