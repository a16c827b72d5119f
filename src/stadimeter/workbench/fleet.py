"""The state of every device of a fleet, from the messages that a broker passes on.

Nothing that arrives is trusted: topics, payloads and numbers are bounded, and texts lose their control characters. All
devices have a bound, and each, so that none crowds out the others.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta, Struct, field
from msgspec.structs import asdict, replace

from stadimeter.core.bounds import MAX_LENGTH_M
from stadimeter.core.decision import Severity
from stadimeter.core.message import AVAILABILITY, EXPIRES_S, HEARTBEAT_S, INFO, RULE_STATE, TARGET_STATE
from stadimeter.core.words import one_line
from stadimeter.messaging.protocol import Received

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
