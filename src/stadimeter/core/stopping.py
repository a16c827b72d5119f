"""Stop everything: a person puts every output at its safe value, until it is released.

It stands before all rules, those of ``severity = "safety"`` too, and ends every hold. The rules go on beneath: alarms
are raised, recorded and announced. However often it was stopped, one release ends it.
"""

from __future__ import annotations

from collections.abc import Sequence

from stadimeter.core.decision import Event, EventKind, Severity
from stadimeter.core.operator import AnyCommand, OperatorAnswer, OperatorCommand
from stadimeter.operator_actions import OperatorAction

# Stands in events for all of them.
OUTPUTS = "outputs"

Stepped = tuple[str, tuple[OperatorAnswer, ...], tuple[Event, ...]]


def step_stop(stopped: str, commands: Sequence[AnyCommand], now_s: float) -> Stepped:
    """Return who has stopped every output by now, the answers to those who want it or end it, and what happened.

    Args:
        stopped: Who has done it before, and why, in words; empty while no one has.
    """
    answers: list[OperatorAnswer] = []
    events: list[Event] = []
    for command in commands:
        if not isinstance(command, OperatorCommand) or not command.action.is_on_outputs:
            continue
        is_stop = command.action is OperatorAction.STOP_OUTPUTS
        answers.append(OperatorAnswer(id=command.id, accepted=True, words=_words(stopped, is_stop=is_stop)))
        if is_stop is not bool(stopped):
            stopped = command.said if is_stop else ""
            events.append(_event(command, now_s, is_stop=is_stop))
    return stopped, tuple(answers), tuple(events)


def _words(stopped: str, *, is_stop: bool) -> str:
    """Say what comes of a command, given who had stopped them before it."""
    if is_stop:
        return f"the outputs were stopped already, {stopped}" if stopped else "the outputs are stopped until released"
    return f"the outputs are released; they were stopped {stopped}" if stopped else "the outputs were not stopped"


def _event(command: OperatorCommand, now_s: float, *, is_stop: bool) -> Event:
    return Event(
        kind=EventKind.STOPPED if is_stop else EventKind.RELEASED,
        source=OUTPUTS,
        at_s=now_s,
        severity=Severity.SAFETY if is_stop else Severity.INFO,
        reason=command.said,
        by=command.by,
    )
