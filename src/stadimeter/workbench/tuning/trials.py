"""Tries alarms on what a target might do, with the noise of recordings, through the filter and the rules of a run.

The noise is that of calm stretches, put one after the other in random order. Within a stretch everything is as it was:
how long noise lasts, gross errors, frames without the target, and frames that came late.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import Decision, EventKind
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule
from stadimeter.workbench.tuning.noise import Floats, Noise, Sights

APPROACH_S, AFTER_S = 3.0, 2.0
NEAREST_SHARE = 0.3
"""A target comes no nearer than this share of the threshold; one that goes away has stood there."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn:
    """An alarm was raised, or cleared."""

    at_s: float
    is_raise: bool


Turns = Mapping[str, Sequence[Turn]]
"""What happened to each alarm, by its name."""


class Trials:
    """Tries alarms."""

    def __init__(self, plan: Plan, noise: Noise, random: np.random.Generator) -> None:
        self._plan = plan
        self._noise = noise
        self._random = random

    def standing(self, rules: Sequence[AlarmRule], distance_m: float, frames: int) -> tuple[Turns, float]:
        """Let the target stand.

        Returns:
            What happened, and how many seconds that were.
        """
        times_s, errors = self._frames(frames)
        seen = self._sights(times_s, np.full(frames, distance_m), errors)
        return judged(self._plan, rules, seen), float(times_s[-1] - times_s[0])

    def crossing(self, rules: Sequence[AlarmRule], limit_m: float, speed_mps: float, after_s: float) -> Turns:
        """Let the target come, or go, over a limit.

        Args:
            speed_mps: How fast the distance shrinks; negative if it grows.
            after_s: For how long to go on.

        Returns:
            What happened. At the time 0 the true distance is the limit.
        """
        nearest_m = NEAREST_SHARE * limit_m
        frames = math.ceil((APPROACH_S + after_s) / self._noise.frame_s)
        times_s, errors = self._frames(frames)
        crossed_s = times_s[0] + APPROACH_S + self._random.random() * self._noise.frame_s
        true_m = np.maximum(limit_m - speed_mps * (times_s - crossed_s), nearest_m)
        turns = judged(self._plan, rules, self._sights(times_s, true_m, errors))
        return {name: [replace(turn, at_s=turn.at_s - crossed_s) for turn in each] for name, each in turns.items()}

    def _frames(self, count: int) -> tuple[Floats, Floats]:
        """Return the times and the errors of so many frames."""
        calm, steps_s, errors, had = self._noise.calm, [], [], 0
        while had < count:
            stretch = calm[self._random.integers(len(calm))]
            first = int(self._random.integers(len(stretch.errors))) if not had else 0
            steps_s.append(stretch.steps_s[first:])
            errors.append(stretch.errors[first:])
            had += len(errors[-1])
        return np.cumsum(np.concatenate(steps_s)[:count]), np.concatenate(errors)[:count]

    def _sights(self, times_s: Floats, true_m: Floats, errors: Floats) -> Sights:
        noise = self._noise
        stated_m = np.maximum(noise.stated_per_m2 * true_m**2, noise.stated_m(0.0))
        figures_m = np.maximum(true_m + errors * stated_m, 0.2 * true_m)
        seen_m = np.where(np.isfinite(figures_m), figures_m, 1.0)
        return Sights(
            times_s=times_s,
            figures_m=figures_m,
            noises_m=np.maximum(noise.stated_per_m2 * seen_m**2, noise.stated_m(0.0)),
            scale=noise.scale,
        )


def judged(plan: Plan, rules: Sequence[AlarmRule], sights: Sights) -> Turns:
    """Judge what was measured with several alarms at once.

    Args:
        rules: The alarms, all on one target.
    """
    target = rules[0].target
    tried = Plan(targets=(target,), rules=tuple(rules), tracking=plan.tracking, safety=plan.safety)
    turns: dict[str, list[Turn]] = {rule.name: [] for rule in rules}
    for decision in _decisions(tried, target, sights):
        for event in decision.events:
            if event.source in turns and event.kind in {EventKind.RAISED, EventKind.CLEARED}:
                turns[event.source].append(Turn(at_s=event.at_s, is_raise=event.kind is EventKind.RAISED))
    return turns


def _decisions(plan: Plan, target: str, sights: Sights) -> Iterator[Decision]:
    state = initial_state(plan)
    rows = zip(sights.times_s.tolist(), sights.figures_m.tolist(), sights.noises_m.tolist(), strict=True)
    for number, (at_s, figure_m, noise_m) in enumerate(rows):
        seen = _measurement(target, at_s, figure_m, noise_m, sights.scale)
        frame = FrameStamp(sequence=number, captured_at_s=at_s)
        state, decision = decide(state, Observation(now_s=at_s, frame=frame, measurements=(seen,)))
        yield decision


def _measurement(target: str, at_s: float, figure_m: float, noise_m: float, scale: float) -> Measurement:
    if math.isnan(figure_m):
        return Measurement(target=target, status=MeasurementStatus.NOT_FOUND, captured_at_s=at_s, reason="not measured")
    return Measurement(
        target=target,
        status=MeasurementStatus.MEASURED,
        captured_at_s=at_s,
        distance_m=figure_m,
        depth_m=figure_m,
        sigma_m=math.hypot(noise_m, scale * figure_m),
        noise_m=noise_m,
        bearing_rad=0.0,
        elevation_rad=0.0,
    )


def late_s(turns: Sequence[Turn]) -> float:
    """Return how long after the time 0 an alarm stood.

    Returns:
        0 if it was raised before and still stood, infinite if it was never raised.
    """
    is_active = False
    for turn in turns:
        if turn.at_s >= 0 and (is_active or turn.is_raise):
            return 0.0 if is_active else turn.at_s
        is_active = turn.is_raise
    return 0.0 if is_active else math.inf


def ended_s(turns: Sequence[Turn]) -> float:
    """Return how long after the time 0 an alarm was over for good.

    Returns:
        0 if it was over before, infinite if it still stood at the end.
    """
    if not turns or turns[-1].is_raise:
        return math.inf if turns else 0.0
    return max(0.0, turns[-1].at_s)


def raises_apart(turns: Sequence[Turn], apart_s: float) -> int:
    """Return how often an alarm was raised, where those that follow on each other at once count once.

    Args:
        apart_s: Within this time of the one before, it is the same.
    """
    count, last_s = 0, -math.inf
    for turn in turns:
        if turn.is_raise:
            count += turn.at_s - last_s > apart_s
            last_s = turn.at_s
    return count
