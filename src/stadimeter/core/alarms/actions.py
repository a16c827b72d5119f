"""The effects of an alarm as its state changes and while it stands: events, notifications, steps, outputs, inhibits."""

from __future__ import annotations

import math
from collections.abc import Container, Iterator

from msgspec.structs import replace

from stadimeter.core.alarms import machine
from stadimeter.core.alarms.machine import AlarmRecord, AlarmState, Trigger
from stadimeter.core.alarms.state import NO_INHIBITS, Leg
from stadimeter.core.conditions.compounds import Condition, Verdict, judge
from stadimeter.core.conditions.evidence import describe_verdict
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.decision import Event, EventKind, Notice, Severity
from stadimeter.core.measurement import Track
from stadimeter.core.rule import ROUNDING_S, AlarmRule, EscalationStep, LevelRequest, Pattern, Request, TwistRequest

_GOOD_NEWS = frozenset(
    {
        EventKind.MEASUREMENT_BACK,
        EventKind.UNSHELVED,
        EventKind.UNSUPPRESSED,
        EventKind.IN_SERVICE,
        EventKind.ACTING,
        EventKind.CALMED,
    }
)
_NO_TRACK = Track(target="")


class Evaluation:
    """One evaluation of an alarm, in one cycle: its own copy of the alarm's record, and what has happened.

    Attributes:
        rule: The alarm's rule.
        record: What the alarm remembers, a copy that the evaluation changes.
        inputs: All that the rule is judged by.
        is_first: Whether no other alarm of its group has been raised.
    """

    __slots__ = ("_state", "_was_chattering", "events", "inputs", "is_first", "notices", "record", "rule")

    def __init__(self, rule: AlarmRule, before: AlarmRecord, inputs: RuleInputs, *, is_first: bool = False) -> None:
        self.rule = rule
        self.record = before.copy()
        self.inputs = inputs
        self.is_first = is_first
        self.events: tuple[Event, ...] = ()
        self.notices: tuple[Notice, ...] = ()
        self._state = before.state
        self._was_chattering = before.is_chattering

    def judge(self, condition: Condition, leaves: tuple[bool, ...], *, is_active: bool) -> Verdict:
        """Judge a condition that the alarm goes by, given what it remembers of its parts."""
        return judge(condition, self.inputs, leaves, is_active=is_active)

    @property
    def is_quiet(self) -> bool:
        """True if anything keeps the alarm from acting and from notifying people."""
        inhibits = self.record.inhibits
        if inhibits is NO_INHIBITS:
            return self.rule.observe
        return (
            self.rule.observe
            or inhibits.is_suppressed
            or inhibits.is_out_of_service
            or inhibits.shelved_until_s is not None
        )

    def report(self, reason: str = "", by: str = "") -> None:
        """Report a raise, a return, or chattering, if the machine has brought one about since the last report.

        Args:
            reason: Why; empty for the figures of the condition.
            by: Who caused it.
        """
        record, before = self.record, self._state
        if record.state is before and record.is_chattering is self._was_chattering:
            return
        if record.is_chattering is not self._was_chattering:
            self._report_chattering()
        is_active = record.is_active
        if is_active is not (before in machine.ACTIVE):
            is_on = before in machine.JUDGED_BY_ITS_END
            reason = reason or describe_verdict(self.rule.condition, self.inputs, record.timers.leaves, is_active=is_on)
            _begin(self, reason) if is_active else _end(self, reason, by)
        self._state, self._was_chattering = record.state, record.is_chattering
        is_over = record.state is AlarmState.NORMAL and before not in {AlarmState.NORMAL, AlarmState.PENDING}
        if is_over and record.inhibits.is_one_shot:
            unshelve(self, "the alarm has returned to normal")

    def add_event(self, kind: EventKind, reason: str, *, notify: bool, by: str = "") -> Event:
        """Add an event, and return it."""
        track = self.inputs.tracks.get(self.rule.target, _NO_TRACK)
        event = Event(
            kind=kind,
            source=self.rule.name,
            at_s=self.inputs.now_s,
            severity=Severity.INFO if kind in _GOOD_NEWS else self.rule.severity,
            reason=reason,
            distance_m=track.distance_m if track.is_valid else None,
            sigma_m=track.sigma_m if track.is_valid else None,
            notify=notify,
            first_out=self.is_first and kind is EventKind.RAISED,
            by=by,
        )
        self.events += (event,)
        return event

    def _report_chattering(self) -> None:
        if self.record.is_chattering:
            most = self.rule.raises_per_min_max
            reason = f"raised {most} times within a minute, the limit; it stays active until it has calmed down"
            self.add_event(EventKind.CHATTERING, reason, notify=not self.is_quiet)
        else:
            self.add_event(EventKind.CALMED, "it no longer comes too often", notify=False)


def _begin(evaluation: Evaluation, reason: str) -> None:
    now_s, record = evaluation.inputs.now_s, evaluation.record
    may_notify = not evaluation.is_quiet and now_s >= _cooled_down_at_s(evaluation)
    reason = f"so from the start: {reason}" if record.held_from_start else reason
    event = evaluation.add_event(EventKind.RAISED, reason, notify=may_notify)
    record.raised_at_s = record.reported_at_s = now_s
    if may_notify:
        record.notified_at_s = now_s
    record.owes_notice = not may_notify
    record.acknowledgement = None
    record.leg = Leg(on="raised", began_s=now_s, event=event)


def _end(evaluation: Evaluation, reason: str, by: str) -> None:
    record = evaluation.record
    event = evaluation.add_event(
        EventKind.CLEARED, reason, notify=not evaluation.is_quiet and not record.owes_notice, by=by
    )
    record.raised_at_s = record.reported_at_s = None
    record.owes_notice = record.is_announced_only = False
    record.leg = Leg(on="cleared", began_s=evaluation.inputs.now_s, event=event)


def stand(evaluation: Evaluation) -> None:
    """Let time pass for an alarm: inhibits may end, a re-alarm or a step may be due."""
    if evaluation.rule.suppress_when is not None:
        _suppress(evaluation, evaluation.rule.suppress_when)
    until_s = evaluation.record.inhibits.shelved_until_s
    if until_s is not None and evaluation.inputs.now_s >= until_s:
        unshelve(evaluation, "the time is over")
    if evaluation.record.is_active:
        _report_again(evaluation)
    if evaluation.rule.escalation and evaluation.record.leg is not None:
        _send(evaluation, evaluation.record.leg)


def requests_of(evaluation: Evaluation, before: tuple[Request, ...], bases: Container[str]) -> tuple[Request, ...]:
    """Return the requests of an alarm to outputs: at most one for each.

    Args:
        before: What it wanted in the cycle before; returned if that is the same.
        bases: The names of the outputs that are bases.
    """
    if evaluation.is_quiet or evaluation.record.has_let_go or evaluation.record.is_announced_only:
        return ()
    if not evaluation.rule.escalation and (
        not evaluation.record.is_active or (before and evaluation.rule.pattern is None)
    ):
        return before if evaluation.record.is_active else ()  # it asks for nothing, or always for the same
    wanted = {request.output: request for request in _requests(evaluation, bases)}
    requests = tuple(wanted.values())
    return before if requests == before else requests


def _cooled_down_at_s(evaluation: Evaluation) -> float:
    notified_at_s = evaluation.record.notified_at_s
    return -math.inf if notified_at_s is None else notified_at_s + evaluation.rule.cooldown_s


def _suppress(evaluation: Evaluation, condition: Condition) -> None:
    """Judge what suppresses the alarm. What cannot be known suppresses nothing: an alarm must not be quiet by guess."""
    inhibits = evaluation.record.inhibits
    verdict = evaluation.judge(condition, inhibits.leaves, is_active=inhibits.is_suppressed)
    is_suppressed = verdict.value is True
    if is_suppressed is not inhibits.is_suppressed or verdict.held != inhibits.leaves:
        evaluation.record.inhibits = replace(inhibits, is_suppressed=is_suppressed, leaves=verdict.held)
    if is_suppressed is not inhibits.is_suppressed:
        words = describe_verdict(condition, evaluation.inputs, inhibits.leaves, is_active=inhibits.is_suppressed)
        kind = EventKind.SUPPRESSED if is_suppressed else EventKind.UNSUPPRESSED
        evaluation.add_event(kind, words, notify=False)


def unshelve(evaluation: Evaluation, reason: str, by: str = "") -> None:
    """End the shelving of an alarm; `by` is empty if it ended by itself."""
    record = evaluation.record
    record.inhibits = replace(record.inhibits, shelved_until_s=None, is_one_shot=False, shelved_by="")
    evaluation.add_event(EventKind.UNSHELVED, reason, notify=False, by=by)


def _report_again(evaluation: Evaluation) -> None:
    """Report an alarm that stands: since people were not notified yet, or since it has stood for long."""
    record, now_s, realarm_s = evaluation.record, evaluation.inputs.now_s, evaluation.rule.realarm_s
    if record.raised_at_s is None or record.reported_at_s is None:
        return
    is_late = realarm_s is not None and now_s - record.reported_at_s >= realarm_s
    if not (record.owes_notice or is_late):
        return
    still = f"still active after {now_s - record.raised_at_s:.1f} s"
    may_notify = not evaluation.is_quiet and now_s >= _cooled_down_at_s(evaluation)
    if record.owes_notice and may_notify:
        _realarm(evaluation, f"{still}, and not notified before", may_notify=True)
    elif is_late:
        _realarm(evaluation, still, may_notify=may_notify)
        if evaluation.rule.ack == "required":
            machine.fire(record, Trigger.REALARM)
            evaluation.report()


def _realarm(evaluation: Evaluation, reason: str, *, may_notify: bool) -> None:
    """Report an alarm again. One that may not notify now does not begin its steps anew."""
    now_s, record = evaluation.inputs.now_s, evaluation.record
    event = evaluation.add_event(EventKind.REALARMED, reason, notify=may_notify)
    record.reported_at_s = now_s
    if may_notify:
        record.notified_at_s = now_s
        record.owes_notice = False
        record.leg = Leg(on="raised", began_s=now_s, event=event)


def _send(evaluation: Evaluation, leg: Leg) -> None:
    """Send what is due. What is due while the alarm is quiet is not sent later either: by then it is no news."""
    now_s = evaluation.inputs.now_s
    due = [position for position, step in _unsent(evaluation) if now_s + ROUNDING_S >= leg.began_s + step.after_s]
    if not due:
        return
    judged = [position for position in due if not is_to_be(evaluation.rule.escalation[position], evaluation.inputs)]
    evaluation.record.leg = replace(leg, sent=(*leg.sent, *due), left_out=(*leg.left_out, *judged))
    due = [position for position in due if position not in judged and evaluation.rule.escalation[position].send]
    if evaluation.is_quiet or not leg.event.notify:
        return
    count = evaluation.record.raises
    for position in due:
        step = evaluation.rule.escalation[position]
        if not (step.only_unacknowledged and evaluation.record.is_acknowledged):
            event = _as_of_now(leg.event, evaluation)
            evaluation.notices += (Notice(rule=evaluation.rule.name, step=position, event=event, count=count),)


def is_to_be(step: EscalationStep, inputs: RuleInputs) -> bool:
    """Check whether a step that is due is done. Where that is not known people are notified, and nothing moves."""
    if step.when is None:
        return True
    value = judge(step.when, inputs, (), is_active=False).value
    return step.send is not None if value is None else value


def _as_of_now(event: Event, evaluation: Evaluation) -> Event:
    """Return an event with the figures of this moment: a step that comes late tells what is, not what was."""
    track = evaluation.inputs.tracks.get(evaluation.rule.target)
    if track is None or not track.is_valid:
        return replace(event, distance_m=None, sigma_m=None)
    return replace(event, distance_m=track.distance_m, sigma_m=track.sigma_m)


def _unsent(evaluation: Evaluation) -> Iterator[tuple[int, EscalationStep]]:
    leg = evaluation.record.leg
    if leg is None:
        return
    for position, step in enumerate(evaluation.rule.escalation):
        has_moment = step.send is not None or step.when is not None
        if has_moment and step.on == leg.on and position not in leg.sent:
            yield position, step


def _requests(evaluation: Evaluation, bases: Container[str]) -> Iterator[Request]:
    """Yield what the alarm wants; of several for one output, the later counts."""
    rule, record, leg = evaluation.rule, evaluation.record, evaluation.record.leg
    if leg is None:
        return
    since_s = evaluation.inputs.now_s - (record.raised_at_s if record.raised_at_s is not None else leg.began_s)
    if rule.output is not None and record.is_active:
        yield _request(evaluation, rule.output, rule.level, rule.pattern, since_s, is_base=rule.output in bases)
    if record.is_active is not (leg.on == "raised"):
        return
    since_s = evaluation.inputs.now_s - leg.began_s + ROUNDING_S
    for position, step in enumerate(rule.escalation):
        if position in leg.left_out:
            continue
        lasts_s = step.for_s if leg.on == "raised" or math.isfinite(step.for_s) else 0.0
        if step.output is None or step.on != leg.on or not step.after_s <= since_s < step.after_s + lasts_s:
            continue
        if not (step.only_unacknowledged and record.is_acknowledged):
            is_base = step.output in bases
            yield _request(evaluation, step.output, step.level, step.pattern, since_s - step.after_s, is_base=is_base)


def _request(
    evaluation: Evaluation, output: str, level: float, pattern: Pattern | None, since_s: float, *, is_base: bool
) -> Request:
    rule = evaluation.rule
    if is_base:
        return TwistRequest(rule=rule.name, output=output, priority=rule.priority, linear_mps=0.0, angular_radps=0.0)
    level = level if pattern is None else pattern.level(since_s)
    return LevelRequest(rule=rule.name, output=output, priority=rule.priority, level=level)


def dismiss(rule: AlarmRule, record: AlarmRecord, inputs: RuleInputs, reason: str) -> tuple[Event, ...]:
    """Return the event of an alarm that ceases to be, with its rule: that it cleared, if it was active."""
    evaluation = Evaluation(rule, record, inputs)
    if record.is_active:
        may_notify = not evaluation.is_quiet and not record.owes_notice
        evaluation.add_event(EventKind.CLEARED, reason, notify=may_notify)
    return evaluation.events
