"""Messages for other programs: which ones a run publishes, and how often.

============================  ===  ======  ========================================================================
topic, below the base         QoS  retain  when
============================  ===  ======  ========================================================================
``target/<name>/state``       0    yes     status changes at once; else at most twice a second when the target moved,
                                           and every 5 s. Expires after 10 s
``rule/<name>/state``         1    yes     whether it is active, acknowledged, latched, kept quiet or blind at once;
                                           other changes at most twice a second
``rule/<name>/availability``  1    yes     ``offline`` while it is unknown whether the rule is active, else ``online``
``rule/<name>/settings``      1    yes     of an alarm: its thresholds, whether it is in service and whether it is only
                                           observed; at the start, and when one of these changes
``figure/<name>/state``       1    yes     a remembered figure has changed; every 2 s at most
``info``                      1    yes     what runs: the version, the configuration's SHA-256, and the id of the run
``event/alarm``               1    never   what happened to a rule: raised, cleared, acknowledged, shelved and so on
``event/system``              1    never   what happened to a target, camera or output: target_seen, target_lost,
                                           fault, fault_cleared; to all outputs: stopped, released, disarmed,
                                           armed; or to messages: given_up
============================  ===  ======  ========================================================================

Payloads are JSON objects whose keys and their order are fixed; ``v`` is the version of that form. Numbers are in SI
units, rounded to the millimetre and the milliradian. What is not known is null, never NaN. Times are labels for
people: receivers order by ``seq`` and ``id``, since the clock of a Raspberry Pi jumps at its first time sync.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import stadimeter
from stadimeter.app.figure_reports import FigureReports, figure_topics
from stadimeter.app.pose_reports import PoseReports
from stadimeter.core.alarms.machine import AlarmRecord
from stadimeter.core.alarms.settings import show_thresholds
from stadimeter.core.conditions.summary import RememberedFigure
from stadimeter.core.decision import SYSTEM_EVENTS, Decision, Event, EventKind, RuleStatus, RuleTrace, Severity
from stadimeter.core.measurement import Track
from stadimeter.core.message import Message, Notification, clearing
from stadimeter.core.rule import AlarmRule, AnyRule, ReportRule, gate_of
from stadimeter.core.rules.explaining import Reasons
from stadimeter.core.safety import OUTPUTS

FORM = 1
INFO = "info"
INTERVAL_S = 0.5
HEARTBEAT_S = 5.0
EXPIRES_S = 10
DEADBAND_M = 0.01
DEADBAND_SIGMAS = 0.5

WallClock = Callable[[], str]

_JSON = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False, allow_nan=False)


class Reporter:
    """Composes the messages of a run. It does no I/O and reads no clock.

    Args:
        boot_id: Identifies the run. With an event's sequence number it makes an id by which receivers notice a
            message that came twice.

    Attributes:
        clips: The name of the newest clip of each rule or source.
        retained: The topics on which the run publishes messages that a broker retains without expiry.
        reported_losses: How much was given up, by notifier, as it was last reported.
    """

    def __init__(self, boot_id: str) -> None:
        self.retained: frozenset[str] = frozenset()
        self.clips: Mapping[str, str] = {}
        self._boot_id = boot_id
        self._severities: Mapping[str, Severity] = {}
        self._targets: dict[str, _TargetReports] = {}
        self._rules: dict[str, _RuleReports] = {}
        self._figures = FigureReports()
        self.poses = PoseReports()
        self._rules_before: tuple[RuleTrace, ...] = ()
        self._held_back: set[str] = set()
        self.reported_losses: Mapping[str, int] = {}

    def messages(self, now_s: float, wall_clock: WallClock, decision: Decision, mark: str = "") -> tuple[Message, ...]:
        """Return the messages to report after each cycle: events, rules, targets with the mark of their distances."""
        messages = [_event_message(event, self._boot_id, wall_clock(), self.clips) for event in decision.events]
        messages += self._rule_messages(now_s, wall_clock, decision)
        messages += self._figures.messages(now_s, wall_clock, decision.figures)
        for track in decision.tracks:
            told = self._targets.setdefault(track.target, _TargetReports())
            messages += told.messages(now_s, wall_clock, track, mark)
        return tuple(messages)

    def _rule_messages(self, now_s: float, wall_clock: WallClock, decision: Decision) -> list[Message]:
        messages: list[Message] = []
        for trace in self._changed(decision):
            time = wall_clock()
            reports = self._rules.setdefault(trace.rule, _RuleReports())
            events = [event.kind for event in decision.events if event.source == trace.rule]
            if reports.is_due(now_s, time, trace, events, self._severities.get(trace.rule)):
                messages += reports.tell(now_s, time, trace, decision.reasons.get(trace.rule, ""))
            messages += reports.settings(trace.rule, decision.reasons)
            (self._held_back.add if reports.is_held_back else self._held_back.discard)(trace.rule)
        return messages

    def _changed(self, decision: Decision) -> list[RuleTrace]:
        """Return the rules that there may be news of: of a hundred, few change in a cycle."""
        before, self._rules_before = self._rules_before, decision.rules
        names = self._held_back | {event.source for event in decision.events}
        if before is decision.rules and not names:
            return []
        if len(before) != len(decision.rules):
            return list(decision.rules)
        pairs = zip(decision.rules, before, strict=True)
        return [trace for trace, last in pairs if trace is not last or trace.rule in names]

    def opening(self, rules: Iterable[AnyRule], figures: Iterable[RememberedFigure] = ()) -> tuple[Message, ...]:
        """Report, before the first cycle, that no rule is judged yet: what the broker has kept is an earlier run's."""
        self.retained, self._severities = _retained_topics(rules) | figure_topics(figures), _severities(rules)
        return tuple(_availability(rule.name, is_known=False) for rule in rules)

    def reload(self, rules: Iterable[AnyRule], figures: Iterable[RememberedFigure] = ()) -> tuple[Message, ...]:
        """Go by other rules from now on; return what has the broker forget those that are no more."""
        before, self.retained = self.retained, _retained_topics(rules) | figure_topics(figures)
        self._severities, self._figures = _severities(rules), FigureReports()
        gone = self._rules.keys() - {rule.name for rule in rules}
        self._held_back = {rule.name for rule in rules}  # each is looked at once more: its severity may be another
        for name in gone:
            del self._rules[name]
        return clearing(before - self.retained)

    def info(self, configuration_sha256: str) -> Message:
        """Return the message on what runs, at the start and after each reload."""
        payload = {
            "v": FORM,
            "version": stadimeter.__version__,
            "configuration_sha256": configuration_sha256,
            "boot_id": self._boot_id,
        }
        return _message(INFO, payload, qos=1, retain=True)

    def given_up(self, now_s: float, wall_clock: WallClock, counts: Mapping[str, int]) -> tuple[Message, ...]:
        """Report, as events, what was given up since the last call, by notifier; the empty name is the messenger."""
        before, self.reported_losses = self.reported_losses, counts
        return tuple(
            _given_up_message(name, count, self._boot_id, now_s, wall_clock())
            for name, count in counts.items()
            if count != before.get(name)
        )

    def repeat(self, wall_clock: str) -> tuple[Message, ...]:
        """Return the messages a broker keeps only for a while, for those who may have lost them: states of targets."""
        return tuple(message for reports in self._targets.values() for message in reports.repeat(wall_clock))

    def last_messages(self, wall_clock: str) -> tuple[Message, ...]:
        """Return, for the end of a run, the newest state of every target, and that no rule is judged any more."""
        targets = (message for reports in self._targets.values() for message in reports.last_messages(wall_clock))
        rules = (
            message for name, reports in self._rules.items() for message in reports.last_messages(name, wall_clock)
        )
        return (*targets, *rules)


class _TargetReports:
    """Decides when the state of one target is published."""

    def __init__(self) -> None:
        self._told: Mapping[str, Any] | None = None
        self._told_at_s = -math.inf
        self._newest: Track | None = None
        self._sequence = 0
        self._mark = ""

    def messages(self, now_s: float, wall_clock: WallClock, track: Track, mark: str) -> list[Message]:
        self._newest, self._mark = track, mark
        if not self._is_due(track, now_s - self._told_at_s):
            return []
        self._told_at_s = now_s
        return [self._tell(track, wall_clock())]

    def last_messages(self, wall_clock: str) -> list[Message]:
        if self._newest is None or _target_state(self._newest, self._mark) == self._told:
            return []
        return [self._tell(self._newest, wall_clock)]

    def repeat(self, wall_clock: str) -> list[Message]:
        return [] if self._newest is None else [self._tell(self._newest, wall_clock)]

    def _is_due(self, track: Track, silent_s: float) -> bool:
        told, state = self._told, _target_state(track, self._mark)
        if told is None or silent_s >= HEARTBEAT_S or told["status"] != state["status"] or len(told) != len(state):
            return True
        return silent_s >= INTERVAL_S and _has_moved(told, state)

    def _tell(self, track: Track, wall_clock: str) -> Message:
        self._told = _target_state(track, self._mark)
        payload = {"v": FORM, "ts": wall_clock, "seq": self._sequence, **self._told}
        self._sequence += 1
        return _message(f"target/{track.target}/state", payload, qos=0, retain=True, expires_s=EXPIRES_S)


def _target_state(track: Track, mark: str) -> dict[str, Any]:
    """Return the published state of a target: only figures that may be acted on, marked if they are unconfirmed."""
    known = track if track.is_valid else Track(target=track.target)
    figures = ("distance_m", "sigma_m", "closing_mps", "bearing_rad")
    marked = {"mounting": mark} if mark else {}
    return {"status": track.status.value, **{name: _rounded(getattr(known, name)) for name in figures}, **marked}


def _has_moved(before: Mapping[str, Any], now: Mapping[str, Any]) -> bool:
    """Check whether the difference matters: the target moved, along or across the line of sight, by the deadband."""
    if now["distance_m"] is None or before["distance_m"] is None:
        return now["distance_m"] is not before["distance_m"]
    deadband_m = max(DEADBAND_M, DEADBAND_SIGMAS * (now["sigma_m"] or 0.0))
    along_m = abs(now["distance_m"] - before["distance_m"])
    across_m = now["distance_m"] * abs((now["bearing_rad"] or 0.0) - (before["bearing_rad"] or 0.0))
    return bool(max(along_m, across_m) > deadband_m)


class _RuleReports:
    """Decides when the state of one rule is published: not when its reason alone changes, as its figures often do."""

    def __init__(self) -> None:
        self._newest: Mapping[str, Any] = {}
        self._told: Mapping[str, Any] | None = None
        self._told_at_s = -math.inf
        self._is_data_lost = False
        self._since = ""
        self._set_as: tuple[AlarmRule, bool] | None = None
        self._settings: Message | None = None

    @property
    def is_held_back(self) -> bool:
        """True while the newest state is not published yet."""
        return self._newest != self._told

    def is_due(
        self, now_s: float, wall_clock: str, trace: RuleTrace, events: list[EventKind], severity: Severity | None
    ) -> bool:
        """Take in a cycle, and return whether it is to be published."""
        for kind in events:
            if kind in {EventKind.MEASUREMENT_LOST, EventKind.MEASUREMENT_BACK}:
                self._is_data_lost = kind is EventKind.MEASUREMENT_LOST
        state = _rule_state(trace, severity, is_data_lost=self._is_data_lost)
        if not self._since or state["active"] is not self._newest["active"]:
            self._since = wall_clock
        self._newest, told = state, self._told
        if told is None or _urgent(state) != _urgent(told):
            return True
        return state != told and now_s - self._told_at_s >= INTERVAL_S

    def tell(self, now_s: float, wall_clock: str, trace: RuleTrace, reason: str) -> list[Message]:
        """Return the newest state as a message, and whether it can be relied on if that has changed.

        Who goes by both never sees a state that is none: a rule becomes unavailable before, and available after.
        """
        was_known = None if self._told is None else self._told["active"] is not None
        state = self._told = self._newest
        self._told_at_s = now_s
        is_known = state["active"] is not None
        messages = [self._state_message(trace.rule, wall_clock, state, reason)]
        if is_known is not was_known:
            messages.insert(1 if is_known else 0, _availability(trace.rule, is_known=is_known))
        return messages

    def last_messages(self, rule: str, wall_clock: str) -> list[Message]:
        """Return that it is not judged any more; nothing if that was published already."""
        if self._told is None or self._told["active"] is None:
            return []
        unknown = {**self._newest, "active": None, "status": RuleStatus.UNKNOWN.value}
        self._since, self._told = wall_clock, unknown
        state = self._state_message(rule, wall_clock, unknown, "the run has ended")
        return [_availability(rule, is_known=False), state]

    def _state_message(self, rule: str, wall_clock: str, state: Mapping[str, Any], reason: str) -> Message:
        payload = {"v": FORM, "ts": wall_clock, **state, "since": self._since, "reason": reason}
        return _message(f"rule/{rule}/state", payload, qos=1, retain=True)

    def settings(self, rule: str, reasons: Mapping[str, str]) -> list[Message]:
        """Return the settings of an alarm, as a message, if they have changed. The same rule is set as before."""
        found = reasons.record_of(rule) if isinstance(reasons, Reasons) else None
        if found is None:
            self._set_as = self._settings = None
            return []
        alarm, record = found
        is_out, was = record.inhibits.is_out_of_service, self._set_as
        if was is not None and was[0] is alarm and was[1] is is_out:
            return []
        before, self._set_as = self._settings, (alarm, is_out)
        self._settings = _message(f"rule/{rule}/settings", _settings(alarm, record), qos=1, retain=True)
        return [] if before == self._settings else [self._settings]


def _settings(rule: AlarmRule, record: AlarmRecord) -> dict[str, Any]:
    """Return the published settings of a rule. Rounded bounds are still taken."""
    thresholds = {
        key: {
            "value": _rounded(each.value),
            "configured": _rounded(each.configured),
            "unit": each.unit,
            "min": math.ceil(each.min * 1e3) / 1e3,
            "max": math.floor(each.max * 1e3) / 1e3,
            "set_by": each.set_by,
        }
        for key, each in show_thresholds(rule, record).items()
    }
    in_service = not record.inhibits.is_out_of_service
    return {"v": FORM, "thresholds": thresholds, "in_service": in_service, "observed": rule.observe}


def _rule_state(trace: RuleTrace, severity: Severity | None, *, is_data_lost: bool) -> dict[str, Any]:
    """Return the state of a rule that is published when it changes."""
    return {
        "active": active_or_unknown(trace),
        "status": trace.status.value,
        "severity": severity.value if severity is not None else None,
        "acknowledged": trace.acknowledged,
        "latched": trace.status is RuleStatus.LATCHED,
        "first_out": trace.first_out,
        "inhibits": trace.inhibits,
        "chattering": trace.chattering,
        "data_lost": is_data_lost,
    }


def _urgent(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part that is published at once; a target at the edge of sight may become unknown in any frame."""
    return {**state, "status": "", "active": state["active"] is True}


def active_or_unknown(trace: RuleTrace) -> bool | None:
    """Check whether a rule is active; None also where its policy for a lost target has let it go."""
    return trace.active or (None if trace.status is RuleStatus.UNKNOWN else trace.active)


def _availability(rule: str, *, is_known: bool) -> Message:
    return Message(topic=f"rule/{rule}/availability", payload="online" if is_known else "offline", qos=1, retain=True)


def _severities(rules: Iterable[AnyRule]) -> dict[str, Severity]:
    """Return the severity of each alarm; other rules have none."""
    return {rule.name: rule.severity for rule in rules if isinstance(rule, AlarmRule)}


def _retained_topics(rules: Iterable[AnyRule]) -> frozenset[str]:
    own = {f"rule/{rule.name}/{what}" for rule in rules for what in ("state", "availability", "settings")}
    senders = [gate_of(rule) for rule in rules if isinstance(rule, AlarmRule | ReportRule)]
    steps = [step for rule in senders for step in rule.escalation]
    return frozenset(own | {step.send.topic for step in steps if step.send is not None and step.send.retain})


def _event_message(event: Event, boot_id: str, wall_clock: str, clips: Mapping[str, str]) -> Message:
    is_of_rule = event.kind not in SYSTEM_EVENTS and event.source != OUTPUTS
    payload: dict[str, object] = {
        "v": FORM,
        "ts": wall_clock,
        "id": f"{boot_id}-{event.sequence}",
        "event_type": event.kind.value,
        "rule" if is_of_rule else "source": event.source,
        "severity": event.severity.value,
        "reason": event.reason,
        "distance_m": _rounded(event.distance_m),
        "sigma_m": _rounded(event.sigma_m),
    }
    if is_of_rule:
        payload |= {"notify": event.notify, "first_out": event.first_out, "by": event.by or None}
    payload["clip"] = clips.get(event.source)
    return _event("event/alarm" if is_of_rule else "event/system", payload, event.severity, event.at_s)


def _given_up_message(name: str, count: int, boot_id: str, now_s: float, wall_clock: str) -> Message:
    source = name or "messenger"
    payload = {
        "v": FORM,
        "ts": wall_clock,
        "id": f"{boot_id}-{source}-{count}",
        "event_type": "given_up",
        "source": source,
        "severity": Severity.WARNING.value,
        "reason": f"{'notifications' if name else 'messages'} given up since the start: {count}",
        "distance_m": None,
        "sigma_m": None,
        "clip": None,
    }
    return _event("event/system", payload, Severity.WARNING, now_s)


def _event(topic: str, payload: Mapping[str, object], severity: Severity, at_s: float) -> Message:
    return Message(topic=topic, payload=_JSON.encode(payload), qos=1, severity=severity, at_s=at_s)


def is_state(item: Message | Notification) -> bool:
    """Check if it says how things are, and not what happened: each run says so anew, so no older one is sent again."""
    return isinstance(item, Message) and (
        item.qos == 0 or item.topic.startswith(("camera/", "figure/", "info", "rule/"))
    )


def _message(
    topic: str, payload: Mapping[str, object], *, qos: int, retain: bool, expires_s: int | None = None
) -> Message:
    return Message(topic=topic, payload=_JSON.encode(payload), qos=qos, retain=retain, expires_s=expires_s)


def _rounded(value: float | None) -> float | None:
    """Return a number to three decimals; None for what is not a finite number."""
    if value is None or not math.isfinite(value):
        return None
    return round(value, 3) + 0.0  # adding zero turns -0.0 into 0.0
