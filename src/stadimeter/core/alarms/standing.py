"""What an alarm does beside being judged: it tells people, at most so often; acts step after step; and may be quiet."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from stadimeter.core.alarms.state import Leg
from stadimeter.core.alarms.table import Phase, Trigger
from stadimeter.core.alarms.turn import AlarmTurn
from stadimeter.core.conditions import verdict as conditions
from stadimeter.core.decision import Event, EventKind, Notice
from stadimeter.core.rule import ROUNDING_S, Pattern, SequenceStep
from stadimeter.core.rule_step import LevelRequest, Request, TwistRequest


def begin(turn: AlarmTurn, at_s: float, reason: str) -> None:
    """Report that an alarm was raised, and begin what it does.

    Args:
        turn: The alarm.
        at_s: When the frame was taken that raised it.
        reason: Why.
    """
    now_s = turn.known.now_s
    may_notify = not turn.is_quiet and now_s >= _cooled_down_at_s(turn)
    event = turn.tell(EventKind.RAISED, at_s, reason, notify=may_notify)
    turn.change(
        raised_at_s=now_s,
        reported_at_s=now_s,
        notified_at_s=now_s if may_notify else turn.state.notified_at_s,
        owes_notice=not may_notify,
        leg=Leg(on="raised", began_s=now_s, event=event),
    )


def end(turn: AlarmTurn, at_s: float, reason: str, by: str = "") -> None:
    """Report that an alarm is over, and begin what it does then.

    Args:
        turn: The alarm, no longer active.
        at_s: When that is.
        reason: Why.
        by: Who ended it; empty if its condition did.
    """
    state = turn.state
    event = turn.tell(EventKind.CLEARED, at_s, reason, notify=not turn.is_quiet and not state.owes_notice, by=by)
    turn.change(
        raised_at_s=None,
        reported_at_s=None,
        owes_notice=False,
        is_announced_only=False,
        leg=Leg(on="cleared", began_s=turn.known.now_s, event=event),
    )


def stand(turn: AlarmTurn) -> None:
    """Let time pass for an alarm: what keeps it quiet may end, and what it does step after step may be due.

    Args:
        turn: The alarm.
    """
    _suppress(turn)
    _end_shelving(turn)
    if turn.state.is_active:
        _report_again(turn)
    _send(turn)


def requests_of(turn: AlarmTurn, before: tuple[Request, ...], bases: frozenset[str]) -> tuple[Request, ...]:
    """Return what an alarm wants of outputs.

    Args:
        turn: The alarm.
        before: What it wanted in the cycle before; returned if that is the same.
        bases: The names of the outputs that are bases.

    Returns:
        At most one request for each output.
    """
    if turn.is_quiet or turn.state.is_given_up or turn.state.is_announced_only:
        return ()
    if not turn.rule.sequence and (not turn.state.is_active or (before and turn.rule.pattern is None)):
        return before if turn.state.is_active else ()  # it asks for nothing, or always for the same
    wanted = {request.output: request for request in _requests(turn, bases)}
    requests = tuple(wanted.values())
    return before if requests == before else requests


def due_s(turn: AlarmTurn) -> float:
    """Return when a timer of an alarm fires; those of its conditions are theirs.

    Args:
        turn: The alarm.

    Returns:
        On the run's clock; infinite for never.
    """
    state, rule = turn.state, turn.rule
    due = math.inf
    if state.gates.shelved_until_s is not None:
        due = min(due, state.gates.shelved_until_s)
    if state.is_active:
        if rule.realarm_s is not None and state.reported_at_s is not None:
            due = min(due, state.reported_at_s + rule.realarm_s)
        if state.owes_notice and not turn.is_quiet:
            due = min(due, _cooled_down_at_s(turn))
    return min(due, _sequence_due_s(turn))


def _cooled_down_at_s(turn: AlarmTurn) -> float:
    notified_at_s = turn.state.notified_at_s
    return -math.inf if notified_at_s is None else notified_at_s + turn.rule.cooldown_s


def _suppress(turn: AlarmTurn) -> None:
    """Judge what suppresses the alarm. What cannot be known suppresses nothing: an alarm must not be quiet by guess."""
    condition, gates = turn.rule.suppress_when, turn.state.gates
    if condition is None:
        return
    verdict = conditions.judge(condition, turn.known, gates.leaves, is_active=gates.is_suppressed)
    is_suppressed = verdict.value is True
    if is_suppressed is not gates.is_suppressed or verdict.held != gates.leaves:
        turn.change(gates=replace(gates, is_suppressed=is_suppressed, leaves=verdict.held))
    if is_suppressed is not gates.is_suppressed:
        words = conditions.in_words(condition, turn.known, gates.leaves, is_active=gates.is_suppressed)
        kind = EventKind.SUPPRESSED if is_suppressed else EventKind.UNSUPPRESSED
        turn.tell(kind, turn.known.now_s, words, notify=False)


def _end_shelving(turn: AlarmTurn) -> None:
    gates = turn.state.gates
    if gates.shelved_until_s is None:
        return
    is_over = turn.known.now_s >= gates.shelved_until_s
    cleared_in_it = gates.is_one_shot and any(event.kind is EventKind.CLEARED for event in turn.events)
    if is_over or (cleared_in_it and turn.state.phase is Phase.INACTIVE):
        unshelve(turn, "the time is over" if is_over else "the alarm has returned to normal")


def unshelve(turn: AlarmTurn, reason: str, by: str = "") -> None:
    """End the shelving of an alarm.

    Args:
        turn: The alarm.
        reason: Why.
        by: Who ended it; empty if it ended by itself.
    """
    gates = replace(turn.state.gates, shelved_until_s=None, is_one_shot=False, shelved_by="")
    turn.change(gates=gates)
    turn.tell(EventKind.UNSHELVED, turn.known.now_s, reason, notify=False, by=by)


def _report_again(turn: AlarmTurn) -> None:
    """Report an alarm that stands: since it was not told yet, or has stood for long."""
    state, now_s = turn.state, turn.known.now_s
    if state.owes_notice and not turn.is_quiet and now_s >= _cooled_down_at_s(turn):
        _realarm(turn, f"still active after {now_s - (state.raised_at_s or now_s):.1f} s, and not told before")
    elif turn.rule.realarm_s is not None and now_s - (state.reported_at_s or now_s) >= turn.rule.realarm_s:
        _realarm(turn, f"still active after {now_s - (state.raised_at_s or now_s):.1f} s")
        if turn.rule.needs_ack:
            turn.trigger(Trigger.REALARM)


def _realarm(turn: AlarmTurn, reason: str) -> None:
    now_s, may_notify = turn.known.now_s, not turn.is_quiet
    event = turn.tell(EventKind.REALARMED, now_s, reason, notify=may_notify)
    turn.change(
        reported_at_s=now_s,
        notified_at_s=now_s if may_notify else turn.state.notified_at_s,
        owes_notice=turn.state.owes_notice and not may_notify,
        leg=Leg(on="raised", began_s=now_s, event=event),
    )


def _send(turn: AlarmTurn) -> None:
    """Send what is due. What an alarm may not tell is not sent later either: by then it is no news."""
    leg, now_s = turn.state.leg, turn.known.now_s
    if leg is None or not turn.rule.sequence:
        return
    due = [position for position, step in _unsent(turn) if now_s + ROUNDING_S >= leg.began_s + step.after_s]
    if not due:
        return
    turn.change(leg=replace(leg, sent=(*leg.sent, *due)))
    if turn.is_quiet or not leg.event.notify:
        return
    for position in due:
        step = turn.rule.sequence[position]
        if not (step.only_unacknowledged and turn.state.is_acknowledged):
            turn.notices += (Notice(rule=turn.rule.name, step=position, event=_as_of_now(leg.event, turn)),)


def _as_of_now(event: Event, turn: AlarmTurn) -> Event:
    """Return an event with the figures of this moment: a step that comes late tells what is, not what was."""
    track = turn.known.tracks.get(turn.rule.target)
    if track is None or not track.is_valid:
        return replace(event, distance_m=None, sigma_m=None)
    return replace(event, distance_m=track.distance_m, sigma_m=track.sigma_m)


def _unsent(turn: AlarmTurn) -> Iterator[tuple[int, SequenceStep]]:
    leg = turn.state.leg
    if leg is None:
        return
    for position, step in enumerate(turn.rule.sequence):
        if step.send is not None and step.on == leg.on and position not in leg.sent:
            yield position, step


def _sequence_due_s(turn: AlarmTurn) -> float:
    """Return when the next step of the sequence begins or ends."""
    leg, now_s = turn.state.leg, turn.known.now_s
    if leg is None or not turn.rule.sequence:
        return math.inf
    due = [leg.began_s + step.after_s for _, step in _unsent(turn)]
    for step in turn.rule.sequence:
        if step.output is not None and step.on == leg.on:
            due += [leg.began_s + step.after_s, leg.began_s + step.after_s + step.for_s]
    return min((at_s for at_s in due if at_s > now_s + ROUNDING_S), default=math.inf)


def _requests(turn: AlarmTurn, bases: frozenset[str]) -> Iterator[Request]:
    """Yield what the alarm wants; of several for one output, the later counts."""
    rule, state, leg = turn.rule, turn.state, turn.state.leg
    if leg is None:
        return
    since_s = turn.known.now_s - (state.raised_at_s if state.raised_at_s is not None else leg.began_s)
    if rule.output is not None and state.is_active:
        yield _request(turn, rule.output, rule.level, rule.pattern, since_s, is_base=rule.output in bases)
    if state.is_active is not (leg.on == "raised"):
        return
    since_s = turn.known.now_s - leg.began_s + ROUNDING_S
    for step in rule.sequence:
        lasts_s = step.for_s if leg.on == "raised" or math.isfinite(step.for_s) else 0.0
        if step.output is None or step.on != leg.on or not step.after_s <= since_s < step.after_s + lasts_s:
            continue
        if not (step.only_unacknowledged and state.is_acknowledged):
            is_base = step.output in bases
            yield _request(turn, step.output, step.level, step.pattern, since_s - step.after_s, is_base=is_base)


def _request(
    turn: AlarmTurn, output: str, level: float, pattern: Pattern | None, since_s: float, *, is_base: bool
) -> Request:
    rule = turn.rule
    if is_base:
        return TwistRequest(rule=rule.name, output=output, priority=rule.priority, linear_mps=0.0, angular_radps=0.0)
    level = level if pattern is None else pattern.level(since_s)
    return LevelRequest(rule=rule.name, output=output, priority=rule.priority, level=level)
