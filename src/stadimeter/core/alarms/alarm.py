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
from stadimeter.core.conditions.leaf import Rest
from stadimeter.core.decision import Event, EventKind, Notice, RuleStatus, RuleTrace, Severity
from stadimeter.core.operator import OperatorAnswer, OperatorCommand
from stadimeter.core.rule import ROUNDING_S, AlarmRule
from stadimeter.core.rule_step import OBSERVED, Step, keep_if_same, trace_of
from stadimeter.core.track import TrackStatus
from stadimeter.core.words import duration
from stadimeter.operator_actions import OperatorAction

# At the start of a run, and after a restart, a target may take this long to be seen: until then it is not lost.
AWAITED_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmStep(Step):
    """What an alarm does in one cycle, and remembers."""

    state: AlarmState = field(default_factory=AlarmState)


class Stepped(NamedTuple):
    """An alarm after a cycle: what it does, what happened, what is to be sent, and for how long it is quiescent."""

    step: AlarmStep
    """That of the cycle before, if nothing changed."""
    events: tuple[Event, ...]
    notices: tuple[Notice, ...]
    rest: Rest | None
    """None if it must be evaluated in the next cycle."""


def new_alarm(rule: AlarmRule) -> AlarmStep:
    """Return an alarm before the first cycle of a run."""
    return AlarmStep(trace=trace_of(rule, RuleStatus.UNKNOWN))


def with_state(rule: AlarmRule, step: AlarmStep, state: AlarmState) -> AlarmStep:
    """Return an alarm that has another state since its step, by a command or by a restart. It must be evaluated."""
    active = state.is_active or None
    return replace(step, trace=_trace(rule, state, step.trace.status, active, step.trace), state=state)


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
    evaluation = Evaluation(rule, before.state, inputs, is_first=is_first)
    state = evaluation.state
    if inputs.is_after_gap:
        machine.restart_timers(state, inputs.now_s)
    verdict = conditions.judge(rule.condition, inputs, state.timers.leaves, is_active=state.is_judged_by_its_end)
    is_awaited = _is_awaited(rule, state, inputs)
    holds = None if is_awaited else verdict.value
    if state.is_chattering:
        machine.calm_down(rule, state, inputs.now_s)
        evaluation.report()
    if holds is None:
        _without_verdict(evaluation, is_awaited=is_awaited)
    else:
        _with_verdict(evaluation, holds, verdict.held, sample)
    stand(evaluation)
    rest = None if is_awaited else _rest(evaluation, before.state, holds)
    return Stepped(_step(before, evaluation, bases, holds), evaluation.events, evaluation.notices, rest)


def _with_verdict(evaluation: Evaluation, holds: bool, held: tuple[bool, ...], sample: Sample | None) -> None:
    rule, inputs, state = evaluation.rule, evaluation.inputs, evaluation.state
    if state.unknown_since_s is not None:
        was_given_up, away_s = state.is_given_up, inputs.now_s - state.unknown_since_s
        machine.come_back(rule, state, inputs.now_s)
        if was_given_up:
            reason = f"there is something to judge by again, after {away_s:.1f} s"
            evaluation.add_event(EventKind.MEASUREMENT_BACK, reason, notify=not evaluation.is_quiet)
    if sample is None or machine.is_settled(state, holds, held):
        return
    # A frame whose measurement was refused as an outlier contradicts the track that the condition is judged by: it
    # counts neither for an alarm that is not raised nor against it.
    if not state.is_active and inputs.tracks[rule.target].rejected > 0:
        machine.pass_over(state, sample.since_s)
    else:
        machine.take_sample(rule, state, sample, holds, held, now_s=inputs.now_s)
        evaluation.report()


def _without_verdict(evaluation: Evaluation, *, is_awaited: bool) -> None:
    rule, inputs, state = evaluation.rule, evaluation.inputs, evaluation.state
    if state.resumed is not None:
        if inputs.now_s - state.resumed.at_s < AWAITED_S:
            return
        state.resumed = None
    if is_awaited:
        return
    was_active, was_given_up = state.is_active, state.is_given_up
    machine.take_nothing(rule, state, inputs.now_s)
    has_turned = state.is_active is not was_active
    evaluation.report(f"{missing_in_words(rule, state, inputs)}: {in_words(rule, state, inputs)}" if has_turned else "")
    if state.is_given_up and not was_given_up:
        reason = given_up_in_words(rule, state, inputs)
        evaluation.add_event(EventKind.MEASUREMENT_LOST, reason, notify=not evaluation.is_quiet)


def _is_awaited(rule: AlarmRule, state: AlarmState, inputs: RuleInputs) -> bool:
    """Return whether it would be a guess that a target is lost: at the start none has been seen yet.

    A rule for safety does not wait: to it, not seeing counts at once.
    """
    if rule.severity is Severity.SAFETY or not inputs.tracks:
        return False
    for track in inputs.tracks.values():  # a loop: `any` with a generator takes three times as long
        if track.status is not TrackStatus.SEARCHING:
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


def _step(before: AlarmStep, evaluation: Evaluation, bases: frozenset[str], holds: bool | None) -> AlarmStep:
    """Return what an alarm does after its evaluation; the step of the cycle before if nothing has changed."""
    rule, state, was = evaluation.rule, evaluation.state, before.trace
    if holds is None:
        holds = machine.decided_by_policy(rule, state, evaluation.inputs.now_s)
    status, active = _status(state, holds), state.is_active or (None if holds is None else False)
    requests = requests_of(evaluation, before.requests, bases)
    is_same = (
        status is was.status
        and active is was.active
        and state.is_acknowledged is was.acknowledged
        and state.is_chattering is was.chattering
        and state.inhibits is before.state.inhibits
    )
    if is_same and requests is before.requests and state == before.state:
        return before
    trace = was if is_same else _trace(rule, state, status, active, was)
    return AlarmStep(trace=trace, requests=requests, state=state)


def _rest(evaluation: Evaluation, before: AlarmState, holds: bool | None) -> Rest | None:
    """Return for how long an alarm is quiescent, that is, an evaluation would change nothing; None for not at all.

    Nothing else decides that. `Quiescence` keeps the answer, and wakes the alarm when it is over.

    Args:
        before: What the alarm remembered before this cycle.
        holds: Whether its condition holds; None if that is not known.
    """
    rule, state = evaluation.rule, evaluation.state
    is_changing = holds is not None and not machine.is_settled(state, holds, state.timers.leaves)
    if is_changing or state.resumed is not None:
        return None
    due = due_s(evaluation)
    if state.leg is not None and evaluation.has_patterns and (state.is_active or math.isfinite(due)):
        return None  # a level changes by itself: of the alarm, or of a step that goes on after it has cleared
    # An alarm that is judged in another way than before (by what begins its condition, in place of what ends it) does
    # not stay as it is: its verdict is of the old way.
    how = _judged_by(rule, state)
    if how != _judged_by(rule, before):
        return None
    rest = Rest(due_s=due)
    for condition, held, is_on in how:
        one = conditions.rest_of(condition, evaluation.inputs, held, is_active=is_on)
        if one is None:
            return None
        rest &= one
    return rest


def _judged_by(rule: AlarmRule, state: AlarmState) -> tuple[tuple[Condition, tuple[bool, ...], bool], ...]:
    """Return the conditions that an alarm is judged by, the memory of their parts, and whether they are on."""
    own = rule.condition, state.timers.leaves, state.is_judged_by_its_end
    if rule.suppress_when is None:
        return (own,)
    return own, (rule.suppress_when, state.inhibits.leaves, state.inhibits.is_suppressed)


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
    now = RuleTrace(
        rule=rule.name,
        status=status,
        output=rule.output,
        acknowledged=state.is_acknowledged,
        gates=(*inhibits, OBSERVED) if rule.observe else inhibits,
        active=active,
        chattering=state.is_chattering,
    )
    return keep_if_same(now, before)


# ---- Operator commands: what is done, what is refused, and why ----

Refusal = str  # why a command is not done; empty if it is


def operate(
    alarms: Mapping[str, tuple[int, AlarmRule, AlarmStep]], inputs: RuleInputs, command: OperatorCommand
) -> tuple[OperatorAnswer, list[tuple[int, Evaluation]]]:
    """Do what an operator wants of one alarm, or of all.

    Args:
        alarms: Every alarm by its name, with its position in the plan and its step.

    Returns:
        The answer, and the alarms that were changed, with their positions.
    """
    if command.rule and command.rule not in alarms:
        words = f"there is no alarm '{command.rule}'; there are: {', '.join(alarms) or 'none'}"
        return OperatorAnswer(id=command.id, accepted=False, words=words), []
    chosen = [command.rule] if command.rule else list(alarms)
    found = [(alarms[name][0], Evaluation(alarms[name][1], alarms[name][2].state, inputs)) for name in chosen]
    if not command.rule:
        found = [(index, each) for index, each in found if _applies(each, command.action)]
    refusals = [(each.rule.name, _operate(each, command)) for _, each in found]
    refused = [f"{name}: {refusal}" for name, refusal in refusals if refusal]
    if refused:
        return OperatorAnswer(id=command.id, accepted=False, words="; ".join(refused)), found
    done = ", ".join(_done(each, command.action) for _, each in found) or "no alarm needs it"
    return OperatorAnswer(id=command.id, accepted=bool(refusals), words=f"{command.action.value}: {done}"), found


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
    machine.acknowledge(evaluation.rule, evaluation.state)
    evaluation.state.acknowledgement = Acknowledgement(at_s=evaluation.inputs.now_s, by=command.by, why=command.why)
    evaluation.report(command.said, command.by)
    return ""


def _reset(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    state = evaluation.state
    if state.phase not in LATCHED:
        return why_not_latched(evaluation.rule, state, evaluation.inputs)
    if Trigger.RESET not in TRANSITIONS[state.phase]:
        return "it is not acknowledged; acknowledge it first"
    evaluation.add_event(EventKind.RESET, command.said, notify=False, by=command.by)
    machine.fire(state, Trigger.RESET)
    evaluation.report(command.said, command.by)
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
    evaluation.state.inhibits = inhibits
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
    evaluation.state.inhibits = replace(inhibits, is_out_of_service=True)
    evaluation.add_event(EventKind.OUT_OF_SERVICE, command.said, notify=not rule.observe, by=command.by)
    return ""


def _put_back(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    inhibits = evaluation.state.inhibits
    if not inhibits.is_out_of_service:
        return "it is not out of service"
    evaluation.state.inhibits = replace(inhibits, is_out_of_service=False)
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
