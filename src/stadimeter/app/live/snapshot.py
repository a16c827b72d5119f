"""All that there is to see of a run at one moment: what the terminal's live view draws, and the page."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from msgspec import Struct, field

from stadimeter.app.clock import SteppedClock
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.live.health import CONNECTED, Board, LiveHealth, live_health
from stadimeter.app.live.history import WINDOW_S, DistanceSample, RunHistory, Seen
from stadimeter.core.clock import Clock
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decision import Decision, Event
from stadimeter.core.detection import RejectedCandidate
from stadimeter.core.measurement import MeasurementStatus
from stadimeter.core.message import Message
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule, AnyRule, FollowRule, RampRule
from stadimeter.core.rules.explaining import Reasons, explain


class Surroundings(Struct, frozen=True, kw_only=True):
    """The things a run has beside its cycles, for those who watch it. Each may be asked from any thread, at any time.

    Attributes:
        plan: Its rules, outputs and targets, as they are after the newest reload; None if there is no plan.
        trouble: What is wrong outside the loop, such as with the broker; empty if nothing is.
        messenger: Where messages to other programs go, and how that is; None if there is no messenger.
        messages: What was sent to other programs and when, newest first.
        narration: What happens in a simulated world; empty if there is nothing to say.
        run: What the run is: its configuration and so on.
        recording: The recording under way; None if there is none.
        has_corners: By target, whether its outline is corners in order, or else points on a rim.
    """

    plan: Callable[[], Plan | None] = lambda: None
    trouble: Callable[[], str] = str
    messenger: Callable[[], Mapping[str, Any] | None] = lambda: None
    messages: Callable[[], Sequence[tuple[float, Message]]] = tuple
    narration: Callable[[], str] = str
    run: Callable[[], Mapping[str, object]] = dict
    recording: Callable[[], Mapping[str, object] | None] = lambda: None
    has_corners: Mapping[str, bool] = field(default_factory=dict)


class RunSnapshot(Struct, frozen=True, kw_only=True):
    """All that there is to see of a run at one moment.

    Attributes:
        record: The newest cycle; None before the first.
        seen: The newest frame, and what was found in exactly this frame; None before the first.
        started_s: The time of the first cycle, on the run's monotonic clock.
        samples: The recent distances of each target, oldest first.
        events: Newest first.
        messenger: See `Surroundings`.
        messages: The messages to other programs, each with its time, newest first.
        health: How the run is doing.
    """

    record: CycleRecord | None = None
    seen: Seen | None = None
    started_s: float = 0.0
    samples: Mapping[str, Sequence[DistanceSample]] = field(default_factory=dict)
    events: Sequence[Event] = ()
    messenger: Mapping[str, Any] | None = None
    messages: Sequence[tuple[float, Message]] = ()
    health: LiveHealth = field(default_factory=LiveHealth)
    narration: str = ""
    plan: Plan | None = None
    has_corners: Mapping[str, bool] = field(default_factory=dict)
    run: Mapping[str, object] = field(default_factory=dict)
    recording: Mapping[str, object] | None = None

    @property
    def looked_at(self) -> Mapping[str, Sequence[RejectedCandidate]]:
        """The rejected candidates of each target that the newest frame does not show, the most like it first."""
        return looked_at(self.seen.record) if self.seen is not None else {}

    @property
    def limits_m(self) -> Mapping[str, Sequence[float]]:
        """The distances at which rules begin, by target, nearest first, to mark them in a chart."""
        rules = self.plan.rules if self.plan is not None else ()
        reasons = self.record.decision.reasons if self.record is not None else None
        if isinstance(reasons, Reasons) and reasons.plan is self.plan:
            rules = reasons.judged.rules  # with thresholds that operators have set
        found: dict[str, set[float]] = defaultdict(set)
        for rule in rules:
            found[rule.target].update(_limits_m(rule))
        return {target: sorted(values) for target, values in found.items()}

    @property
    def tilts_rad(self) -> Mapping[str, float]:
        """Tilt of each flat target that was measured in the newest frame."""
        seen = self.seen.record.observation.measurements if self.seen is not None else ()
        return {each.target: each.tilt_rad for each in seen if each.tilt_rad is not None}


def why(decision: Decision, rule: str) -> str:
    """Return why a rule does what it does, in short; the reason alone if read from a file."""
    if isinstance(decision.reasons, Reasons):
        return explain(decision, rule, with_probability=False).sentence
    return decision.reasons.get(rule, "")


def looked_at(record: CycleRecord) -> Mapping[str, Sequence[RejectedCandidate]]:
    """Return the rejected candidates in a frame, for each target that was not measured in it."""
    return {
        measured.target: record.rejected.get(measured.target, ())
        for measured in record.observation.measurements
        if measured.status is not MeasurementStatus.MEASURED
    }


def _limits_m(rule: AnyRule) -> tuple[float, ...]:
    match rule:
        case AlarmRule(condition=DistanceCondition(above_m=above_m, below_m=below_m)):
            return tuple(limit_m for limit_m in (above_m, below_m) if limit_m is not None)
        case RampRule(quantity="distance" | "depth"):
            return (rule.start,)
        case FollowRule():
            return (rule.distance_m,)
        case _:
            return ()


class LiveFeed(Struct):
    """The view of a run for those who watch it, from any thread.

    Attributes:
        clock: The run's clock.
        unix_time_s: The computer's clock.
    """

    clock: Clock
    history: RunHistory = field(default_factory=RunHistory)
    surroundings: Surroundings = field(default_factory=Surroundings)
    board: Board = field(default_factory=Board)
    unix_time_s: Callable[[], float] = time.time

    def pace(self) -> float:
        """Return the pace of a simulation or a recording of late, as a share of the speed that was asked for.

        1 for a live camera, and where it shall pass as fast as the computer can.
        """
        asked = self.clock.speed if isinstance(self.clock, SteppedClock) else None
        speed = self.history.speed
        return speed / asked if asked and speed is not None else 1.0

    def snapshot(self, window_s: float = WINDOW_S) -> RunSnapshot:
        """Return all there is to see now, with the distances of this long."""
        history, around = self.history, self.surroundings
        record, link = history.record, around.messenger()
        broker = link["trouble"] or CONNECTED if link is not None else ""
        return RunSnapshot(
            record=record,
            seen=history.seen,
            started_s=history.started_s,
            samples=history.samples_after(record.observation.now_s - window_s if record is not None else 0.0),
            events=tuple(history.events),
            messenger=link,
            messages=tuple(around.messages()),
            health=live_health(history, self.board, broker, around.trouble(), self.pace()),
            narration=around.narration(),
            plan=around.plan(),
            has_corners=around.has_corners,
            run=around.run(),
            recording=around.recording(),
        )

    def cycle_age_s(self) -> float:
        """Return the age of the newest cycle in real time: a loop that hangs, also on a stepped clock, grows old."""
        history = self.history
        return history.real_time_s() - history.cycle_at_s if history.cycle_at_s is not None else 0.0

    def unix_offset_s(self) -> float:
        """Return the time by which the computer's clock is ahead of the run's."""
        return self.unix_time_s() - self.clock.now_s()
