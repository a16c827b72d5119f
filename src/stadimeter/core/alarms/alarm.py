"""What a cycle, or an operator command, makes of an alarm.

A cycle judges the condition, hands the verdict to the machine (`machine`), and lets the actions follow (`actions`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from stadimeter.core.alarms import machine
from stadimeter.core.alarms.actions import (
    Evaluation,
    due_s,
    given_up_in_words,
    in_words,
    missing_in_words,
    requests_of,
    stand,
    unshelve,
    why_not_latched,
)
from stadimeter.core.alarms.machine import LATCHED, TRANSITIONS, AlarmState, Phase, Trigger
from stadimeter.core.alarms.state import NO_INHIBITS, Acknowledgement, Sample
from stadimeter.core.condition import Condition, CountCondition, PresenceCondition, leaves
from stadimeter.core.conditions import verdict as conditions
from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.decision import Event, EventKind, Notice, RuleStatus, RuleTrace, Severity
from stadimeter.core.operator import Answer, OperatorCommand
from stadimeter.core.rule import ROUNDING_S, AlarmRule
from stadimeter.core.rule_step import Step, renewed, trace_of
from stadimeter.core.track import TrackStatus
from stadimeter.core.words import duration
from stadimeter.operator_actions import OperatorAction

AWAITED_S = 10.0
"""At the start of a run, and after a restart, a target may take this long to be seen: until then it is not lost."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmStep(Step):
    """What an alarm does in one cycle, and remembers."""

    state: AlarmState = field(default_factory=AlarmState)


class Stepped(NamedTuple):
    """An alarm after a cycle: what it does, what happened, and what is to be sent."""

    step: AlarmStep
    events: tuple[Event, ...] = ()
    notices: tuple[Notice, ...] = ()


def new_alarm(rule: AlarmRule) -> AlarmStep:
    """Return an alarm before the first cycle of a run."""
    return AlarmStep(trace=trace_of(rule, RuleStatus.UNKNOWN))


def with_state(rule: AlarmRule, step: AlarmStep, state: AlarmState) -> AlarmStep:
    """Return an alarm that has another state since its step, by a command or by a restart. It must be evaluated."""
    active = state.is_active or None
    return replace(step, trace=_trace(rule, state, step.trace.status, active, step.trace), state=state, rests=False)


# ---- One cycle ----


def step_alarm(
    rule: AlarmRule,
    before: AlarmStep,
    inputs: RuleInputs,
    sample: Sample | None,
    bases: frozenset[str],
    *,
    is_first: bool = False,
) -> Stepped:
    """Evaluate an alarm in one cycle.

    Args:
        before: Its step in the cycle before.
        sample: The frame that is new in this cycle; None without one.
        bases: The names of the outputs that are bases. An alarm stops them.
        is_first: Whether no other alarm of its group has been raised.
    """
    state, now_s = before.state, inputs.now_s
    if inputs.is_after_gap:
        state = machine.anew(state, now_s)
    verdict = conditions.judge(rule.condition, inputs, state.timers.leaves, is_active=state.is_judged_by_its_end)
    is_awaited = _is_awaited(rule, state, inputs)
    if is_awaited:
        verdict = conditions.Verdict(None, state.timers.leaves)
    if state is before.state and _stays(rule, before, verdict, inputs, sample):
        return Stepped(before)
    evaluation = Evaluation(rule, state, inputs, is_first=is_first)
    evaluation.go(machine.calmed(rule, state, now_s))
    if verdict.value is None:
        _without_verdict(evaluation, is_awaited=is_awaited)
    else:
        _with_verdict(evaluation, verdict.value, verdict.held, sample)
    stand(evaluation)
    return _stepped(before, evaluation, bases, verdict.value, is_awaited=is_awaited)


def judged_by(rule: AlarmRule, state: AlarmState) -> tuple[tuple[Condition, tuple[bool, ...], bool], ...]:
    """Return the conditions that an alarm is judged by, the memory of their parts, and whether they are on."""
    own = rule.condition, state.timers.leaves, state.is_judged_by_its_end
    if rule.suppress_when is None:
        return (own,)
    return own, (rule.suppress_when, state.inhibits.leaves, state.inhibits.is_suppressed)


def _with_verdict(evaluation: Evaluation, holds: bool, held: tuple[bool, ...], sample: Sample | None) -> None:
    rule, inputs, before = evaluation.rule, evaluation.inputs, evaluation.state
    state = machine.back_in_sight(rule, before, inputs.now_s)
    if before.is_given_up and not state.is_given_up and before.unknown_since_s is not None:
        reason = f"there is something to judge by again, after {inputs.now_s - before.unknown_since_s:.1f} s"
        evaluation.add_event(EventKind.MEASUREMENT_BACK, reason, notify=not evaluation.is_quiet)
    evaluation.go(state)
    if sample is None or machine.is_settled(state, holds, held):
        return
    # A frame whose measurement was refused as an outlier contradicts the track that the condition is judged by: it
    # counts neither for an alarm that is not raised nor against it.
    if not state.is_active and inputs.tracks[rule.target].rejected > 0:
        evaluation.go(machine.pass_over(state, sample.since_s))
    else:
        evaluation.go(machine.take_sample(rule, state, sample, holds, held, now_s=inputs.now_s))


def _without_verdict(evaluation: Evaluation, *, is_awaited: bool) -> None:
    rule, inputs, before = evaluation.rule, evaluation.inputs, evaluation.state
    if before.resumed is not None:
        if inputs.now_s - before.resumed.at_s < AWAITED_S:
            return
        evaluation.change(resumed=None)
    if is_awaited:
        return
    state = machine.take_nothing(rule, evaluation.state, inputs.now_s)
    if state.is_active is not evaluation.state.is_active:
        evaluation.go(state, f"{missing_in_words(rule, state, inputs)}: {in_words(rule, state, inputs)}")
    else:
        evaluation.go(state)
    if state.is_given_up and not before.is_given_up:
        reason = given_up_in_words(rule, state, inputs)
        evaluation.add_event(EventKind.MEASUREMENT_LOST, reason, notify=not evaluation.is_quiet)


def _is_awaited(rule: AlarmRule, state: AlarmState, inputs: RuleInputs) -> bool:
    """Return whether it would be a guess that a target is lost: at the start none has been seen yet.

    A rule for safety does not wait: to it, not seeing counts at once.
    """
    if rule.severity is Severity.SAFETY or not inputs.tracks:
        return False
    if any(track.status is not TrackStatus.SEARCHING for track in inputs.tracks.values()):
        return False
    if state.resumed is not None:
        began_s = state.resumed.at_s
    elif state.is_active or state.unknown_since_s is not None:
        return False  # it has gone on from an earlier run, and has waited already
    else:
        began_s = max(inputs.now_s if track.since_s is None else track.since_s for track in inputs.tracks.values())
    if inputs.now_s - began_s + ROUNDING_S >= AWAITED_S:
        return False
    return any(isinstance(leaf, PresenceCondition | CountCondition) for leaf in leaves(rule.condition))


def _stays(
    rule: AlarmRule, before: AlarmStep, verdict: conditions.Verdict, inputs: RuleInputs, sample: Sample | None
) -> bool:
    """Return whether an alarm surely goes on as it is. Nearly all do in nearly every cycle, so this is worth a look."""
    state = before.state
    if verdict.value is None or state.is_active or state.leg is not None or rule.suppress_when is not None:
        return False
    if state.unknown_since_s is not None or state.inhibits is not NO_INHIBITS or not before.rests:
        return False
    if before.trace.status is not RuleStatus.IDLE or inputs.now_s >= before.due_s:
        return False
    return sample is None or machine.is_settled(state, verdict.value, verdict.held)


def _stepped(
    before: AlarmStep, evaluation: Evaluation, bases: frozenset[str], holds: bool | None, *, is_awaited: bool
) -> Stepped:
    rule, state, was = evaluation.rule, evaluation.state, before.trace
    rests = not is_awaited and _rests(evaluation, holds)
    if holds is None:
        holds = machine.decided_by_policy(rule, state, evaluation.inputs.now_s)
    status, active = _status(state, holds), state.is_active or (None if holds is None else False)
    requests = requests_of(evaluation, before.requests, bases)
    due = due_s(evaluation) if rests else math.inf
    is_same = status is was.status and active is was.active
    goes_on = rests is before.rests and due == before.due_s
    if is_same and goes_on and state is before.state and requests is before.requests:
        return Stepped(before, evaluation.events, evaluation.notices)
    is_same = is_same and state.is_acknowledged is was.acknowledged and state.is_chattering is was.chattering
    is_same = is_same and state.inhibits is before.state.inhibits
    trace = was if is_same else _trace(rule, state, status, active, was)
    step = AlarmStep(trace=trace, requests=requests, state=state, rests=rests, due_s=due)
    return Stepped(step, evaluation.events, evaluation.notices)


def _rests(evaluation: Evaluation, holds: bool | None) -> bool:
    """Return whether nothing changes while the verdicts of its conditions stay as they are, and until it is due."""
    state = evaluation.state
    if state.resumed is not None:
        return False
    if state.leg is not None and evaluation.has_patterns and (state.is_active or math.isfinite(due_s(evaluation))):
        return False  # a level changes by itself: of the alarm, or of a step that goes on after it has cleared
    return holds is None or machine.is_settled(state, holds, state.timers.leaves)


_STATUS = {
    Phase.UNACKNOWLEDGED: RuleStatus.ACTIVE,
    Phase.ACKNOWLEDGED: RuleStatus.ACTIVE,
    Phase.CLEARING_UNACKNOWLEDGED: RuleStatus.CLEARING,
    Phase.CLEARING: RuleStatus.CLEARING,
    Phase.LATCHED_UNACKNOWLEDGED: RuleStatus.LATCHED,
    Phase.LATCHED: RuleStatus.LATCHED,
    Phase.RTN_UNACKNOWLEDGED: RuleStatus.RETURNED,
    Phase.PENDING: RuleStatus.PENDING,
    Phase.NORMAL: RuleStatus.IDLE,
}


def _status(state: AlarmState, holds: bool | None) -> RuleStatus:
    if state.has_let_go:
        return RuleStatus.UNKNOWN
    if holds is not None or state.phase in LATCHED or state.phase is Phase.RTN_UNACKNOWLEDGED:
        return _STATUS[state.phase]
    return RuleStatus.ACTIVE if state.is_active else RuleStatus.UNKNOWN


def _trace(rule: AlarmRule, state: AlarmState, status: RuleStatus, active: bool | None, before: RuleTrace) -> RuleTrace:
    inhibits = state.inhibits.words() if state.inhibits is not NO_INHIBITS else ()
    now = trace_of(rule, status)
    return renewed(
        replace(
            now,
            active=active,
            acknowledged=state.is_acknowledged,
            gates=(*inhibits, *now.gates),
            chattering=state.is_chattering,
        ),
        before,
    )


# ---- Operator commands: what is done, what is refused, and why ----

Refusal = str
"""Why a command is not done; empty if it is."""


def operated(
    alarms: Mapping[str, tuple[int, AlarmRule, AlarmState]], inputs: RuleInputs, command: OperatorCommand
) -> tuple[Answer, list[tuple[int, Evaluation]]]:
    """Do what an operator wants of one alarm, or of all.

    Args:
        alarms: Every alarm by its name, with its position in the plan and what it remembers.

    Returns:
        The answer, and the alarms that were changed, with their positions.
    """
    if command.rule and command.rule not in alarms:
        words = f"there is no alarm '{command.rule}'; there are: {', '.join(alarms) or 'none'}"
        return Answer(id=command.id, accepted=False, words=words), []
    chosen = [command.rule] if command.rule else list(alarms)
    found = [(alarms[name][0], Evaluation(alarms[name][1], alarms[name][2], inputs)) for name in chosen]
    if not command.rule:
        found = [(index, each) for index, each in found if _applies(each, command.action)]
    refusals = [(each.rule.name, _operate(each, command)) for _, each in found]
    refused = [f"{name}: {refusal}" for name, refusal in refusals if refusal]
    if refused:
        return Answer(id=command.id, accepted=False, words="; ".join(refused)), found
    done = ", ".join(_done(each, command.action) for _, each in found) or "no alarm needs it"
    return Answer(id=command.id, accepted=bool(refusals), words=f"{command.action.value}: {done}"), found


def _done(evaluation: Evaluation, action: OperatorAction) -> str:
    until_s = evaluation.state.inhibits.shelved_until_s
    if action is not OperatorAction.SHELVE or until_s is None:
        return evaluation.rule.name
    return f"{evaluation.rule.name} for {duration(round(until_s - evaluation.inputs.now_s, 3))}"


def _applies(evaluation: Evaluation, action: OperatorAction) -> bool:
    """Return whether a command to every alarm is meant for this one."""
    rule, state, inhibits = evaluation.rule, evaluation.state, evaluation.state.inhibits
    may_be_quiet = not _why_not_quiet(rule)
    applies = {
        OperatorAction.ACKNOWLEDGE: not state.is_acknowledged,
        OperatorAction.RESET: state.phase in LATCHED,
        OperatorAction.SHELVE: inhibits.shelved_until_s is None and may_be_quiet and rule.shelve_max_s > 0,
        OperatorAction.UNSHELVE: inhibits.shelved_until_s is not None,
        OperatorAction.TAKE_OUT: not inhibits.is_out_of_service and may_be_quiet,
        OperatorAction.PUT_BACK: inhibits.is_out_of_service,
    }
    return applies[action]


def _operate(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    refusal = _ACTIONS[command.action](evaluation, command)
    if refusal:
        reason = f"{command.action.value}: {refusal}"
        evaluation.add_event(EventKind.REFUSED, reason, notify=False, by=command.by)
    return refusal


def _acknowledge(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    if evaluation.state.is_acknowledged:
        return "there is nothing to acknowledge"
    evaluation.add_event(EventKind.ACKNOWLEDGED, command.said, notify=not evaluation.is_quiet, by=command.by)
    said = Acknowledgement(at_s=evaluation.inputs.now_s, by=command.by, why=command.why)
    state = replace(machine.acknowledged(evaluation.rule, evaluation.state), acknowledgement=said)
    evaluation.go(state, command.said, command.by)
    return ""


def _reset(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    state = evaluation.state
    if state.phase not in LATCHED:
        return why_not_latched(evaluation.rule, state, evaluation.inputs)
    if Trigger.RESET not in TRANSITIONS[state.phase]:
        return "it is not acknowledged; acknowledge it first"
    evaluation.add_event(EventKind.RESET, command.said, notify=False, by=command.by)
    evaluation.go(machine.fire(state, Trigger.RESET), command.said, command.by)
    return ""


def _shelve(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    rule, longest_s = evaluation.rule, evaluation.rule.shelve_max_s
    refusal = _why_not_quiet(rule)
    if refusal:
        return refusal
    if longest_s <= 0:
        return "its configuration does not let it be shelved (shelve_max)"
    for_s = longest_s if command.for_s is None else command.for_s
    if not 0 < for_s <= longest_s:  # NaN fails this too
        longest = duration(longest_s)
        return f"{duration(for_s)} is not a time above zero and up to {longest}, the longest for '{rule.name}'"
    until_s, inhibits = evaluation.inputs.now_s + for_s, evaluation.state.inhibits
    inhibits = replace(inhibits, shelved_until_s=until_s, is_one_shot=command.one_shot, shelved_by=command.by)
    evaluation.change(inhibits=inhibits)
    how = f"for {duration(for_s)}" + (", or until it has returned to normal" if command.one_shot else "")
    evaluation.add_event(EventKind.SHELVED, f"{how}: {command.said}", notify=False, by=command.by)
    return ""


def _unshelve(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    if evaluation.state.inhibits.shelved_until_s is None:
        return "it is not shelved"
    unshelve(evaluation, command.said, command.by)
    return ""


def _take_out(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    rule, inhibits = evaluation.rule, evaluation.state.inhibits
    refusal = _why_not_quiet(rule)
    if refusal or inhibits.is_out_of_service:
        return refusal or "it is out of service already"
    evaluation.change(inhibits=replace(inhibits, is_out_of_service=True))
    evaluation.add_event(EventKind.OUT_OF_SERVICE, command.said, notify=not rule.observe, by=command.by)
    return ""


def _put_back(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    inhibits = evaluation.state.inhibits
    if not inhibits.is_out_of_service:
        return "it is not out of service"
    evaluation.change(inhibits=replace(inhibits, is_out_of_service=False))
    evaluation.add_event(EventKind.IN_SERVICE, command.said, notify=not evaluation.is_quiet, by=command.by)
    return ""


def _why_not_quiet(rule: AlarmRule) -> Refusal:
    return "a safety rule cannot be kept quiet" if rule.severity is Severity.SAFETY else ""


_ACTIONS: Mapping[OperatorAction, Callable[[Evaluation, OperatorCommand], Refusal]] = {
    OperatorAction.ACKNOWLEDGE: _acknowledge,
    OperatorAction.RESET: _reset,
    OperatorAction.SHELVE: _shelve,
    OperatorAction.UNSHELVE: _unshelve,
    OperatorAction.TAKE_OUT: _take_out,
    OperatorAction.PUT_BACK: _put_back,
}
