"""An alarm in one cycle: its condition is judged, timers run, and it goes from one phase to another.

Which phase follows which is in `alarm_table`; when people are told, and what else the alarm does, is in `standing`.

Timers run on the capture times of the frames that were judged, so a recording gives the same alarms. A frame to the
contrary sets a timer back by its own time instead of to zero: under noise a timer that restarts may never end. While
the target is out of sight nothing is judged: the alarm stays as it was and timers stand still, for the grace; then
the rule's policy says what happens. When the target comes back, it is compared with what the alarm was, so coming back
raises nothing by itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from stadimeter.core.decision import Event, EventKind, Notice, RuleStatus
from stadimeter.core.rule import AlarmRule, LostPolicy
from stadimeter.core.rules import conditions
from stadimeter.core.rules.alarm_state import NO_GATES, NO_TIMERS, AlarmState, Timers
from stadimeter.core.rules.alarm_table import LATCHED, Phase, Trigger
from stadimeter.core.rules.alarm_turn import AlarmTurn
from stadimeter.core.rules.known import Known
from stadimeter.core.rules.standing import begin, due_s, end, requests_of, stand
from stadimeter.core.rules.step import Step, trace_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """What is judged in a cycle.

    Attributes:
        at_s: The capture time of the frame that is new; for the presence of a target, the time of the cycle.
        since_s: How long after the frame before, or the cycle before, that is; 0 for the first.
    """

    at_s: float
    since_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmStep(Step):
    """What an alarm does in one cycle.

    Attributes:
        state: What it remembers.
    """

    state: AlarmState = field(default_factory=AlarmState)


class Stepped(NamedTuple):
    """An alarm after a cycle: what it does, what happened, and what is to be sent."""

    step: AlarmStep
    events: tuple[Event, ...] = ()
    notices: tuple[Notice, ...] = ()


RESUME_S = 10.0
"""A run that goes on from an earlier one takes this long at most to see its targets: until then they are not lost."""

_JUDGED_BY_ITS_END = frozenset({Phase.UNACKNOWLEDGED, Phase.ACTIVE, Phase.CLEARING_UNACKNOWLEDGED, Phase.CLEARING})
"""A condition that latched has ended. To hold again it must begin again."""

_HOLDING = frozenset({Phase.UNACKNOWLEDGED, Phase.ACTIVE})


def new_alarm(rule: AlarmRule) -> AlarmStep:
    """Return an alarm at the start of a run.

    Args:
        rule: The alarm.

    Returns:
        Its step before the first cycle.
    """
    return AlarmStep(trace=trace_of(rule, RuleStatus.UNKNOWN))


def step_alarm(
    rule: AlarmRule,
    before: AlarmStep,
    known: Known,
    sample: Sample | None,
    bases: frozenset[str],
    *,
    is_first: bool = False,
) -> Stepped:
    """Judge an alarm for one cycle.

    Args:
        rule: The alarm.
        before: Its step in the cycle before.
        known: All that it can be judged by.
        sample: The frame that is new in this cycle; None without one.
        bases: The names of the outputs that are bases. An alarm stops them.
        is_first: Whether no other alarm of its group has been raised.

    Returns:
        What it does, and what happened.
    """
    state = before.state
    verdict = conditions.judge(rule.condition, known, state.timers.leaves, is_active=state.phase in _JUDGED_BY_ITS_END)
    if _stays(rule, before, verdict, known, sample):
        return Stepped(before)
    turn = AlarmTurn(rule, state, known, is_first=is_first)
    if verdict.value is None:
        _without_target(turn)
    else:
        _back_in_sight(turn)
        if sample is not None and not _is_settled(turn.state, verdict.value, verdict.held):
            _judge(turn, sample, verdict.value, verdict.held)
    stand(turn)
    return _stepped(before, turn, bases, holds=verdict.value)


def why(rule: AlarmRule, state: AlarmState, known: Known) -> str:
    """Return why an alarm does what it does, in words with figures.

    Args:
        rule: The alarm.
        state: What it remembers after the cycle.
        known: All that it was judged by.

    Returns:
        The words.
    """
    words = in_words(rule, state, known)
    if state.unknown_since_s is None:
        return words
    held = "held: " if state.is_active and not state.is_given_up else ""
    return f"{held}{_missing(rule, known)} for {known.now_s - state.unknown_since_s:.1f} s: {words}"


def _missing(rule: AlarmRule, known: Known) -> str:
    """Return what the matter is while there is nothing to judge by: it need not be the rule's own target."""
    return "not known" if known.tracks[rule.target].is_valid else "not seen"


def in_words(rule: AlarmRule, state: AlarmState, known: Known) -> str:
    """Return the figures behind the condition of an alarm.

    Args:
        rule: The alarm.
        state: What it remembers.
        known: All that it is judged by.

    Returns:
        The words.
    """
    is_active = state.phase in _JUDGED_BY_ITS_END
    return conditions.in_words(rule.condition, known, state.timers.leaves, is_active=is_active)


def is_judged_by_its_end(state: AlarmState) -> bool:
    """Return whether the condition of an alarm is judged by what ends it, not by what begins it.

    Args:
        state: What the alarm remembers.

    Returns:
        Whether it is.
    """
    return state.phase in _JUDGED_BY_ITS_END


def dismissed(rule: AlarmRule, state: AlarmState, known: Known, reason: str) -> tuple[Event, ...]:
    """Return what is to be told of an alarm that ceases to be, with its rule.

    Args:
        rule: The alarm.
        state: What it remembers.
        known: All that it was judged by.
        reason: Why it ceases to be.

    Returns:
        That it cleared, if it was active; else nothing.
    """
    turn = AlarmTurn(rule, state, known)
    if state.is_active:
        turn.tell(EventKind.CLEARED, known.now_s, reason, notify=not turn.is_quiet and not state.owes_notice)
    return turn.events


def _stepped(before: AlarmStep, turn: AlarmTurn, bases: frozenset[str], *, holds: bool | None) -> Stepped:
    rule, state = turn.rule, turn.state
    status = _status(state, holds=holds)
    rests = _rests(turn, holds=holds)
    requests = requests_of(turn, before.requests, bases)
    due = due_s(turn) if rests else math.inf
    is_same = state is before.state and status is before.trace.status and requests is before.requests
    if is_same and rests is before.rests and due == before.due_s:
        return Stepped(before, turn.events, turn.notices)
    gates = state.gates.words()
    trace = trace_of(rule, status, before.trace, acknowledged=state.is_acknowledged, gates=gates)
    step = AlarmStep(trace=trace, requests=requests, state=state, rests=rests, due_s=due)
    return Stepped(step, turn.events, turn.notices)


def _stays(
    rule: AlarmRule, before: AlarmStep, verdict: conditions.Verdict, known: Known, sample: Sample | None
) -> bool:
    """Return whether an alarm surely goes on as it is. Nearly all do in nearly every cycle, so this is worth a look."""
    state = before.state
    if verdict.value is None or state.is_active or state.leg is not None or rule.suppress_when is not None:
        return False
    if state.unknown_since_s is not None or state.gates is not NO_GATES or before.rests:
        return False
    if before.trace.status is not RuleStatus.IDLE or known.now_s >= before.due_s:
        return False
    if sample is not None and not _is_settled(state, verdict.value, verdict.held):
        return False
    return not conditions.rests(rule.condition, known, state.timers.leaves, is_active=False)


def _is_settled(state: AlarmState, holds: bool, leaves: tuple[bool, ...]) -> bool:
    """Return whether a sample changes nothing: it is like the one before, and no timer runs."""
    timers = state.timers
    if state.resumed is not None or not timers.was_judged or holds is not timers.held_last or leaves != timers.leaves:
        return False
    if holds:
        return state.phase in _HOLDING and timers.ended_s == 0.0
    if state.phase in LATCHED:
        return True
    return not state.is_active and timers.held_s == 0.0 and True not in timers.recent


def _rests(turn: AlarmTurn, *, holds: bool | None) -> bool:
    """Return whether nothing changes until a figure crosses a limit, a target comes or goes, or it is due."""
    rule, state = turn.rule, turn.state
    if state.resumed is not None:
        return False
    if rule.suppress_when is not None and not conditions.rests(
        rule.suppress_when, turn.known, state.gates.leaves, is_active=state.gates.is_suppressed
    ):
        return False
    if state.leg is not None and state.is_active and turn.has_patterns:
        return False
    if holds is None:
        policy = rule.lost.policy
        is_silent = not state.is_active and policy is not LostPolicy.ASSERT
        is_held = state.is_given_up and policy is LostPolicy.HOLD
        is_active = state.phase in _JUDGED_BY_ITS_END
        is_still = conditions.rests(rule.condition, turn.known, state.timers.leaves, is_active=is_active)
        return is_still and ((is_silent and not _has_timers(state.timers)) or is_held)
    is_active = state.phase in _JUDGED_BY_ITS_END
    return _is_settled(state, holds, state.timers.leaves) and conditions.rests(
        rule.condition, turn.known, state.timers.leaves, is_active=is_active
    )


def _judge(turn: AlarmTurn, sample: Sample, holds: bool, leaves: tuple[bool, ...]) -> None:
    """Take in one sample for which the condition is known."""
    state, timers = turn.state, turn.state.timers
    since_s = _since_s(turn, sample, holds)
    if state.held_from_start and not holds:
        turn.change(held_from_start=False)
    if state.phase in LATCHED:
        turn.change(timers=Timers(held_last=holds, was_judged=True, leaves=leaves))
        if holds:
            turn.trigger(Trigger.HOLDS)
    elif state.is_active:
        ended_s = max(0.0, timers.ended_s - since_s) if holds else timers.ended_s + since_s
        turn.change(timers=Timers(ended_s=ended_s, held_last=holds, was_judged=True, leaves=leaves))
        turn.trigger(Trigger.HOLDS if holds else Trigger.ENDED)
        if not holds and ended_s >= turn.rule.off_delay_s:
            _clear(turn, sample.at_s)
    else:
        _wait(turn, sample.at_s, since_s, holds, leaves)


def _since_s(turn: AlarmTurn, sample: Sample, holds: bool) -> float:
    """Return for how long the condition has been as it is: since the sample before, or since an earlier run."""
    timers, resumed = turn.state.timers, turn.state.resumed
    if resumed is None:
        return sample.since_s if timers.was_judged else 0.0
    turn.change(resumed=None)
    # What held before and holds now is taken to have held in between.
    return max(0.0, sample.at_s - resumed.from_s) if holds is timers.held_last else 0.0


def _wait(turn: AlarmTurn, at_s: float, since_s: float, holds: bool, leaves: tuple[bool, ...]) -> None:
    """Count towards being raised.

    A frame whose measurement was refused as an outlier contradicts the track that the condition is judged by. It counts
    neither for the condition nor against it.
    """
    if turn.known.tracks[turn.rule.target].rejected:
        return
    timers, delay = turn.state.timers, turn.rule.on_delay
    held_s = timers.held_s + since_s * timers.held_last if holds else max(0.0, timers.held_s - since_s)
    recent = (*timers.recent, holds)[-delay.of_frames :] if delay.of_frames else ()
    turn.change(timers=Timers(held_s=held_s, recent=recent, held_last=holds, was_judged=True, leaves=leaves))
    turn.trigger(Trigger.HOLDS if holds else Trigger.ENDED)
    if holds and held_s >= delay.hold_s and sum(recent) >= delay.frames:
        _raise(turn, at_s)


def _raise(turn: AlarmTurn, at_s: float, reason: str = "") -> None:
    state = turn.state
    reason = reason or in_words(turn.rule, replace(state, phase=Phase.INACTIVE), turn.known)
    if state.held_from_start:
        reason = f"so from the start: {reason}"
    turn.trigger(Trigger.RAISE if turn.rule.needs_ack else Trigger.RAISE_ACKNOWLEDGED)
    timers = replace(NO_TIMERS, held_last=state.timers.held_last, was_judged=state.timers.was_judged)
    turn.change(
        timers=replace(timers, leaves=state.timers.leaves),
        is_announced_only=state.held_from_start and not turn.rule.act_at_start,
    )
    begin(turn, at_s, reason)


def _clear(turn: AlarmTurn, at_s: float, reason: str = "") -> None:
    """The condition has ended for good: the alarm clears, or latches."""
    reason = reason or in_words(turn.rule, turn.state, turn.known)
    timers = turn.state.timers
    turn.change(timers=Timers(held_last=False, was_judged=timers.was_judged, leaves=timers.leaves))
    if turn.rule.latch:
        turn.trigger(Trigger.LATCH)
        return
    turn.trigger(Trigger.CLEAR)
    end(turn, at_s, reason)


def _without_target(turn: AlarmTurn) -> None:
    """There is nothing to judge by: hold for the grace, then do as the policy says."""
    now_s, lost, resumed = turn.known.now_s, turn.rule.lost, turn.state.resumed
    if resumed is not None:
        if now_s - resumed.at_s < RESUME_S:
            return
        turn.change(resumed=None)
    if turn.state.unknown_since_s is None:
        turn.change(unknown_since_s=now_s)
    away_s = now_s - (turn.state.unknown_since_s or 0.0)
    if away_s >= lost.grace_s:
        _forget_timers(turn)
        if lost.policy is not LostPolicy.HOLD:
            _follow_policy(turn, away_s)
            return
    remind_of_loss = turn.state.is_active and not turn.state.is_given_up and away_s >= lost.fault_after_s
    if remind_of_loss:
        missing = _missing(turn.rule, turn.known)
        reason = f"active, but {missing} for {away_s:.1f} s; the output goes to its safe value"
        turn.change(is_given_up=True)
        turn.tell(EventKind.MEASUREMENT_LOST, now_s, reason, notify=not turn.is_quiet)


def _follow_policy(turn: AlarmTurn, away_s: float) -> None:
    """After the grace: not seeing counts as not holding, or as holding."""
    state, policy, now_s = turn.state, turn.rule.lost.policy, turn.known.now_s
    reason = f"{_missing(turn.rule, turn.known)} for {away_s:.1f} s: {in_words(turn.rule, state, turn.known)}"
    is_holding = state.phase in _JUDGED_BY_ITS_END
    if policy is LostPolicy.CLEAR and is_holding:
        _clear(turn, now_s, reason)
    elif policy is LostPolicy.ASSERT and not is_holding:
        turn.change(held_from_start=False)
        if state.phase in LATCHED:
            turn.trigger(Trigger.HOLDS)
        else:
            turn.change(timers=replace(turn.state.timers, leaves=()))  # every part counts as holding
            _raise(turn, now_s, reason)
    elif policy is LostPolicy.ASSERT and state.is_announced_only:  # not seeing is a danger of its own: it acts
        turn.change(is_announced_only=False)


def _has_timers(timers: Timers) -> bool:
    return bool(timers.held_s or timers.ended_s or timers.recent or timers.held_last)


def _forget_timers(turn: AlarmTurn) -> None:
    """After the grace, what was counted before is too old to count on."""
    timers = turn.state.timers
    if _has_timers(timers):
        turn.change(timers=Timers(was_judged=timers.was_judged, leaves=timers.leaves))


def _back_in_sight(turn: AlarmTurn) -> None:
    state = turn.state
    if state.unknown_since_s is None:
        return
    # The time out of sight counts for no timer, so the next sample starts counting anew.
    timers = replace(state.timers, was_judged=False)
    turn.change(unknown_since_s=None, is_given_up=False, timers=timers)
    if state.is_given_up:
        now_s = turn.known.now_s
        reason = f"there is something to judge by again, after {now_s - state.unknown_since_s:.1f} s"
        turn.tell(EventKind.MEASUREMENT_BACK, now_s, reason, notify=not turn.is_quiet)


_STATUS = {
    Phase.UNACKNOWLEDGED: RuleStatus.ACTIVE,
    Phase.ACTIVE: RuleStatus.ACTIVE,
    Phase.CLEARING_UNACKNOWLEDGED: RuleStatus.CLEARING,
    Phase.CLEARING: RuleStatus.CLEARING,
    Phase.LATCHED_UNACKNOWLEDGED: RuleStatus.LATCHED,
    Phase.LATCHED: RuleStatus.LATCHED,
    Phase.RETURNED: RuleStatus.RETURNED,
    Phase.PENDING: RuleStatus.PENDING,
    Phase.INACTIVE: RuleStatus.IDLE,
}


def _status(state: AlarmState, *, holds: bool | None) -> RuleStatus:
    if holds is not None or state.phase in LATCHED or state.phase is Phase.RETURNED:
        return RuleStatus.UNKNOWN if state.is_given_up else _STATUS[state.phase]
    return RuleStatus.ACTIVE if state.is_active and not state.is_given_up else RuleStatus.UNKNOWN
