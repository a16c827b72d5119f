"""Operator commands: what each does to an alarm, what is refused, and why."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from msgspec.structs import replace

from stadimeter.core.alarms import machine
from stadimeter.core.alarms.actions import Evaluation, unshelve
from stadimeter.core.alarms.alarm import OperatedStep, why_not_latched
from stadimeter.core.alarms.machine import LATCHED, TRANSITIONS, RuleThreshold, Trigger, move, thresholds_of
from stadimeter.core.alarms.state import Acknowledgement, SetThreshold
from stadimeter.core.conditions.compounds import leaves
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.remembered import RememberedCondition
from stadimeter.core.decision import EventKind, Severity
from stadimeter.core.rule import AlarmRule
from stadimeter.core.words import duration, figure_in_words, rounded_duration
from stadimeter.operator_actions import OperatorAction, OperatorAnswer, OperatorCommand

Refusal = str  # why a command is not done; empty if it is


def operate(
    alarms: Mapping[str, tuple[int, AlarmRule, OperatedStep]], inputs: RuleInputs, command: OperatorCommand
) -> tuple[OperatorAnswer, list[tuple[int, Evaluation]]]:
    """Do what an operator wants of one alarm, or of all.

    Args:
        alarms: Every alarm, and the gate of every other rule, by its name, with its position in the plan and its step.

    Returns:
        The answer, and the alarms that were changed, with their positions.
    """
    if command.rule and command.rule not in alarms:
        words = f"there is no alarm '{command.rule}'; there are: {', '.join(alarms) or 'none'}"
        return OperatorAnswer(id=command.id, accepted=False, words=words), []
    chosen = [command.rule] if command.rule else list(alarms)
    found = [(alarms[name][0], Evaluation(alarms[name][1], alarms[name][2].record, inputs)) for name in chosen]
    if not command.rule:
        found = [(index, each) for index, each in found if _applies(each, command.action)]
    refusals = [(each.rule.name, _operate(each, command)) for _, each in found]
    refused = [f"{name}: {refusal}" for name, refusal in refusals if refusal]
    if refused:
        return OperatorAnswer(id=command.id, accepted=False, words="; ".join(refused)), found
    done = ", ".join(_done(each, command.action) for _, each in found) or "no alarm needs it"
    return OperatorAnswer(id=command.id, accepted=bool(refusals), words=f"{command.action.value}: {done}"), found


def _done(evaluation: Evaluation, action: OperatorAction) -> str:
    until_s = evaluation.record.inhibits.shelved_until_s
    if action is not OperatorAction.SHELVE or until_s is None:
        return evaluation.rule.name
    return f"{evaluation.rule.name} for {duration(round(until_s - evaluation.inputs.now_s, 3))}"


def _applies(evaluation: Evaluation, action: OperatorAction) -> bool:
    """Check whether a command to every alarm is meant for this one."""
    rule, record, inhibits = evaluation.rule, evaluation.record, evaluation.record.inhibits
    may_be_quiet = not _why_not_quiet(rule)
    applies = {
        OperatorAction.ACKNOWLEDGE: not record.is_acknowledged,
        OperatorAction.RESET: record.state in LATCHED,
        OperatorAction.SHELVE: inhibits.shelved_until_s is None and may_be_quiet and rule.shelve_max_s > 0,
        OperatorAction.UNSHELVE: inhibits.shelved_until_s is not None,
        OperatorAction.TAKE_OUT: not inhibits.is_out_of_service and may_be_quiet,
        OperatorAction.PUT_BACK: inhibits.is_out_of_service,
        OperatorAction.OBSERVE: not rule.observe and may_be_quiet,
        OperatorAction.ACT: inhibits.is_observed,
        OperatorAction.SET_THRESHOLD: False,  # a value is for one rule
        OperatorAction.WITHDRAW_THRESHOLD: bool(record.thresholds),
    }
    return applies[action]


def _operate(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    refusal = _ACTIONS[command.action](evaluation, command)
    if refusal:
        reason = f"{command.action.value}: {refusal}"
        evaluation.add_event(EventKind.REFUSED, reason, notify=False, by=command.by)
    return refusal


def _acknowledge(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    if evaluation.record.is_acknowledged:
        return "there is nothing to acknowledge"
    evaluation.add_event(EventKind.ACKNOWLEDGED, command.said, notify=not evaluation.is_quiet, by=command.by)
    machine.acknowledge(evaluation.rule, evaluation.record)
    evaluation.record.acknowledgement = Acknowledgement(at_s=evaluation.inputs.now_s, by=command.by, why=command.why)
    evaluation.report(command.said, command.by)
    return ""


def _reset(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    record = evaluation.record
    if record.state not in LATCHED and any(
        isinstance(leaf, RememberedCondition) and leaf.rules for leaf in leaves(evaluation.rule.condition)
    ):  # what it counts is emptied in `stadimeter.core.decide`
        evaluation.add_event(EventKind.RESET, f"it counts anew: {command.said}", notify=False, by=command.by)
        return ""
    if record.state not in LATCHED:
        return why_not_latched(evaluation.rule, record, evaluation.inputs)
    if Trigger.RESET not in TRANSITIONS[record.state]:
        return "it is not acknowledged; acknowledge it first"
    evaluation.add_event(EventKind.RESET, command.said, notify=False, by=command.by)
    machine.fire(record, Trigger.RESET)
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
    until_s, inhibits = evaluation.inputs.now_s + for_s, evaluation.record.inhibits
    held_s = inhibits.shelved_until_s
    if held_s is not None and (until_s < held_s or (command.one_shot and not inhibits.is_one_shot)):
        # Who may only quiet rules must not let one act sooner.
        return f"it is shelved for another {rounded_duration(held_s - evaluation.inputs.now_s)}; unshelve it first"
    inhibits = replace(inhibits, shelved_until_s=until_s, is_one_shot=command.one_shot, shelved_by=command.by)
    evaluation.record.inhibits = inhibits
    how = f"for {duration(for_s)}" + (", or until it has returned to normal" if command.one_shot else "")
    evaluation.add_event(EventKind.SHELVED, f"{how}: {command.said}", notify=False, by=command.by)
    return ""


def _unshelve(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    if evaluation.record.inhibits.shelved_until_s is None:
        return "it is not shelved"
    unshelve(evaluation, command.said, command.by)
    return ""


def _take_out(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    rule, inhibits = evaluation.rule, evaluation.record.inhibits
    refusal = _why_not_quiet(rule)
    if refusal or inhibits.is_out_of_service:
        return refusal or "it is out of service already"
    evaluation.record.inhibits = replace(inhibits, is_out_of_service=True)
    evaluation.add_event(EventKind.OUT_OF_SERVICE, command.said, notify=not rule.observe, by=command.by)
    return ""


def _put_back(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    inhibits = evaluation.record.inhibits
    if not inhibits.is_out_of_service:
        return "it is not out of service"
    evaluation.record.inhibits = replace(inhibits, is_out_of_service=False)
    evaluation.add_event(EventKind.IN_SERVICE, command.said, notify=not evaluation.is_quiet, by=command.by)
    return ""


def _observe(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    rule, record = evaluation.rule, evaluation.record
    refusal = _why_not_quiet(rule)
    if refusal or rule.observe:
        return refusal or "it is only observed already"
    record.inhibits = replace(record.inhibits, is_observed=True)
    evaluation.add_event(EventKind.OBSERVED, command.said, notify=not evaluation.is_quiet, by=command.by)
    evaluation.rule = replace(rule, observe=True)
    return ""


def _act(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    rule, record = evaluation.rule, evaluation.record
    if not record.inhibits.is_observed:
        return "its configuration says observe = true" if rule.observe else "it is not only observed"
    record.inhibits = replace(record.inhibits, is_observed=False)
    evaluation.rule = replace(rule, observe=False)
    evaluation.add_event(EventKind.ACTING, command.said, notify=not evaluation.is_quiet, by=command.by)
    return ""


def _set_threshold(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    rule, record = evaluation.rule, evaluation.record
    if rule.severity is Severity.SAFETY:
        return "the thresholds of a safety rule are those of its configuration"
    found = thresholds_of(rule)
    key = command.key or (next(iter(found)) if len(found) == 1 else "")
    if key not in found:
        return _which(command.key, found)
    refusal = _why_not_taken(key, found[key], command)
    if refusal or command.value is None:
        return refusal
    before = next((each for each in record.thresholds if each.key == key), None)
    configured = found[key].value if before is None else before.configured
    unit, value = found[key].unit, command.value
    setting = SetThreshold(
        key=key, value=value, configured=configured, unit=unit, at_s=evaluation.inputs.now_s, by=command.by
    )
    record.thresholds = (*(each for each in record.thresholds if each.key != key), setting)
    evaluation.rule = move(rule, {key: value})
    words, instead = (figure_in_words(each, unit) for each in (value, configured))
    reason = f"{key} is {words}, the configuration says {instead}: {command.said}"
    evaluation.add_event(EventKind.THRESHOLD_SET, reason, notify=False, by=command.by)
    return ""


def _withdraw_threshold(evaluation: Evaluation, command: OperatorCommand) -> Refusal:
    record, found = evaluation.record, thresholds_of(evaluation.rule)
    gone = [each for each in record.thresholds if command.key in {"", each.key}]
    if command.key and command.key not in found:
        return _which(command.key, found)
    if not gone:
        return f"{command.key or 'none of its thresholds'} is not set: it is as the configuration says"
    if command.key and not found[command.key].takes(gone[0].configured):  # between what is still set elsewhere
        return f"{command.key} takes {found[command.key].range_in_words} while the others are set; withdraw all at once"
    record.thresholds = tuple(each for each in record.thresholds if each not in gone)
    evaluation.rule = move(evaluation.rule, {each.key: each.configured for each in gone})
    again = ", ".join(f"{each.key} is {figure_in_words(each.configured, each.unit)}" for each in gone)
    reason = f"{again} again, as the configuration says: {command.said}"
    evaluation.add_event(EventKind.THRESHOLD_WITHDRAWN, reason, notify=False, by=command.by)
    return ""


def _which(key: str, found: Mapping[str, RuleThreshold]) -> Refusal:
    """Say which thresholds there are, where a key names none or is missing."""
    if not found:
        return "it has no threshold that can be set"
    which = f"it has no threshold '{key}'" if key else "name one of its thresholds"
    return f"{which}; there are: {', '.join(found)}"


def _why_not_taken(key: str, found: RuleThreshold, command: OperatorCommand) -> Refusal:
    if command.value is None:
        return "name the value"
    if command.unit not in {"", found.unit}:
        return f"{key} is in {found.unit}, and not in {command.unit}"
    if not found.takes(command.value):
        return f"{key} takes {found.range_in_words}, and not {command.value:.6g}"
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
    OperatorAction.OBSERVE: _observe,
    OperatorAction.ACT: _act,
    OperatorAction.SET_THRESHOLD: _set_threshold,
    OperatorAction.WITHDRAW_THRESHOLD: _withdraw_threshold,
}
