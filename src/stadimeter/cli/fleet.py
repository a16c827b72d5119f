"""The command ``fleet``: every device at a broker, and one list of standing alarms.

Nothing that arrives is trusted: topics, payloads and numbers are bounded, and texts lose their control characters. All
devices have a bound, and each, so that none crowds out the others.
"""

from __future__ import annotations

import json
import math
import re
import sys
import time
import uuid
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, suppress
from datetime import datetime
from typing import Annotated, Any, TypeVar

import msgspec
import typer
from msgspec import Meta, Struct, field
from msgspec.structs import asdict, replace
from rich.console import Console, ConsoleOptions, RenderableType
from rich.live import Live
from rich.rule import Rule
from rich.text import Text

from stadimeter.cli.exits import NOT_FOUND, ConfigArgument, configuration_path, plain_errors, read_option
from stadimeter.cli.formatting import UNKNOWN, format_distance, format_time
from stadimeter.cli.operate import ByOption, JsonOption, print_answer, who
from stadimeter.config.loader import load_messenger_choice
from stadimeter.config.units import parse_duration
from stadimeter.core.bounds import MAX_LENGTH_M
from stadimeter.core.decision import Severity
from stadimeter.core.message import (
    AVAILABILITY,
    EXPIRES_S,
    HEARTBEAT_S,
    INFO,
    REQUEST,
    RESPONSE,
    RULE_STATE,
    TARGET_STATE,
)
from stadimeter.core.words import one_line
from stadimeter.errors import ConfigError, ControlError, Problem
from stadimeter.messaging.protocol import Received, Subscribes, Subscription

# A device reports its targets every `HEARTBEAT_S`; one of which three reports are missing is taken for dead.
STALE_S = 3 * HEARTBEAT_S

# Devices; and targets and alarms of a device.
MAX_DEVICES, MAX_ENTRIES = 5000, 200
MAX_PAYLOAD_BYTES = 16_000
MAX_TOPIC_CHARACTERS, MAX_TEXT_CHARACTERS, MAX_INHIBITS = 300, 200, 8

# The levels of a base topic below its first: ``stadimeter/<node>``, ``stadimeter/<site>/<node>`` and so on.
MAX_LEVELS = 3
_TOPIC = re.compile(r"(?P<base>.+?)/(?:(?P<kind>availability|info)|(?P<of>target|rule)/(?P<name>[^/]+)/state)")
_OF_RULE = re.compile(r".+/rule/[^/]+/availability")

_Figure = Annotated[float, Meta(ge=-MAX_LENGTH_M, le=MAX_LENGTH_M)]
_StateT = TypeVar("_StateT", bound=Struct)


class DeviceInfo(Struct, frozen=True):
    """The software that runs on a device; empty for what it does not say."""

    version: str = ""
    configuration_sha256: str = ""
    boot_id: str = ""


class TargetReport(Struct, frozen=True, kw_only=True):
    """The newest state of a target; `at_s` is when it was sent, on the listener's clock, and None if not known."""

    status: str
    distance_m: _Figure | None = None
    sigma_m: _Figure | None = None
    at_s: float | None = None


class StandingAlarm(Struct, frozen=True, kw_only=True):
    """An alarm that is active, or that no one has acknowledged.

    Attributes:
        severity: Empty if the device does not say, which counts as the worst; None for a rule that is no alarm.
        inhibits: What keeps it quiet, such as ``shelved``.
        since: The time as the device has it.
    """

    device: str = ""
    rule: str = ""
    active: bool | None
    severity: str | None = ""
    is_acknowledged: bool = field(default=True, name="acknowledged")
    inhibits: tuple[str, ...] = ()
    since: str = ""
    reason: str = ""

    @property
    def rank(self) -> tuple[bool, bool, int, str, str, str]:
        """Sorts alarms: those that are kept quiet last, unacknowledged first, then the worst, then the oldest."""
        ranks = {each.value: -rank for rank, each in enumerate(Severity)}
        severity = ranks.get(self.severity or "", -len(ranks))
        return bool(self.inhibits), self.is_acknowledged, severity, self.since, self.device, self.rule

    @property
    def is_serious(self) -> bool:
        """True if it is of severity ``alarm`` or above, and nothing keeps it quiet."""
        return not self.inhibits and self.severity not in {Severity.INFO, Severity.WARNING}


class Device(Struct, kw_only=True):
    """Everything known of a device.

    Attributes:
        is_online: What its availability says; None if it has none.
        newest_s: When its newest message was sent, on the listener's clock. Those that a broker may have kept for long
            say nothing about that, and neither does ``offline``, which the broker says for a device that is gone.
        unjudged: Its alarms of which it is not known whether they are active.
        unreadable: How many messages below its topic were not in the form of stadimeter.
    """

    name: str
    is_online: bool | None = None
    newest_s: float | None = None
    info: DeviceInfo = DeviceInfo()
    targets: dict[str, TargetReport] = field(default_factory=dict)
    standing: dict[str, StandingAlarm] = field(default_factory=dict)
    unjudged: set[str] = field(default_factory=set)
    unreadable: int = 0

    @property
    def entries(self) -> int:
        """Number of its targets and alarms."""
        return len(self.targets) + len(self.standing) + len(self.unjudged)

    def status(self, now_s: float) -> str:
        """Return ``online``, ``offline``, ``silent`` (``online``, but nothing came for long) or ``unknown``."""
        if not self.is_online:
            return "unknown" if self.is_online is None else "offline"
        return "online" if self.newest_s is not None and now_s - self.newest_s <= STALE_S else "silent"


class Fleet:
    """Takes in messages, and has the state of every device.

    Args:
        root: What the topics of all devices begin with, such as ``stadimeter``.

    Attributes:
        passed_over: How many messages there was no room for, or whose topic is too long: then not all is shown.
    """

    def __init__(self, root: str) -> None:
        self.root = root
        self.devices: dict[str, Device] = {}
        self.passed_over = 0

    @property
    def filters(self) -> tuple[str, ...]:
        """The topics to subscribe to. No topic matches two of them."""
        bases = [self.root + "/+" * levels for levels in range(MAX_LEVELS + 1)]
        kinds = (AVAILABILITY, INFO, TARGET_STATE, RULE_STATE)
        return tuple(f"{base}/{kind.of('+')}" for base in bases for kind in kinds)

    @property
    def standing(self) -> list[StandingAlarm]:
        """Every standing alarm, those that matter most first."""
        every = (alarm for device in self.devices.values() for alarm in device.standing.values())
        return sorted(every, key=lambda alarm: alarm.rank)

    def take(self, message: Received, now_s: float) -> None:
        """Take in a message that came at ``now_s``, on a monotonic clock."""
        found = _TOPIC.fullmatch(message.topic) if len(message.topic) <= MAX_TOPIC_CHARACTERS else None
        if found is None:
            self.passed_over += 1
        elif not _OF_RULE.fullmatch(message.topic) and (device := self._device(found["base"], message)) is not None:
            try:
                self._read(device, found["kind"] or found["of"], one_line(found["name"] or ""), message, now_s)
            except (ValueError, RecursionError):  # msgspec's errors are ValueErrors
                device.unreadable += 1

    def _device(self, base: str, message: Received) -> Device | None:
        name = one_line(base.removeprefix(f"{self.root}/"))
        if name not in self.devices and message.payload:
            if len(self.devices) >= MAX_DEVICES:
                self.passed_over += 1
                return None
            self.devices[name] = Device(name=name)
        return self.devices.get(name)

    def _read(self, device: Device, kind: str, name: str, message: Received, now_s: float) -> None:
        if len(message.payload) > MAX_PAYLOAD_BYTES:
            raise ValueError("the payload is too long")
        if kind == "availability" and not message.payload:  # a person had the broker forget it
            del self.devices[device.name]
        elif kind == "availability":
            device.is_online = {b"online": True, b"offline": False}.get(message.payload)
            device.unreadable += device.is_online is None
        elif kind == "info":
            info = _decode(message.payload, DeviceInfo)
            if device.info.boot_id not in {"", info.boot_id}:  # a new run may have other targets
                device.targets.clear()
            device.info = info
        elif kind == "rule":
            self._read_rule(device, name, message.payload)
        else:
            self._read_target(device, name, message, now_s)

    def _read_rule(self, device: Device, name: str, payload: bytes) -> None:
        alarm = _decode(payload, StandingAlarm) if payload else StandingAlarm(active=False)
        device.standing.pop(name, None)
        device.unjudged.discard(name)
        is_standing = alarm.active or not alarm.is_acknowledged
        if alarm.severity is None or not (is_standing or alarm.active is None):
            return
        if device.entries >= MAX_ENTRIES:
            self.passed_over += 1
        elif is_standing:
            inhibits = tuple(map(_clean, alarm.inhibits[:MAX_INHIBITS]))
            device.standing[name] = replace(alarm, device=device.name, rule=name, inhibits=inhibits)
        else:
            device.unjudged.add(name)

    def _read_target(self, device: Device, name: str, message: Received, now_s: float) -> None:
        report = replace(_decode(message.payload, TargetReport), at_s=_sent_s(message, now_s))
        if name not in device.targets and device.entries >= MAX_ENTRIES:
            self.passed_over += 1
            return
        device.targets[name] = report
        if report.at_s is not None:
            device.newest_s = max(report.at_s, device.newest_s or report.at_s)


def _sent_s(message: Received, now_s: float) -> float | None:
    """Return when the state of a target was sent: of one that the broker kept, what is left of its life says so."""
    if not message.is_retained:
        return now_s
    left_s = message.expires_s
    return now_s - (EXPIRES_S - left_s) if left_s is not None and left_s <= EXPIRES_S else None


def _decode(payload: bytes, model: type[_StateT]) -> _StateT:
    """Return a payload of which every text is harmless."""
    found = msgspec.json.decode(payload, type=model)
    return replace(found, **{name: _clean(each) for name, each in asdict(found).items() if isinstance(each, str)})


def _clean(text: str) -> str:
    return one_line(text[:MAX_TEXT_CHARACTERS])


def fleet_record(fleet: Fleet, now_s: float) -> dict[str, Any]:
    """Return the fleet as ``fleet --json`` prints it. Ages are in seconds, and null where they are not known."""
    devices = [_device_record(device, now_s) for _, device in sorted(fleet.devices.items())]
    return {"devices": devices, "alarms": list(map(asdict, fleet.standing)), "passed_over": fleet.passed_over}


def troubles(fleet: Fleet, now_s: float) -> list[str]:
    """Return, as sentences, why not all is well: devices that are not online, and serious alarms that stand."""
    found = [] if fleet.devices else [f"no device was heard below {fleet.root}/"]
    devices = [device for _, device in sorted(fleet.devices.items()) if device.status(now_s) != "online"]
    found += [f"{device.name}: {device.status(now_s)}" for device in devices]
    serious = [alarm for alarm in fleet.standing if alarm.is_serious]
    unnamed = "alarm of unknown severity"
    found += [f"{each.device}/{each.rule}: {each.severity or unnamed}: {each.reason}" for each in serious]
    if fleet.passed_over:
        found.append(f"{fleet.passed_over} messages were passed over: there was no room for them, or no such topic")
    return found


def _age_s(at_s: float | None, now_s: float) -> float | None:
    return None if at_s is None else round(max(0.0, now_s - at_s), 1)


def _device_record(device: Device, now_s: float) -> dict[str, Any]:
    targets = []
    for name, report in sorted(device.targets.items()):
        found = asdict(report)
        targets.append({"target": name, "age_s": _age_s(found.pop("at_s"), now_s), **found})
    return {
        "device": device.name,
        "status": device.status(now_s),
        "age_s": _age_s(device.newest_s, now_s),
        **asdict(device.info),
        "targets": targets,
        "standing": len(device.standing),
        "unjudged": sorted(device.unjudged),
        "unreadable": device.unreadable,
    }


# The command ---------------------------------------------------------------------------------------------------------

REFRESH_S, CONNECT_S, LISTEN_S, ANSWER_S = 0.5, 5.0, 6.0, 10.0


def fleet(
    config: ConfigArgument = None,
    below: Annotated[str | None, typer.Option(metavar="TOPIC", help="What topics begin with: stadimeter.")] = None,
    wait: Annotated[str | None, typer.Option(metavar="TIME", help="How long to listen first: 6 s.")] = None,
    check: Annotated[bool, typer.Option("--check", help="Print what is wrong, and end with an exit code.")] = False,
    acknowledge: Annotated[str | None, typer.Option(metavar="NODE/RULE", help="Acknowledge an alarm.")] = None,
    by: ByOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show every device at a broker, and one list of standing alarms.

    Listens to the broker of a configuration, of which the section [messenger] is enough. Figures are grey once they are
    older than 15 s, and when the device or the connection is gone. Ctrl+C ends it. Where there is no terminal, the
    picture is printed once.

    **Examples**

    - `stadimeter fleet config/appliance.toml`

    - `stadimeter fleet config/appliance.toml --check --wait "20 s"`

    - `stadimeter fleet config/appliance.toml --acknowledge garage/too-close`

    **Exit code**: 0 done; with --check all are online and no alarm of severity alarm or safety stands; 1 with --check
    something is wrong, with --acknowledge the device refused; 2 the broker or the device does not answer.
    """
    with plain_errors():
        path = configuration_path(config)
        broker: object = load_messenger_choice(path).options
        if not isinstance(broker, Subscribes):
            raise ConfigError(f"{path}: there is no broker to listen to: its messenger is no driver = 'mqtt'")
        root = below or broker.base.partition("/")[0]
        wait_s = None if wait is None else read_option(parse_duration, wait, "--wait")
        if acknowledge is not None:
            _acknowledge(broker, f"{root}/{acknowledge}", who(by), wait_s or ANSWER_S, as_json=as_json)
            return
        seen = Fleet(root)
        with closing(broker.subscribe(seen.filters, lambda message: seen.take(message, time.monotonic()))) as listener:
            if as_json or check or not sys.stdout.isatty():
                _listen(listener, LISTEN_S if wait_s is None else wait_s)
                _print_once(seen, broker.place, check=check, as_json=as_json)
            else:
                _show(listener, seen, broker.place, math.inf if wait_s is None else wait_s)


def _listen(listener: Subscription, seconds: float) -> None:
    """Listen for that long once there is a connection, or until Ctrl+C; `ControlError` if there is none."""
    connected_until_s = time.monotonic() + max(seconds, CONNECT_S)
    with suppress(KeyboardInterrupt):
        while listener.trouble() and time.monotonic() < connected_until_s:
            listener.serve(0.05)
        until_s = time.monotonic() + (0.0 if listener.trouble() else seconds)
        while (left_s := until_s - time.monotonic()) > 0:
            listener.serve(left_s)
    if trouble := listener.trouble():
        raise ControlError(trouble)


def _show(listener: Subscription, seen: Fleet, place: str, seconds: float) -> None:
    """Show the fleet on the whole terminal until Ctrl+C."""
    until_s = time.monotonic() + seconds
    with suppress(KeyboardInterrupt), Live(screen=True, auto_refresh=False) as live:
        while (now_s := time.monotonic()) < until_s:
            live.update(FleetScreen(seen, place, listener.trouble(), now_s), refresh=True)
            listener.serve(REFRESH_S)


def _print_once(seen: Fleet, place: str, *, check: bool, as_json: bool) -> None:
    """Print the fleet as it is now; with ``check`` only what is wrong in it."""
    now_s = time.monotonic()
    found = troubles(seen, now_s)
    if as_json:
        typer.echo(json.dumps({"broker": place, **fleet_record(seen, now_s), "troubles": found}, ensure_ascii=False))
    elif check:
        typer.echo("\n".join(found) or f"{len(seen.devices)} devices are online, and no serious alarm stands")
    else:
        Console(highlight=False).print(*FleetScreen(seen, place, "", now_s).lines(sys.maxsize), sep="\n")
    if check and found:
        raise typer.Exit(NOT_FOUND)


def _acknowledge(broker: Subscribes, alarm: str, by: str, wait_s: float, *, as_json: bool) -> None:
    """Ask a device to acknowledge an alarm, and print its answer."""
    base, _, rule = alarm.rpartition("/")
    if not rule or not base.partition("/")[2] or set(alarm) & set("+#"):
        raise ConfigError([Problem(f"{alarm!r} is no NODE/RULE, such as garage/too-close", key="--acknowledge")])
    request = {"rule": rule, "transaction": uuid.uuid4().hex, "by": by}
    answers: list[dict[str, Any]] = []

    def take(message: Received) -> None:
        with suppress(ValueError, RecursionError, LookupError, TypeError):  # another's answer, or nonsense
            answer = json.loads(message.payload)
            answers.extend([answer] if answer["transaction"] == request["transaction"] else [])

    until_s, unsent = time.monotonic() + wait_s, [request]
    with closing(broker.subscribe((f"{base}/{RESPONSE.of('acknowledge')}",), take)) as listener:
        while not answers and time.monotonic() < until_s:
            listener.serve(0.1)
            if unsent and not listener.trouble():
                topic = f"{base}/{REQUEST.of('acknowledge')}"
                listener.publish(topic, json.dumps(unsent.pop()), math.ceil(wait_s))
        trouble = listener.trouble()
    if not answers:
        late = f"{base} did not answer within {wait_s:g} s; is it online, and does its program take acknowledgements?"
        raise ControlError(trouble or late)
    if answers[0].get("status") != "ok":
        typer.echo(f"error: {one_line(str(answers[0].get('error') or 'refused without a reason'))}", err=True)
        raise typer.Exit(NOT_FOUND)
    print_answer(answers[0], f"acknowledged: {one_line(alarm)}", as_json=as_json)


# The screen: every device on a line, the worst first, and below them the standing alarms ---------------

_STYLES = {"online": "green", "unknown": "yellow", "info": "cyan", "warning": "yellow"}  # of statuses and severities
_STALE, _BAD = "bright_black", "bold red"


class FleetScreen(Struct, frozen=True):
    """A fleet at one moment, as rich prints it.

    Attributes:
        place: The broker.
        trouble: What is wrong with the connection to it; then every figure is grey.
    """

    fleet: Fleet
    place: str
    trouble: str
    now_s: float

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        """Yield as many lines as there are rows."""
        yield from self.lines(options.height or console.height)

    def lines(self, height: int) -> list[RenderableType]:
        """Return the screen: alarms get half of it if there are that many, devices the rest."""
        alarms, devices = self.fleet.standing, sorted(self.fleet.devices.values(), key=self._rank)
        counts = Counter(device.status(self.now_s) for device in devices)
        words = ", ".join(f"{count} {status}" for status, count in counts.items()) or "no device heard yet"
        state = (f"NOT CONNECTED: {self.trouble}", _BAD) if self.trouble else (words, "bold")
        left_out = f"  {self.fleet.passed_over} messages were passed over" if self.fleet.passed_over else ""
        for_alarms = min(len(alarms) or 1, max((height - 3) // 2, height - 3 - len(devices)))
        for_devices = max(0, height - 3 - for_alarms)
        return [
            _line(f" {self.fleet.root} at {self.place}  ", state, (left_out, _BAD)),
            Rule(Text.assemble(("devices ", "bold"), _more(len(devices), for_devices)), align="left", style="dim"),
            *map(self._device, devices[:for_devices]),
            Rule(
                Text.assemble(("standing alarms ", "bold"), _more(len(alarms), for_alarms)), align="left", style="dim"
            ),
            *(map(self._alarm, alarms[:for_alarms]) if alarms else [Text(f" {UNKNOWN if self.trouble else 'none'}")]),
        ]

    def _rank(self, device: Device) -> tuple[bool, bool, str]:
        is_well = device.status(self.now_s) == "online"
        return is_well and not any(alarm.is_serious for alarm in device.standing.values()), is_well, device.name

    def _device(self, device: Device) -> Text:
        status = device.status(self.now_s)
        figures = {"standing": len(device.standing), "unknown": len(device.unjudged), "unreadable": device.unreadable}
        line = _line(
            " ",
            f"{device.name:20.20}",
            (f" {status:8} ", _STYLES.get(status, _BAD)),
            f"{_age(device.newest_s, self.now_s)} ago".ljust(11),
            f"{device.info.version:8.8}",
            *(self._target(device, name) for name in sorted(device.targets)),
            ("".join(f"  {count} {words}" for words, count in figures.items() if count), "bold"),
        )
        return line if status == "online" and not self.trouble else _line((line.plain, _STALE))

    def _target(self, device: Device, name: str) -> Text:
        target = device.targets[name]
        is_fresh = target.at_s is not None and self.now_s - target.at_s <= STALE_S
        figure = target.status if target.distance_m is None else format_distance(target.distance_m, target.sigma_m)
        if is_fresh and device.is_online and not self.trouble:
            return Text(f"  {name} {figure}")
        return Text(f"  {name} {figure} ({_age(target.at_s, self.now_s)} old)", _STALE)

    def _alarm(self, alarm: StandingAlarm) -> Text:
        line = _line(
            (f" {alarm.severity or 'unknown':8}", _STYLES.get(alarm.severity or "", _BAD)),
            f" {alarm.device}/{alarm.rule}  since {_local_time(alarm.since)}  ",
            (" ".join(["UNACKNOWLEDGED"] * (not alarm.is_acknowledged) + [*alarm.inhibits]), "bold"),
            f"  {alarm.reason}",
        )
        is_fresh = not self.trouble and self.fleet.devices[alarm.device].status(self.now_s) == "online"
        return line if is_fresh and not alarm.inhibits else _line((line.plain, _STALE))


def _line(*parts: str | Text | tuple[str, str]) -> Text:
    """Return a text that is cut where the line ends."""
    return Text.assemble(*parts, no_wrap=True, overflow="ellipsis")


def _age(at_s: float | None, now_s: float) -> str:
    return UNKNOWN if at_s is None else format_time(max(0.0, now_s - at_s))


def _local_time(text: str) -> str:
    """Return a device's time on this computer's clock; a dash for what is no time."""
    try:
        return datetime.fromisoformat(text).astimezone().strftime("%Y-%m-%d %H:%M:%S")
    except (ValueError, OverflowError, OSError):
        return UNKNOWN


def _more(count: int, shown: int) -> tuple[str, str]:
    return (f"{count}, {count - shown} of them not shown", "yellow") if count > shown else (str(count), "dim")
