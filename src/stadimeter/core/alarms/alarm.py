"""An alarm in one cycle: its condition is judged, timers run, and it goes from one phase to another.

Which phase follows which is in `table`; timers are in `timing`, what happens without a target in
`absence`; when people are told, and what else the alarm does, is in `standing`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from stadimeter.core.alarms.absence import back_in_sight, is_awaited, without_target
from stadimeter.core.alarms.standing import due_s, requests_of, stand
from stadimeter.core.alarms.state import NO_GATES, AlarmState
from stadimeter.core.alarms.table import LATCHED, Phase
from stadimeter.core.alarms.timing import Sample, begun_anew, has_timers, is_settled, judge_sample
from stadimeter.core.alarms.turn import AlarmTurn
from stadimeter.core.alarms.words import JUDGED_BY_ITS_END
from stadimeter.core.condition import Condition
from stadimeter.core.conditions import verdict as conditions
from stadimeter.core.conditions.known import Known
from stadimeter.core.decision import Event, Notice, RuleStatus
from stadimeter.core.rule import AlarmRule, LostPolicy
from stadimeter.core.rule_step import Step, trace_of


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
    if known.is_after_gap:
        before = replace(before, state=begun_anew(before.state))
    state = before.state
    verdict = conditions.judge(rule.condition, known, state.timers.leaves, is_active=state.phase in JUDGED_BY_ITS_END)
    if state.resumed is not None and is_awaited(rule, known, state.resumed.at_s):
        verdict = conditions.Verdict(None, state.timers.leaves)
    if _stays(rule, before, verdict, known, sample):
        return Stepped(before)
    turn = AlarmTurn(rule, state, known, is_first=is_first)
    if verdict.value is None:
        without_target(turn)
    else:
        back_in_sight(turn)
        if sample is not None and not is_settled(turn.state, verdict.value, verdict.held):
            judge_sample(turn, sample, verdict.value, verdict.held)
    stand(turn)
    return _stepped(before, turn, bases, holds=verdict.value)


def judged_by(rule: AlarmRule, state: AlarmState) -> tuple[tuple[Condition, tuple[bool, ...], bool], ...]:
    """Return the conditions that an alarm is judged by, what it remembers of their parts, and whether they are on."""
    own = rule.condition, state.timers.leaves, state.phase in JUDGED_BY_ITS_END
    if rule.suppress_when is None:
        return (own,)
    return own, (rule.suppress_when, state.gates.leaves, state.gates.is_suppressed)


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
    if state.unknown_since_s is not None or state.gates is not NO_GATES or not before.rests:
        return False
    if before.trace.status is not RuleStatus.IDLE or known.now_s >= before.due_s:
        return False
    return sample is None or is_settled(state, verdict.value, verdict.held)


def _rests(turn: AlarmTurn, *, holds: bool | None) -> bool:
    """Return whether nothing changes while the verdicts of its conditions stay as they are, and until it is due."""
    rule, state = turn.rule, turn.state
    if state.resumed is not None:
        return False
    if state.leg is not None and state.is_active and turn.has_patterns:
        return False
    if holds is None:
        policy = rule.lost.policy
        is_silent = not state.is_active and policy is not LostPolicy.ASSERT
        is_held = state.is_given_up and policy is LostPolicy.HOLD
        return (is_silent and not has_timers(state.timers)) or is_held
    return is_settled(state, holds, state.timers.leaves)


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
