"""The messages of a run: pure functions from a record to its messages, and when the next one is due.

The topics, and how often each is published, are `stadimeter.core.message.OWN_TOPICS`; `docs/reference/topics.md` shows
every form.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from msgspec import Struct

import stadimeter
from stadimeter.app.deliveries import MESSENGER, Undelivered
from stadimeter.core import message as topics
from stadimeter.core import templates
from stadimeter.core.alarms.machine import AlarmRecord, show_thresholds
from stadimeter.core.camera_pose import CameraPose
from stadimeter.core.conditions.remembered import RememberedFigure
from stadimeter.core.decision import SYSTEM_EVENTS, Decision, Event, EventKind, Notice, RuleStatus, RuleTrace, Severity
from stadimeter.core.measurement import Track
from stadimeter.core.message import Message, Notification, OwnTopic, clearing
from stadimeter.core.rule import AlarmRule, AnyRule, ReportRule, Send, Template, gate_of
from stadimeter.core.rules.explaining import Reasons
from stadimeter.core.safety import OUTPUTS

if TYPE_CHECKING:
    from stadimeter.app.live.health import LiveHealth

FORM = 1

# What counts as a move: of a target 1 cm, of the camera 1 cm or half a degree; and half a standard deviation.
DEADBAND_M, DEADBAND_RAD, DEADBAND_SIGMAS = 0.01, math.radians(0.5), 0.5

# Without a frame for this long, nothing is known of any target: it is not "out of sight".
SILENT_S = 2.0

MAX_TITLE_CHARACTERS = 120

WallClock = Callable[[], str]

_JSON = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False, allow_nan=False)


class Reporter:
    """Composes the messages of a run, and remembers what it published last. It does no I/O and reads no clock.

    Args:
        boot_id: Identifies the run. With an event's sequence number it makes an id by which receivers notice a
            message that came twice.

    Attributes:
        clips: The name of the newest clip of each rule or source.
        retained: The topics of rules, figures and users on which a broker retains messages without expiry.
        reported_losses: How much was given up, by notifier, as it was last reported.
    """

    def __init__(self, boot_id: str) -> None:
        self.retained: frozenset[str] = frozenset()
        self.clips: Mapping[str, str] = {}
        self.reported_losses: Mapping[str, int] = {}
        self._boot_id = boot_id
        self._severities: Mapping[str, Severity] = {}
        self._targets: dict[str, _Target] = {}
        self._rules: dict[str, _Rule] = {}
        self._figures: dict[str, _Told] = {}
        self._pose, self._camera, self._health = _Told(), _Told(), _Told()

    def messages(self, now_s: float, wall_clock: WallClock, decision: Decision, mark: str = "") -> tuple[Message, ...]:
        """Return the messages to report after each cycle: events, rules, targets with the mark of their distances."""
        messages = [event_message(event, self._boot_id, wall_clock(), self.clips) for event in decision.events]
        sources = {event.source for event in decision.events}
        for trace in decision.rules:
            rule = self._rules.get(trace.rule) or self._rules.setdefault(trace.rule, _Rule())
            if rule.trace is not trace or trace.rule in sources:  # of a hundred, few change in a cycle
                severity = self._severities.get(trace.rule)
                messages += rule.messages(now_s, wall_clock(), trace, severity, decision)
                rule.trace = trace if rule.newest == rule.state else None
        for name, figure in decision.figures.items():
            told, value = self._figures.setdefault(name, _Told()), _rounded(figure)
            if told.take(topics.FIGURE_STATE, now_s, {"value": value}):
                messages.append(_message(topics.FIGURE_STATE, {"ts": wall_clock(), "value": value}, name))
        for track in decision.tracks:
            messages += self._targets.setdefault(track.target, _Target()).messages(now_s, wall_clock, track, mark)
        return tuple(messages)

    def pose(self, now_s: float, wall_clock: WallClock, pose: CameraPose | None) -> tuple[Message, ...]:
        """Report where the camera is; nothing without a new pose."""
        if pose is None or not self._pose.take(topics.CAMERA_POSE, now_s, pose, has_changed=_is_elsewhere):
            return ()
        return (_message(topics.CAMERA_POSE, {"ts": wall_clock(), **pose_figures(pose)}),)

    def health(
        self,
        now_s: float,
        wall_clock: WallClock,
        frame_age_s: float | None,
        figures: Callable[[], Mapping[str, Any]] | None,
    ) -> tuple[Message, ...]:
        """Report whether the camera delivers, and now and then the run's `figures`; None before its first cycle."""
        is_online = frame_age_s is not None and frame_age_s < SILENT_S
        messages = []
        if self._camera.take(topics.CAMERA_STATE, now_s, is_online):
            messages.append(_online(topics.CAMERA_STATE, is_online=is_online))
        if figures is not None and self._health.take(topics.HEALTH, now_s, None):
            known = {"ts": wall_clock(), "version": stadimeter.__version__, **figures()}
            messages.append(_message(topics.HEALTH, known))
        return tuple(messages)

    def opening(self, rules: Iterable[AnyRule], figures: Iterable[RememberedFigure] = ()) -> tuple[Message, ...]:
        """Report, before the first cycle, that no rule is judged yet: what the broker has kept is an earlier run's."""
        self.retained, self._severities = _retained_topics(rules, figures), _severities(rules)
        return tuple(_online(topics.RULE_AVAILABILITY, rule.name, is_online=False) for rule in rules)

    def reload(self, rules: Iterable[AnyRule], figures: Iterable[RememberedFigure] = ()) -> tuple[Message, ...]:
        """Go by other rules from now on; return what has the broker forget those that are no more."""
        before, self.retained = self.retained, _retained_topics(rules, figures)
        self._severities, self._figures = _severities(rules), {}
        gone = self._rules.keys() - {rule.name for rule in rules}
        for name in gone:
            del self._rules[name]
        for rule in self._rules.values():
            rule.trace = None  # its severity may be another
        return clearing(before - self.retained)

    def info(self, configuration_sha256: str) -> Message:
        """Return the message on what runs, at the start and after each reload."""
        payload = {"version": stadimeter.__version__, "configuration_sha256": configuration_sha256}
        return _message(topics.INFO, {**payload, "boot_id": self._boot_id})

    def given_up(self, now_s: float, wall_clock: WallClock, counts: Mapping[str, int]) -> tuple[Message, ...]:
        """Report, as events, what was given up since the last call, by notifier; the empty name is the messenger."""
        before, self.reported_losses = self.reported_losses, counts
        return tuple(
            given_up_message(name, count, self._boot_id, now_s, wall_clock())
            for name, count in counts.items()
            if count != before.get(name)
        )

    def repeat(self, wall_clock: str) -> tuple[Message, ...]:
        """Return the messages a broker keeps only for a while, for those who may have lost them: states of targets.

        The health of the run is due after this.
        """
        self._health = _Told()
        return tuple(target.tell(wall_clock) for target in self._targets.values())

    def last_messages(self, wall_clock: str) -> tuple[Message, ...]:
        """Return, for the end of a run, the newest states, that no rule is judged any more, and no camera delivers."""
        messages = [target.tell(wall_clock) for target in self._targets.values() if target.newest != target.state]
        for name, rule in self._rules.items():
            messages += rule.last_messages(name, wall_clock)
        if self._camera.state:
            messages.append(_online(topics.CAMERA_STATE, is_online=False))
        return tuple(messages)


def _same(_state: Any) -> Any:
    return None


def _differs(before: Any, now: Any) -> bool:
    return bool(before != now)


class _Told(Struct):
    """The state that was published last on a topic, and when.

    Attributes:
        newest: The state of the newest cycle, which may not be published yet.
    """

    state: Any = None
    at_s: float = -math.inf
    newest: Any = None

    def take(
        self,
        topic: OwnTopic,
        now_s: float,
        state: Any,
        *,
        urgent: Callable[[Any], Any] = _same,
        has_changed: Callable[[Any, Any], bool] = _differs,
    ) -> bool:
        """Take in a state, and return whether it is to be published now; then it counts as published.

        Args:
            urgent: Returns what of a state is published at once when it changes.
            has_changed: Checks whether the rest differs by what matters.
        """
        self.newest, before, silent_s = state, self.state, now_s - self.at_s
        is_due = self.at_s == -math.inf or silent_s >= topic.heartbeat_s or urgent(before) != urgent(state)
        if not is_due and (silent_s < topic.interval_s or not has_changed(before, state)):
            return False
        self.state, self.at_s = state, now_s
        return True


class _Target(_Told):
    """The state of a target that was published last; `sequence` counts them."""

    target: str = ""
    sequence: int = 0

    def messages(self, now_s: float, wall_clock: WallClock, track: Track, mark: str) -> list[Message]:
        self.target, state = track.target, target_state(track, mark)
        if not self.take(topics.TARGET_STATE, now_s, state, urgent=_urgent_of_target, has_changed=_has_moved):
            return []
        return [self.tell(wall_clock())]

    def tell(self, wall_clock: str) -> Message:
        """Return the newest state as a message."""
        self.state = self.newest
        payload = {"ts": wall_clock, "seq": self.sequence, **self.newest}
        self.sequence += 1
        return _message(topics.TARGET_STATE, payload, self.target)


class _Rule(_Told):
    """The state and the settings of a rule that were published last.

    Attributes:
        trace: What it did when that was published; None while a newer state is held back.
        is_data_lost: Whether its alarm stands and nothing can confirm it.
        since: The time of day since which it has been active or not.
        set_as: The rule and whether it is out of service, as they were when its settings were looked at last.
    """

    trace: RuleTrace | None = None
    is_data_lost: bool = False
    since: str = ""
    set_as: tuple[AlarmRule, bool] | None = None
    settings: Message | None = None

    def messages(
        self, now_s: float, wall_clock: str, trace: RuleTrace, severity: Severity | None, decision: Decision
    ) -> list[Message]:
        for event in decision.events:
            if event.source == trace.rule and event.kind in {EventKind.MEASUREMENT_LOST, EventKind.MEASUREMENT_BACK}:
                self.is_data_lost = event.kind is EventKind.MEASUREMENT_LOST
        before, state = self.state, rule_state(trace, severity, is_data_lost=self.is_data_lost)
        if not self.since or state["active"] is not self.newest["active"]:
            self.since = wall_clock
        messages = []
        if self.take(topics.RULE_STATE, now_s, state, urgent=_urgent_of_rule):
            reason = decision.reasons.get(trace.rule, "")
            messages = rule_messages(trace.rule, wall_clock, before, state, self.since, reason)
        return messages + self._settings(trace.rule, decision.reasons)

    def last_messages(self, rule: str, wall_clock: str) -> list[Message]:
        """Return that it is not judged any more; nothing if that was published already."""
        if self.state is None or self.state["active"] is None:
            return []
        before, self.since = self.state, wall_clock
        self.state = {**self.newest, "active": None, "status": RuleStatus.UNKNOWN.value}
        return rule_messages(rule, wall_clock, before, self.state, wall_clock, "the run has ended")

    def _settings(self, rule: str, reasons: Mapping[str, str]) -> list[Message]:
        """Return the settings of an alarm, as a message, if they have changed. The same rule is set as before."""
        found = reasons.record_of(rule) if isinstance(reasons, Reasons) else None
        if found is None:
            self.set_as = self.settings = None
            return []
        alarm, record = found
        is_out, was = record.inhibits.is_out_of_service, self.set_as
        if was is not None and was[0] is alarm and was[1] is is_out:
            return []
        before, self.set_as = self.settings, (alarm, is_out)
        self.settings = _message(topics.RULE_SETTINGS, rule_settings(alarm, record), rule)
        return [] if before == self.settings else [self.settings]


# From a record to what is published of it -----------------------------------------------------------


def target_state(track: Track, mark: str) -> dict[str, Any]:
    """Return the published state of a target: only figures that may be acted on, marked if they are unconfirmed."""
    known = track if track.is_valid else Track(target=track.target)
    figures = ("distance_m", "sigma_m", "closing_mps", "bearing_rad")
    marked = {"mounting": mark} if mark else {}
    return {"status": track.status.value, **{name: _rounded(getattr(known, name)) for name in figures}, **marked}


def _urgent_of_target(state: Mapping[str, Any]) -> tuple[str, int]:
    return state["status"], len(state)


def _has_moved(before: Mapping[str, Any], now: Mapping[str, Any]) -> bool:
    """Check whether the difference matters: the target moved, along or across the line of sight, by the deadband."""
    if now["distance_m"] is None or before["distance_m"] is None:
        return now["distance_m"] is not before["distance_m"]
    deadband_m = max(DEADBAND_M, DEADBAND_SIGMAS * (now["sigma_m"] or 0.0))
    along_m = abs(now["distance_m"] - before["distance_m"])
    across_m = now["distance_m"] * abs((now["bearing_rad"] or 0.0) - (before["bearing_rad"] or 0.0))
    return bool(max(along_m, across_m) > deadband_m)


def rule_state(trace: RuleTrace, severity: Severity | None, *, is_data_lost: bool) -> dict[str, Any]:
    """Return the state of a rule that is published when it changes: its reason alone, with its figures, often does."""
    return {
        "active": trace.active_or_unknown,
        "status": trace.status.value,
        "severity": severity.value if severity is not None else None,
        "acknowledged": trace.acknowledged,
        "latched": trace.status is RuleStatus.LATCHED,
        "first_out": trace.first_out,
        "inhibits": trace.inhibits,
        "chattering": trace.chattering,
        "data_lost": is_data_lost,
    }


def _urgent_of_rule(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part that is published at once; a target at the edge of sight may become unknown in any frame."""
    return {**state, "status": "", "active": state["active"] is True}


def rule_messages(
    rule: str, wall_clock: str, before: Mapping[str, Any] | None, state: Mapping[str, Any], since: str, reason: str
) -> list[Message]:
    """Return a state of a rule, and whether it can be relied on if that has changed since the one before.

    Those who go by both never see a state that is none: a rule becomes unavailable before, and available after.
    """
    was_known = None if before is None else before["active"] is not None
    is_known = state["active"] is not None
    messages = [_message(topics.RULE_STATE, {"ts": wall_clock, **state, "since": since, "reason": reason}, rule)]
    if is_known is not was_known:
        messages.insert(1 if is_known else 0, _online(topics.RULE_AVAILABILITY, rule, is_online=is_known))
    return messages


def rule_settings(rule: AlarmRule, record: AlarmRecord) -> dict[str, Any]:
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
    return {"thresholds": thresholds, "in_service": in_service, "observed": rule.observe}


def _severities(rules: Iterable[AnyRule]) -> dict[str, Severity]:
    """Return the severity of each alarm; other rules have none."""
    return {rule.name: rule.severity for rule in rules if isinstance(rule, AlarmRule)}


def _retained_topics(rules: Iterable[AnyRule], figures: Iterable[RememberedFigure]) -> frozenset[str]:
    names = {"rule": [rule.name for rule in rules], "figure": [figure.name for figure in figures]}
    kept = [topic for topic in topics.OWN_TOPICS if topic.is_kept_by_name]
    own = {topic.of(name) for topic in kept for name in names[topic.first_level]}
    senders = [gate_of(rule) for rule in rules if isinstance(rule, AlarmRule | ReportRule)]
    steps = [step for rule in senders for step in rule.escalation]
    return frozenset(own | {step.send.topic for step in steps if step.send is not None and step.send.retain})


def event_message(event: Event, boot_id: str, wall_clock: str, clips: Mapping[str, str]) -> Message:
    """Return the message of an event of a rule, or of the system."""
    is_of_rule = event.kind not in SYSTEM_EVENTS and event.source != OUTPUTS
    payload: dict[str, object] = {
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
    topic = topics.ALARM_EVENT if is_of_rule else topics.SYSTEM_EVENT
    return _message(topic, payload, severity=event.severity, at_s=event.at_s)


def given_up_message(name: str, count: int, boot_id: str, now_s: float, wall_clock: str) -> Message:
    """Return the event that messages, or notifications of one notifier, were given up."""
    source = name or "messenger"
    payload = {
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
    return _message(topics.SYSTEM_EVENT, payload, severity=Severity.WARNING, at_s=now_s)


def pose_figures(pose: CameraPose) -> dict[str, Any]:
    """Return a pose as messages and `locate --json` have it."""
    position = dict(zip(("x_m", "y_m", "z_m"), pose.position_m or (None,) * 3, strict=True))
    angles = dict(zip(("yaw_rad", "tilt_rad", "roll_rad"), pose.angles_rad or (None,) * 3, strict=True))
    return {
        **{name: _rounded(value) for name, value in (position | angles).items()},
        "orientation": None if pose.orientation is None else [round(each, 6) + 0.0 for each in pose.orientation],
        "covariance": list(pose.covariance) or None,
        "tags": list(pose.tags),
        "moved": list(pose.moved),
        "reason": pose.reason,
    }


def _is_elsewhere(before: CameraPose, now: CameraPose) -> bool:
    """Check whether the difference matters. Of a pose that is not known there is none."""
    if (now.moved, now.position_m is None) != (before.moved, before.position_m is None):
        return True
    one, other = ((*(each.position_m or ()), *(each.angles_rad or ())) for each in (before, now))
    off = [abs(a - b) for a, b in zip(one, other, strict=False)]
    off[3:] = [abs(math.remainder(each, math.tau)) for each in off[3:]]
    floors = [DEADBAND_M] * 3 + [DEADBAND_RAD] * 3
    each_of = zip(off, floors, now.sigmas, strict=False)
    return any(moved > max(floor, DEADBAND_SIGMAS * sigma) for moved, floor, sigma in each_of)


def health_figures(health: LiveHealth, undelivered: int, given_up: int) -> dict[str, object]:
    """Return the published health of a run, with how many messages and notifications wait or were given up."""
    board, (median_s, p95_s) = health.board, health.cycle_s
    return {
        "frame_rate_hz": _rounded(health.frame_rate_hz, 1),
        "frame_age_s": _rounded(health.frame_age_s),
        "latency_s": _rounded(health.latency_s),
        "cycle_s": _rounded(median_s, 4),
        "cycle_p95_s": _rounded(p95_s, 4),
        "dropped_frames": health.dropped_frames,
        "temperature_c": _rounded(board.temperature_c, 1),
        "throttling": board.throttling,
        "disk_free_bytes": board.disk_free_bytes,
        "memory_bytes": board.memory_bytes,
        "trouble": health.trouble,
        "mounting": health.mounting.status.value if health.mounting is not None else None,
        "undelivered": undelivered,
        "given_up": given_up,
    }


def _online(topic: OwnTopic, name: str = "", *, is_online: bool) -> Message:
    return Message(topic=topic.of(name), payload="online" if is_online else "offline", qos=1, retain=True)


def _message(
    topic: OwnTopic,
    payload: Mapping[str, object],
    name: str = "",
    severity: Severity = Severity.INFO,
    at_s: float = 0.0,
) -> Message:
    return Message(
        topic=topic.of(name),
        payload=_JSON.encode({"v": FORM, **payload}),
        qos=topic.qos,
        retain=topic.retain,
        expires_s=topic.expires_s,
        severity=severity,
        at_s=at_s,
    )


def _rounded(value: float | None, digits: int = 3) -> float | None:
    """Return a number to some decimals; None for what is not a finite number."""
    if value is None or not math.isfinite(value):
        return None
    return round(value, digits) + 0.0  # adding zero turns -0.0 into 0.0


# Messages and notifications that rules send themselves ----------------------------------------------


def outgoing(
    decision: Decision,
    rules: Iterable[AnyRule],
    local_time: WallClock,
    figures: Iterable[RememberedFigure] = (),
    clips: Mapping[str, str] | None = None,
) -> Iterator[Undelivered]:
    """Yield what rules send after a cycle, filled in, in the order of the rules.

    The time (RFC 3339) is asked for if needed; ``clips`` names the newest clip of each rule.
    """
    if not decision.notices:
        return
    alarms = {rule.name: gate_of(rule) for rule in rules}
    known = {figure.name: figure.for_people(decision.figures.get(figure.name)) for figure in figures}
    time = local_time()
    for notice in decision.notices:
        rule = alarms[notice.rule]
        send = rule.escalation[notice.step].send
        if send is None:
            continue
        track = next((track for track in decision.tracks if track.target == rule.target), None)
        clip = {"clip": (clips or {}).get(notice.rule)}
        values = templates.fields(rule, notice, track, time, rule.group) | known | clip
        if send.topic:
            yield MESSENGER, _own_message(notice, send, values)
        else:
            yield send.notifier, _notification(rule, notice, send, values, time)


def _own_message(notice: Notice, send: Send, values: Mapping[str, templates.Value]) -> Message:
    return Message(
        topic=send.topic,
        payload=templates.render(send.template, values),
        qos=1,
        retain=send.retain,
        severity=notice.event.severity,
        at_s=notice.event.at_s,
    )


def _notification(
    rule: AlarmRule, notice: Notice, send: Send, values: Mapping[str, templates.Value], time: str
) -> Notification:
    title = templates.render(Template(text=send.title), values) if send.title else rule.name
    title = " ".join(title.split())[:MAX_TITLE_CHARACTERS] or rule.name
    body = templates.render(send.template, values).strip() or title
    return Notification(title=title, body=body, severity=notice.event.severity, time=time, at_s=notice.event.at_s)
