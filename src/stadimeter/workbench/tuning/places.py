"""Where a target stood in recordings, seen from the threshold of an alarm, and when that was no true alarm."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stadimeter.errors import JournalError
from stadimeter.workbench.tuning.candidates import Tuned
from stadimeter.workbench.tuning.noise import Floats, Noise, Sights

Truths = NDArray[np.bool_]

EVENT_S = 5.0
"""A raise this close to a marked time is right."""
PLACES = 20

_CLEARLY_SIGMAS = 1.0
_TRUTH_S = 1.0
_PLACE_S = 5.0
"""Where a target stands is the median of this time: shorter, and noise that lasts would count as a place."""
_AROUND_S = 1.5
"""A target that crosses the threshold is clearly beyond it only a moment later."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Places:
    """Where a target stood while no alarm was right.

    Attributes:
        clearances: How far it was from the threshold in each twentieth of that time, in standard deviations of the
            noise there; 0 at the threshold.
        median_m: Where it mostly was.
    """

    quiet_s: float
    clearances: Floats
    median_m: float


def clearance_of(tuned: Tuned, noise: Noise, at_m: float) -> float:
    """Return how far from the threshold a place is, in standard deviations of the noise there; negative beyond it."""
    return tuned.side * (at_m - tuned.limit_m) / noise.true_m(at_m)


def place_of(tuned: Tuned, noise: Noise, clearance: float) -> float | None:
    """Return the place so far from the threshold, in metres; None if noise grows so fast that there is none."""
    bend = clearance * noise.ratio * noise.stated_per_m2  # the place d solves side · (d - limit) = bend · d²
    if bend == 0.0:
        return tuned.limit_m
    root = 1 - 4 * tuned.side * bend * tuned.limit_m
    if root < 0.05:
        return None
    return tuned.side * (1 - math.sqrt(root)) / (2 * bend)


def quiet_frames(sights: Sights, tuned: Tuned, noise: Noise, events_s: Sequence[float]) -> Truths:
    """Return for each frame whether the target was there and no alarm was right.

    Args:
        events_s: Capture times at which the alarm is right, besides those when the target was clearly beyond its
            threshold.
    """
    truth_m = truth_of(sights)
    there = np.isfinite(truth_m)
    known_m = np.where(there, truth_m, tuned.limit_m)
    beyond_m = tuned.side * (tuned.limit_m - known_m)
    is_right = there & (beyond_m > _CLEARLY_SIGMAS * noise.ratio * noise.stated_per_m2 * known_m**2)
    marked_s = np.sort(np.array(events_s, dtype=np.float64))
    near = _within(sights.times_s, sights.times_s[is_right], _AROUND_S) | _within(sights.times_s, marked_s, EVENT_S)
    quiet: Truths = there & ~near
    return quiet


def _within(times_s: Floats, marks_s: Floats, reach_s: float) -> Truths:
    """Return for each time whether one of the marks, which are in order, is near."""
    if not len(marks_s):
        return np.zeros(len(times_s), dtype=bool)
    first = np.searchsorted(marks_s, times_s - reach_s)
    near: Truths = first < np.searchsorted(marks_s, times_s + reach_s, side="right")
    return near


def truth_of(sights: Sights, around_s: float = _TRUTH_S) -> Floats:
    """Return about where the target was in each frame, in metres.

    Args:
        around_s: The median of so much time is taken.

    Returns:
        The place in each frame; NaN where it was not seen.
    """
    frame_s = float(np.median(np.diff(sights.times_s))) if len(sights.times_s) > 1 else 1.0
    half = max(1, round(around_s / frame_s / 2)) if frame_s > 0 else 1
    padded = np.pad(sights.figures_m, half, constant_values=np.nan)
    windows = np.sort(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)  # NaN comes last
    seen = np.isfinite(windows).sum(axis=1)
    middle = np.maximum(seen - 1, 0) // 2
    truth_m: Floats = np.where(seen > 0, windows[np.arange(len(windows)), middle], np.nan)
    return truth_m


def places_of(recordings: Sequence[Sights], quiet: Sequence[Truths], tuned: Tuned, noise: Noise) -> Places:
    """Return where the target stood while no alarm was right.

    Args:
        quiet: For each recording, the frames in which no alarm was right.

    Raises:
        JournalError: There is no such time.
    """
    figures_m = np.concatenate([truth_of(each, _PLACE_S)[calm] for each, calm in zip(recordings, quiet, strict=True)])
    if not len(figures_m):
        side = "nearer than" if tuned.side > 0 else "further than"
        raise JournalError(
            f"in all of the recordings the target is {side} {tuned.limit_m:.2f} m, where '{tuned.rule.name}' is right "
            "to be raised; record it where it mostly stands, on the other side"
        )
    at_m = np.quantile(figures_m, (np.arange(PLACES) + 0.5) / PLACES)
    clearances = np.array([clearance_of(tuned, noise, float(each)) for each in at_m])
    return Places(
        quiet_s=len(figures_m) * noise.frame_s,
        clearances=np.maximum(clearances, 0.0),
        median_m=float(np.median(figures_m)),
    )
