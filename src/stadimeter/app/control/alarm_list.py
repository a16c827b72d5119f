"""The alarms of a run for an operator: which there are, since when, and who has acknowledged what."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

from stadimeter.app.control.messages import NoArgs, Reply
from stadimeter.app.control.socket_server import Answer
from stadimeter.app.cycle import CycleRecord
from stadimeter.core.alarms.alarm import AlarmStep
from stadimeter.core.alarms.state import Acknowledgement
from stadimeter.core.decide import State
from stadimeter.core.decision import Decision, Event, EventKind
from stadimeter.core.rule import AlarmRule


@dataclass(frozen=True, slots=True, kw_only=True)
class _AlarmTimes:
    """What has happened to an alarm since it was last raised; times on the run's clock."""

    raised_at_s: float | None = None
    cleared_at_s: float | None = None


class AlarmList:
    """Follows the alarms of a run.

    Args:
        events: Returns the newest events of the run.
        events_json: Writes events as JSON, given what to add to the run's clock for the wall clock.
    """

    def __init__(
        self,
        events: Callable[[], tuple[Event, ...]],
        events_json: Callable[[Iterable[Event], float], str],
        unix_s: Callable[[], float] = time.time,
    ) -> None:
        self._events = events
        self._events_json = events_json
        self._unix_s = unix_s
        self._courses: dict[str, _AlarmTimes] = {}
        self._state: State | None = None
        self._decision: Decision | None = None

    def cycle(self, state: State, record: CycleRecord) -> None:
        """Take in a cycle."""
        self._state, self._decision = state, record.decision
        for event in record.decision.events:
            course = self._courses.get(event.source, _AlarmTimes())
            if event.kind is EventKind.RAISED:
                self._courses[event.source] = _AlarmTimes(raised_at_s=event.at_s)
            elif event.kind is EventKind.CLEARED:
                self._courses[event.source] = replace(course, cleared_at_s=event.at_s)

    def act(self, _args: NoArgs, answer: Answer) -> None:
        """Answer with every alarm, the one that was raised last first, and the newest events."""
        state, decision = self._state, self._decision
        if state is None or decision is None or state.now_s is None:
            answer(Reply(error="no cycle yet"))
            return
        offset_s = self._unix_s() - state.now_s
        courses, events = dict(self._courses), self._events()

        def reply() -> Reply:
            alarms = json.dumps(_alarms(state, decision, courses, offset_s), allow_nan=False)
            return Reply(json=f'{{"alarms":{alarms},"events":{self._events_json(events, offset_s)}}}')

        answer(reply)


def _alarms(state: State, decision: Decision, courses: dict[str, _AlarmTimes], offset_s: float) -> list[dict[str, Any]]:
    alarms = [
        _alarm(rule, step, courses.get(rule.name, _AlarmTimes()), decision, offset_s)
        for rule, step in zip(state.plan.rules, state.rules.steps, strict=True)
        if isinstance(rule, AlarmRule) and isinstance(step, AlarmStep)
    ]
    return sorted(alarms, key=lambda alarm: -(alarm["raised_unix_s"] or 0.0))


def _alarm(
    rule: AlarmRule, step: AlarmStep, course: _AlarmTimes, decision: Decision, offset_s: float
) -> dict[str, Any]:
    def unix_s(at_s: float | None) -> float | None:
        return None if at_s is None or math.isnan(at_s) else round(at_s + offset_s, 3)

    state = step.state
    acknowledged = state.acknowledgement or Acknowledgement(at_s=math.nan)
    over_s = state.leg.began_s if state.leg is not None and state.leg.on == "cleared" else None
    return {
        "rule": rule.name,
        "status": step.trace.status.value,
        "acknowledged": step.trace.acknowledged,
        "gates": step.trace.gates,
        "raised_unix_s": unix_s(course.raised_at_s if state.raised_at_s is None else state.raised_at_s),
        "cleared_unix_s": unix_s(over_s if course.cleared_at_s is None else course.cleared_at_s),
        "acknowledged_by": acknowledged.by,
        "acknowledged_unix_s": unix_s(acknowledged.at_s),
        "why": acknowledged.why,
        "count": state.raises,
        "severity": rule.severity.value,
        "reason": decision.reasons.get(rule.name, ""),
    }
