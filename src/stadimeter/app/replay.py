"""The same rules over a recording. Nothing is opened, nothing is moved."""

from __future__ import annotations

from dataclasses import dataclass, field

from stadimeter.app.cycle_record import CycleRecord
from stadimeter.app.journal import Journal
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import Decision, Event
from stadimeter.core.plan import Plan

SHOWN_DIFFERENCES = 10


@dataclass(slots=True, kw_only=True)
class Difference:
    """A cycle in which the decision is not the recorded one.

    Attributes:
        cycle: The cycle, counted from 0.
        now_s: Its time on the run's clock.
        what: Which parts of the decision differ.
    """

    cycle: int
    now_s: float
    what: tuple[str, ...]


@dataclass(slots=True, kw_only=True)
class ReplayResult:
    """What came of a replay.

    Attributes:
        cycles: How many cycles there were.
        identical: In how many the decision was the recorded one, to the last bit.
        events: The events of the replay.
        recorded_events: The events of the recording.
        differences: The first cycles that differ.
    """

    cycles: int = 0
    identical: int = 0
    events: list[Event] = field(default_factory=list)
    recorded_events: list[Event] = field(default_factory=list)
    differences: list[Difference] = field(default_factory=list)


def replay(journal: Journal, plan: Plan) -> ReplayResult:
    """Decide again on everything that was observed.

    Args:
        journal: The recording.
        plan: The rules, which need not be those of the recording.

    Returns:
        What came of it.

    Raises:
        JournalError: A line of the recording is damaged.
    """
    state = initial_state(plan)
    result = ReplayResult()
    for record in journal.records():
        state, decision = decide(state, record.observation)
        _compare(result, record, decision)
    return result


def _compare(result: ReplayResult, record: CycleRecord, decision: Decision) -> None:
    result.events += decision.events
    result.recorded_events += record.decision.events
    if decision == record.decision:
        result.identical += 1
    elif len(result.differences) < SHOWN_DIFFERENCES:
        what = tuple(name for name in Decision.__slots__ if getattr(decision, name) != getattr(record.decision, name))
        result.differences.append(Difference(cycle=result.cycles, now_s=record.observation.now_s, what=what))
    result.cycles += 1
