"""The same rules, or others, over a recording. Nothing is opened, nothing is moved."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from stadimeter.app.cycle_record import CycleRecord
from stadimeter.app.persistence.resumption import read_resumption
from stadimeter.app.recordings.cycle_json import CycleEncoder, RecordedCycle
from stadimeter.app.recordings.recorded_configuration import RecordedConfiguration
from stadimeter.core.decide import State, decide, initial_state
from stadimeter.core.decision import Decision, Event
from stadimeter.core.observation import Observation
from stadimeter.core.plan import Plan
from stadimeter.errors import JournalError, StateError
from stadimeter.workbench.replay.opening import Recording

SHOWN_DIFFERENCES = 10
BATCH_CYCLES = 32
LOOKED_INTO = 1000
"""So many decisions that differ are compared field by field; of more than these only the bytes are."""


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
        frames: How many frames were decided on.
        recorded_frames: How many were when it was recorded.
        targets: The targets that were looked for.
    """

    cycles: int = 0
    identical: int = 0
    events: list[Event] = field(default_factory=list)
    recorded_events: list[Event] = field(default_factory=list)
    differences: list[Difference] = field(default_factory=list)
    frames: int = 0
    recorded_frames: int = 0
    targets: set[str] = field(default_factory=set)


Replayed = tuple[RecordedCycle, Observation, Decision]


TakeOver = Callable[[State, RecordedConfiguration], State]
"""Goes on with another configuration, as a run does that is told to reload it."""


def first_state(recording: Recording, plan: Plan) -> State:
    """Return the state with which a replay begins: with what the run took over from an earlier one.

    Args:
        recording: The recording.
        plan: The rules, which need not be those of the recording.

    Returns:
        The state.

    Raises:
        JournalError: What was taken over is damaged.
    """
    state = initial_state(plan)
    if not recording.header.resumed:
        return state
    try:
        return read_resumption(recording.header.resumed).of(state)
    except StateError as error:
        raise JournalError(f"{recording.path}: {error}") from error


def decisions(recording: Recording, plan: Plan, take_over: TakeOver | None = None) -> Iterator[Replayed]:
    """Decide again on everything that was observed.

    Args:
        recording: The recording.
        plan: The rules, which need not be those of the recording.
        take_over: What to do where another configuration was taken over; None to go on with these rules.

    Yields:
        Each cycle, what was observed in it, and what is decided now.

    Raises:
        JournalError: The recording is damaged.
    """
    state = first_state(recording, plan)
    for batch in _batches(recording):
        decided: list[Replayed] = []
        for cycle, observation in batch:
            if cycle.reloaded is not None and take_over is not None:
                state = take_over(state, cycle.reloaded)
            state, decision = decide(state, observation)
            decided.append((cycle, observation, decision))
        yield from decided


def _batches(recording: Recording) -> Iterator[list[tuple[RecordedCycle, Observation]]]:
    """Yield the cycles and what was observed in them, some at a time.

    Reading, deciding and comparing each keep the processor's caches to themselves for a while: a replay takes an eighth
    less time.
    """
    batch: list[tuple[RecordedCycle, Observation]] = []
    try:
        for cycle in recording.cycles():
            batch.append((cycle, cycle.observation()))
            if len(batch) == BATCH_CYCLES:
                yield batch
                batch = []
    except JournalError:
        yield batch  # what comes before the damage is good
        raise
    yield batch


def replay(recording: Recording, plan: Plan) -> ReplayResult:
    """Decide again on everything that was observed, and compare.

    Args:
        recording: The recording.
        plan: The rules, which need not be those of the recording.

    Returns:
        What came of it.

    Raises:
        JournalError: The recording is damaged.
    """
    comparison = Comparison()
    for replayed in decisions(recording, plan):
        comparison.add(*replayed)
    return comparison.result


class Comparison:
    """Compares decisions with recorded ones.

    Most recorded decisions need not be read for that: one that was written by this version is the same if its bytes
    are. Where bytes differ, the decision may still be the same, written by another version, so it is read. Once
    hundreds of cycles differ there are other rules, and where the recording is known to be of this version's writing,
    other bytes are enough.

    Attributes:
        result: What came of the comparison so far.
    """

    def __init__(self) -> None:
        self.result = ReplayResult()
        self._encoder = CycleEncoder(repeats_rules=True)
        self._different = 0
        self._is_ours = True

    def add(self, cycle: RecordedCycle, observation: Observation, decision: Decision) -> None:
        """Add one cycle.

        Args:
            cycle: What was recorded.
            observation: What was observed in it.
            decision: What is decided now.

        Raises:
            JournalError: The recorded cycle is damaged.
        """
        result = self.result
        if observation.frame is not None:
            result.frames += 1
            result.targets.update([measured.target for measured in observation.measurements])
        result.recorded_frames += cycle.has_frame()
        result.events += decision.events
        if self._is_same(cycle, decision):
            result.identical += 1
            result.recorded_events += decision.events
        else:
            self._different += 1
            result.recorded_events += cycle.events()
            if len(result.differences) < SHOWN_DIFFERENCES:
                what = _differing(decision, cycle.record().decision)
                result.differences.append(Difference(cycle=result.cycles, now_s=observation.now_s, what=what))
        result.cycles += 1

    def _is_same(self, cycle: RecordedCycle, decision: Decision) -> bool:
        if cycle.rules_json == self._encoder.rules_json(
            decision.rules
        ) and cycle.decision_json() == self._encoder.decision_json(decision):
            return True
        if self._is_ours and self._different > LOOKED_INTO:
            return False
        recorded = cycle.record().decision
        self._is_ours = self._is_ours and cycle.decision_json() == CycleEncoder(repeats_rules=True).decision_json(
            recorded
        )
        return decision == recorded


def replayed_record(cycle: Replayed) -> CycleRecord:
    """Return a cycle of a replay for a journal: nothing was applied, and nothing is timed.

    Args:
        cycle: The cycle.

    Returns:
        The record, the same each time.
    """
    _, observation, decision = cycle
    return CycleRecord(observation=observation, decision=decision, applied=(), timings_s={})


def _differing(decision: Decision, recorded: Decision) -> tuple[str, ...]:
    return tuple(
        name for name in Decision.__slots__ if name != "reasons" and getattr(decision, name) != getattr(recorded, name)
    )
