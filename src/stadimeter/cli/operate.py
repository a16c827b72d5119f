"""Commands for a running instance: operator commands such as ``alarm ack``, ``reload`` and ``status``."""

from __future__ import annotations

import getpass
import inspect
import json
import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Any

import typer

from stadimeter.app.control.client import ANSWER_WAIT_S, Instance, ask, describe_reload, find, introduce
from stadimeter.app.places import CERTIFICATE, running
from stadimeter.cli.exits import plain_errors, read_option
from stadimeter.config.files import CONFIGURATION_MAX_BYTES, JSON_MAX_BYTES, is_file, read_untrusted_text, sha256_of
from stadimeter.config.units import parse_duration
from stadimeter.core.words import rounded_duration
from stadimeter.errors import ConfigError, ControlError, Problem, UnreadableError
from stadimeter.operator_actions import OperatorAction

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


RuleName = Annotated[str | None, typer.Argument(metavar="RULE", help="The rule, by its name in the configuration.")]
For = Annotated[
    str | None,
    typer.Option("--for", metavar="TIME", help='For how long, such as "30 min"; else as long as the rule allows.'),
]
OneShot = Annotated[
    bool, typer.Option("--one-shot", help="Only until the alarm has returned to normal, or the time is over.")
]
All = Annotated[bool, typer.Option("--all", help="Every rule that it applies to, instead of RULE.")]

Value = Annotated[str, typer.Argument(metavar="VALUE", help='The threshold with its unit, such as "60 cm".')]
Key = Annotated[
    str, typer.Option("--key", metavar="NAME", help="Which threshold of the rule, such as `below`, if it has several.")
]

# A configuration with many targets takes a small computer some seconds to check.
CHECK_WAIT_S = 60.0

alarm = typer.Typer(no_args_is_help=True, rich_markup_mode="markdown")


@alarm.callback()
def _alarm() -> None:
    """Acknowledge, reset or shelve an alarm of a running instance, and more.

    Every command names a rule of the configuration, or says `--all`. It is recorded who gave it, when and why.
    """


def _alarm_command(action: OperatorAction) -> Callable[..., None]:
    """Return the function of an operator command; its arguments are those of the command line."""

    def command(
        rule: RuleName = None,
        value: Value = "",
        every: All = False,
        key: Key = "",
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
            taken = {"one_shot": one_shot, "for_s": _for_s(for_), "key": key, "value": value}
            args |= {name: taken[name] for name in action.takes}
            data = ask_instance(action.command, args, config, socket)
        print_answer(data, data["words"], as_json=as_json)

    signature = inspect.signature(command, eval_str=True)
    vars(command)["__signature__"] = signature.replace(parameters=[*_options(action, signature)])
    return command


def _options(action: OperatorAction, signature: inspect.Signature) -> Iterator[inspect.Parameter]:
    """Yield the options that an action has. One that takes a value needs it, and is for one rule."""
    of_some = {"for_": "for_s", "one_shot": "one_shot", "key": "key", "value": "value"}
    for name, option in signature.parameters.items():
        if of_some.get(name) not in {None, *action.takes} or (name == "every" and action.needs_value):
            continue
        is_needed = action.needs_value and name in {"rule", "value"}
        yield option.replace(default=inspect.Parameter.empty) if is_needed else option


for _action in OperatorAction:
    if not _action.is_on_outputs:
        alarm.command(_action.command, help=_action.help)(_alarm_command(_action))


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
    with plain_errors():
        if release or config is not None or socket is not None:
            data = ask_instance(action.command, args, config, socket)
        else:
            data = ask_all(action.command, args)
    print_answer(data, data["words"], as_json=as_json)


stop_outputs.__doc__ = OperatorAction.STOP_OUTPUTS.help


def _command(action: OperatorAction) -> Callable[..., None]:
    """Return the function of a command for one instance that takes no more than who gives it, and why."""

    def command(
        by: ByOption = None,
        why: WhyOption = "",
        config: ConfigOption = None,
        socket: SocketOption = None,
        as_json: JsonOption = False,
    ) -> None:
        with plain_errors():
            data = ask_instance(action.command, {"by": who(by), "why": why}, config, socket)
        print_answer(data, data["words"], as_json=as_json)

    command.__doc__ = action.help
    return command


arm, disarm, clip, confirm = map(
    _command, (OperatorAction.ARM, OperatorAction.DISARM, OperatorAction.CLIP, OperatorAction.CONFIRM_MOUNTING)
)


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

    The first line names its configuration, how long ago that was loaded, and whether the file has changed since. Of a
    site that was certified it says when, and whether the configuration is the same since.

    **Example**

    - `stadimeter status`

    **Exit code**: 0 done; 2 no instance runs, or several do, or the one that began last was killed.
    """
    with plain_errors():
        data, who_answers = ask_and_introduce("status", {}, config, socket)
    instance = data["instance"]
    certificate = _certified(Path(instance["configuration"]), instance["digest"])
    certified = (certificate["words"],) if certificate is not None else ()
    words = "\n".join((who_answers, *certified, *_lines(data)))
    print_answer({**data, "certificate": certificate}, words, as_json=as_json)


def _certified(configuration: Path, digest: str) -> dict[str, Any] | None:
    """Describe the certificate of a site for the SHA-256 of a run's configuration; None if there is none."""
    file = configuration.with_suffix(CERTIFICATE)
    if not is_file(file):
        return None
    try:
        made = json.loads(read_untrusted_text(file, JSON_MAX_BYTES))
        date, stamp = str(made["date"]), str(made["about"]["configuration"])
    except (UnreadableError, ValueError, LookupError, TypeError) as error:
        return {"date": "", "is_unchanged": False, "words": f"{file} cannot be read: {error}; delete it"}
    is_unchanged = bool(stamp) and digest.startswith(stamp)
    changed = "is the same since" if is_unchanged else "changed since: `stadimeter check` says whether it still counts"
    words = f"certified on {date}; the configuration {changed}"
    return {"date": date, "is_unchanged": is_unchanged, "words": words}


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
