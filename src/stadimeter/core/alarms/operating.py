"""What operators tell alarms: what is done, what is refused, and why."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from stadimeter.core.alarms.standing import end, unshelve
from stadimeter.core.alarms.state import AlarmState
from stadimeter.core.alarms.table import LATCHED, TRANSITIONS, Trigger
from stadimeter.core.alarms.turn import AlarmTurn
from stadimeter.core.conditions.known import Known
from stadimeter.core.decision import EventKind, Severity
from stadimeter.core.operator import Answer, OperatorAction, OperatorCommand
from stadimeter.core.rule import AlarmRule
from stadimeter.core.words import duration

Refusal = str
"""Why something is not done; empty if it is."""


def operated(
    alarms: Mapping[str, tuple[int, AlarmRule, AlarmState]], known: Known, command: OperatorCommand
) -> tuple[Answer, list[tuple[int, AlarmTurn]]]:
    """Do what an operator wants of one alarm, or of all.

    Args:
        alarms: Every alarm by its name, with its position in the plan and what it remembers.
        known: All that alarms can be judged by.
        command: What is wanted.

    Returns:
        The answer, and the alarms that something was made of, with their positions.
    """
    if command.rule and command.rule not in alarms:
        words = f"there is no alarm '{command.rule}'; there are: {', '.join(alarms) or 'none'}"
        return Answer(id=command.id, accepted=False, words=words), []
    chosen = [command.rule] if command.rule else list(alarms)
    turns = [(alarms[name][0], AlarmTurn(alarms[name][1], alarms[name][2], known)) for name in chosen]
    if not command.rule:
        turns = [(index, turn) for index, turn in turns if applies(turn, command.action)]
    refusals = [(turn.rule.name, operate(turn, command)) for _, turn in turns]
    refused = [f"{name}: {refusal}" for name, refusal in refusals if refusal]
    if refused:
        return Answer(id=command.id, accepted=False, words="; ".join(refused)), turns
    done = ", ".join(_done(turn, command.action) for _, turn in turns) or "no alarm needs it"
    return Answer(id=command.id, accepted=bool(refusals), words=f"{command.action.value}: {done}"), turns


def _done(turn: AlarmTurn, action: OperatorAction) -> str:
    until_s = turn.state.gates.shelved_until_s
    if action is not OperatorAction.SHELVE or until_s is None:
        return turn.rule.name
    return f"{turn.rule.name} for {duration(round(until_s - turn.known.now_s, 3))}"


def applies(turn: AlarmTurn, action: OperatorAction) -> bool:
    """Return whether a command to every rule is meant for this one.

    Args:
        turn: The alarm.
        action: What is wanted.

    Returns:
        Whether there is something to acknowledge, reset, shelve and so on.
    """
    state, gates = turn.state, turn.state.gates
    match action:
        case OperatorAction.ACKNOWLEDGE:
            return not state.is_acknowledged
        case OperatorAction.RESET:
            return state.phase in LATCHED
        case OperatorAction.SHELVE:
            return gates.shelved_until_s is None and not _why_not_quiet(turn) and turn.rule.shelve_max_s > 0
        case OperatorAction.UNSHELVE:
            return gates.shelved_until_s is not None
        case OperatorAction.TAKE_OUT:
            return not gates.is_out_of_service and not _why_not_quiet(turn)
        case OperatorAction.PUT_BACK:
            return gates.is_out_of_service


def operate(turn: AlarmTurn, command: OperatorCommand) -> Refusal:
    """Do what an operator wants of an alarm.

    Args:
        turn: The alarm.
        command: What is wanted.

    Returns:
        Why it is not done; empty if it is.
    """
    refusal = _ACTIONS[command.action](turn, command)
    if refusal:
        turn.tell(
            EventKind.REFUSED, turn.known.now_s, f"{command.action.value}: {refusal}", notify=False, by=command.by
        )
    return refusal


def _acknowledge(turn: AlarmTurn, command: OperatorCommand) -> Refusal:
    if turn.state.is_acknowledged:
        return "there is nothing to acknowledge"
    turn.trigger(Trigger.ACKNOWLEDGE)
    turn.tell(EventKind.ACKNOWLEDGED, turn.known.now_s, _said(command), notify=not turn.is_quiet, by=command.by)
    return ""


def _reset(turn: AlarmTurn, command: OperatorCommand) -> Refusal:
    state, now_s = turn.state, turn.known.now_s
    if state.phase not in LATCHED:
        return "its condition still holds" if state.is_active else "it is not latched"
    if Trigger.RESET not in TRANSITIONS[state.phase]:
        return "nobody has acknowledged it; acknowledge it first"
    turn.trigger(Trigger.RESET)
    turn.tell(EventKind.RESET, now_s, _said(command), notify=False, by=command.by)
    end(turn, now_s, _said(command), command.by)
    return ""


def _shelve(turn: AlarmTurn, command: OperatorCommand) -> Refusal:
    rule, longest_s = turn.rule, turn.rule.shelve_max_s
    refusal = _why_not_quiet(turn)
    if refusal:
        return refusal
    if longest_s <= 0:
        return "its configuration does not let it be shelved (shelve_max)"
    for_s = longest_s if command.for_s is None else command.for_s
    if not 0 < for_s <= longest_s:  # NaN fails this too
        longest = duration(longest_s)
        return f"{duration(for_s)} is not a time above zero and up to {longest}, the longest for '{rule.name}'"
    until_s = turn.known.now_s + for_s
    gates = replace(turn.state.gates, shelved_until_s=until_s, is_one_shot=command.one_shot, shelved_by=command.by)
    turn.change(gates=gates)
    how = f"for {duration(for_s)}" + (", or until it has returned to normal" if command.one_shot else "")
    turn.tell(EventKind.SHELVED, turn.known.now_s, f"{how}: {_said(command)}", notify=False, by=command.by)
    return ""


def _unshelve(turn: AlarmTurn, command: OperatorCommand) -> Refusal:
    if turn.state.gates.shelved_until_s is None:
        return "it is not shelved"
    unshelve(turn, _said(command), command.by)
    return ""


def _take_out(turn: AlarmTurn, command: OperatorCommand) -> Refusal:
    refusal = _why_not_quiet(turn)
    if refusal or turn.state.gates.is_out_of_service:
        return refusal or "it is out of service already"
    turn.change(gates=replace(turn.state.gates, is_out_of_service=True))
    turn.tell(EventKind.OUT_OF_SERVICE, turn.known.now_s, _said(command), notify=not turn.rule.observe, by=command.by)
    return ""


def _put_back(turn: AlarmTurn, command: OperatorCommand) -> Refusal:
    if not turn.state.gates.is_out_of_service:
        return "it is not out of service"
    turn.change(gates=replace(turn.state.gates, is_out_of_service=False))
    turn.tell(EventKind.IN_SERVICE, turn.known.now_s, _said(command), notify=not turn.is_quiet, by=command.by)
    return ""


def _why_not_quiet(turn: AlarmTurn) -> Refusal:
    return "a safety rule cannot be kept quiet" if turn.rule.severity is Severity.SAFETY else ""


def _said(command: OperatorCommand) -> str:
    who = f"by {command.by}" if command.by else "by somebody"
    return f"{who}: {command.why}" if command.why else who


_ACTIONS: Mapping[OperatorAction, Callable[[AlarmTurn, OperatorCommand], Refusal]] = {
    OperatorAction.ACKNOWLEDGE: _acknowledge,
    OperatorAction.RESET: _reset,
    OperatorAction.SHELVE: _shelve,
    OperatorAction.UNSHELVE: _unshelve,
    OperatorAction.TAKE_OUT: _take_out,
    OperatorAction.PUT_BACK: _put_back,
}
