"""The state of every device of a fleet, from the messages that a broker passes on.

Nothing that arrives is trusted: topics, payloads and numbers are bounded, and texts lose their control characters.
What is remembered has one bound for all, and one for each name below the root, so that no device crowds out the others.
"""

from __future__ import annotations

import re
from collections import Counter
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta, Struct, field

from stadimeter.core.bounds import MAX_LENGTH_M
from stadimeter.core.decision import Severity
from stadimeter.core.message import EXPIRES_S, HEARTBEAT_S
from stadimeter.core.words import one_line
from stadimeter.messaging.protocol import Received

# A device reports its targets every `HEARTBEAT_S`; one of which three reports are missing is taken for dead.
STALE_S = 3 * HEARTBEAT_S

# Of devices, targets and rules together. One name below the root may have a fifth of them.
MAX_ENTRIES = 50_000
MAX_ENTRIES_EACH = 10_000
MAX_PAYLOAD_BYTES = 16_000
MAX_TOPIC_CHARACTERS = 300
MAX_TEXT_CHARACTERS = 200

# The levels of a base topic below its first: ``stadimeter/<node>``, ``stadimeter/<site>/<node>`` and so on.
MAX_LEVELS = 3
_KINDS = ("availability", "info", "target/+/state", "rule/+/state")
_TOPIC = re.compile(r"(?P<base>.+?)/(?:(?P<kind>availability|info)|(?P<of>target|rule)/(?P<name>[^/]+)/state)")
_OF_RULE = re.compile(r".+/rule/[^/]+/availability")
_AVAILABILITIES = {b"online": True, b"offline": False}

_Figure = Annotated[float, Meta(ge=-MAX_LENGTH_M, le=MAX_LENGTH_M)]
PayloadT = TypeVar("PayloadT")


class DeviceInfo(Struct, frozen=True):
    """The software that runs on a device; empty for what it does not say."""

    version: str = ""
    configuration_sha256: str = ""
    boot_id: str = ""


class _TargetPayload(Struct, frozen=True):
    seq: int
    status: str
    distance_m: _Figure | None = None
    sigma_m: _Figure | None = None


class _RulePayload(Struct, frozen=True):
    active: bool | None
    severity: str | None = ""
    acknowledged: bool = True
    inhibits: list[str] = field(default_factory=list)
    since: str = ""
    reason: str = ""


class TargetReport(Struct, frozen=True):
    """The newest state of a target; `at_s` is when it was sent, on the listener's clock, and None if not known."""

    status: str
    distance_m: float | None
    sigma_m: float | None
    sequence: int
    at_s: float | None


class StandingAlarm(Struct, frozen=True, kw_only=True):
    """An alarm that is active, or that no one has acknowledged.

    Attributes:
        severity: Empty if the device does not say, which counts as the worst.
        inhibits: What keeps it quiet, such as ``shelved``.
        since: The time as the device has it.
    """

    device: str
    rule: str
    severity: str
    is_acknowledged: bool
    inhibits: tuple[str, ...]
    since: str
    reason: str

    @property
    def rank(self) -> tuple[bool, bool, int, str]:
        """Sorts alarms: those that are kept quiet last, unacknowledged first, then the worst, then the oldest."""
        order = [*Severity]
        severity = order.index(Severity(self.severity)) if self.severity in order else len(order)
        return bool(self.inhibits), self.is_acknowledged, -severity, self.since

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
        missed: How many states of its targets did not arrive, by their numbers.
    """

    name: str
    is_online: bool | None = None
    newest_s: float | None = None
    info: DeviceInfo = DeviceInfo()
    targets: dict[str, TargetReport] = field(default_factory=dict)
    standing: dict[str, StandingAlarm] = field(default_factory=dict)
    unjudged: set[str] = field(default_factory=set)
    unreadable: int = 0
    missed: int = 0

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
        messages: How many came.
        passed_over: How many there was no room for, or whose topic is too long: then not all is shown.
    """

    def __init__(self, root: str) -> None:
        self.root = root
        self.devices: dict[str, Device] = {}
        self.messages = self.passed_over = 0
        self._entries: Counter[str] = Counter()
        self._entry_count = 0

    @property
    def filters(self) -> tuple[str, ...]:
        """The topics to subscribe to. No topic matches two of them."""
        bases = [self.root + "/+" * levels for levels in range(MAX_LEVELS + 1)]
        return tuple(f"{base}/{kind}" for base in bases for kind in _KINDS)

    @property
    def standing(self) -> list[StandingAlarm]:
        """Every standing alarm, those that matter most first."""
        every = (alarm for device in self.devices.values() for alarm in device.standing.values())
        return sorted(every, key=lambda alarm: (alarm.rank, alarm.device, alarm.rule))

    def take(self, message: Received, now_s: float) -> None:
        """Take in a message that came at ``now_s``, on a monotonic clock."""
        self.messages += 1
        found = _TOPIC.fullmatch(message.topic) if len(message.topic) <= MAX_TOPIC_CHARACTERS else None
        if found is None:
            self.passed_over += 1
            return
        if _OF_RULE.fullmatch(message.topic) or (device := self._device(found["base"], message)) is None:
            return
        kind, name = found["kind"] or found["of"], one_line(found["name"] or "")
        try:
            self._read(device, kind, name, message, now_s)
        except (ValueError, RecursionError):  # msgspec's errors are ValueErrors
            device.unreadable += 1

    def _device(self, base: str, message: Received) -> Device | None:
        name = one_line(base.removeprefix(f"{self.root}/"))
        if name not in self.devices and message.payload and self._has_room(name):
            self.devices[name] = Device(name=name)
        return self.devices.get(name)

    def _has_room(self, device: str) -> bool:
        """Count an entry more, unless there is no room for it."""
        name = device.partition("/")[0]
        if self._entry_count >= MAX_ENTRIES or self._entries[name] >= MAX_ENTRIES_EACH:
            self.passed_over += 1
            return False
        self._count(device, 1)
        return True

    def _count(self, device: str, more: int) -> None:
        self._entries[device.partition("/")[0]] += more
        self._entry_count += more

    def _read(self, device: Device, kind: str, name: str, message: Received, now_s: float) -> None:
        if len(message.payload) > MAX_PAYLOAD_BYTES:
            raise ValueError("the payload is too long")
        if kind == "availability":
            self._read_availability(device, message.payload)
        elif kind == "info":
            self._read_info(device, message.payload)
        elif kind == "rule":
            self._read_rule(device, name, message.payload)
        else:
            self._read_target(device, name, message, now_s)

    def _read_availability(self, device: Device, payload: bytes) -> None:
        if payload:
            device.is_online = _AVAILABILITIES.get(payload)
            device.unreadable += device.is_online is None
        else:  # somebody had the broker forget it
            self._count(device.name, -1 - len(device.targets) - len(device.standing) - len(device.unjudged))
            del self.devices[device.name]

    def _read_info(self, device: Device, payload: bytes) -> None:
        info = _decode(payload, DeviceInfo)
        clean = DeviceInfo(_clean(info.version), _clean(info.configuration_sha256), _clean(info.boot_id))
        if device.info.boot_id not in {"", clean.boot_id}:  # a new run may have other targets
            self._count(device.name, -len(device.targets))
            device.targets.clear()
        device.info = clean

    def _read_rule(self, device: Device, name: str, payload: bytes) -> None:
        state = _decode(payload, _RulePayload) if payload else _RulePayload(active=False)
        is_alarm = state.severity is not None
        before = (name in device.standing) + (name in device.unjudged)
        device.standing.pop(name, None)
        device.unjudged.discard(name)
        self._count(device.name, -before)
        if is_alarm and (state.active or not state.acknowledged) and self._has_room(device.name):
            device.standing[name] = StandingAlarm(
                device=device.name,
                rule=name,
                severity=_clean(state.severity or ""),
                is_acknowledged=state.acknowledged,
                inhibits=tuple(_clean(each) for each in state.inhibits[:8]),
                since=_clean(state.since),
                reason=_clean(state.reason),
            )
        elif is_alarm and state.active is None and self._has_room(device.name):
            device.unjudged.add(name)

    def _read_target(self, device: Device, name: str, message: Received, now_s: float) -> None:
        state = _decode(message.payload, _TargetPayload)
        before = device.targets.get(name)
        if before is None and not self._has_room(device.name):
            return
        if before is not None and state.seq > before.sequence:
            device.missed += state.seq - before.sequence - 1
        at_s = _sent_s(message, now_s)
        device.targets[name] = TargetReport(_clean(state.status), state.distance_m, state.sigma_m, state.seq, at_s)
        if at_s is not None:
            device.newest_s = max(at_s, device.newest_s or at_s)


def _sent_s(message: Received, now_s: float) -> float | None:
    """Return when the state of a target was sent: of one that the broker kept, what is left of its life says so."""
    if not message.is_retained:
        return now_s
    is_known = message.expires_s is not None and message.expires_s <= EXPIRES_S
    return now_s - (EXPIRES_S - message.expires_s) if is_known and message.expires_s is not None else None


def _decode(payload: bytes, model: type[PayloadT]) -> PayloadT:
    return msgspec.json.decode(payload, type=model)


def _clean(text: str) -> str:
    return one_line(text[:MAX_TEXT_CHARACTERS])


def fleet_record(fleet: Fleet, now_s: float) -> dict[str, Any]:
    """Return the fleet as ``fleet --json`` prints it. Ages are in seconds, and null where they are not known."""
    return {
        "devices": [_device_record(device, now_s) for _, device in sorted(fleet.devices.items())],
        "alarms": [msgspec.to_builtins(alarm) for alarm in fleet.standing],
        "messages": fleet.messages,
        "passed_over": fleet.passed_over,
    }


def troubles(fleet: Fleet, now_s: float) -> list[str]:
    """Return, as sentences, why not all is well: devices that are not online, and serious alarms that stand."""
    found = [] if fleet.devices else [f"no device was heard below {fleet.root}/"]
    statuses = {device.name: device.status(now_s) for device in fleet.devices.values()}
    found += [f"{name}: {status}" for name, status in sorted(statuses.items()) if status != "online"]
    found += [
        f"{alarm.device}/{alarm.rule}: {alarm.severity or 'alarm of unknown severity'}: {alarm.reason}"
        for alarm in fleet.standing
        if alarm.is_serious
    ]
    if fleet.passed_over:
        found.append(f"{fleet.passed_over} messages were passed over: there was no room for them, or no such topic")
    return found


def age_s(at_s: float | None, now_s: float) -> float | None:
    """Return the age of something."""
    return None if at_s is None else round(max(0.0, now_s - at_s), 1)


def _device_record(device: Device, now_s: float) -> dict[str, Any]:
    return {
        "device": device.name,
        "status": device.status(now_s),
        "age_s": age_s(device.newest_s, now_s),
        **msgspec.to_builtins(device.info),
        "targets": [
            {
                "target": name,
                "status": target.status,
                "distance_m": target.distance_m,
                "sigma_m": target.sigma_m,
                "sequence": target.sequence,
                "age_s": age_s(target.at_s, now_s),
            }
            for name, target in sorted(device.targets.items())
        ],
        "standing": len(device.standing),
        "unjudged": sorted(device.unjudged),
        "unreadable": device.unreadable,
        "missed": device.missed,
    }
