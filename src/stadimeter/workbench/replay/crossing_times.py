"""Times at which a target truly crossed a distance, as well as a recording can tell afterwards.

A rule judges by what was known at the time; a recording also knows what came after. The measured distances are smoothed
with as much of the future as of the past, which brings no delay, so what a rule was late by can be read off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.condition import DistanceCondition

HALF_WINDOW_S = 0.25
"""A distance is the mean of those measured within this before and after."""

GAP_S = 1.0
"""Where nothing was measured for longer than this, nothing is known of the time between."""

BRIEF_S = 0.5
"""What is shorter than this is no crossing, but noise: inside as well as outside."""

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Stay:
    """A time through which a target was where a condition holds.

    Attributes:
        is_entered: Whether the recording shows how it began; not where it was there from the first.
    """

    from_s: float
    to_s: float
    is_entered: bool


def stays(at_s: Sequence[float], distances_m: Sequence[float], condition: DistanceCondition) -> list[Stay]:
    """Return, in order, when a target was where a condition holds, regardless of hysteresis, delays and probability.

    Args:
        at_s: The times of the measurements, in order.
        distances_m: The distances, or depths; a NaN counts as not measured.
    """
    times, measured = np.asarray(at_s, float), np.asarray(distances_m, float)
    known = np.isfinite(measured)
    times, measured = times[known], measured[known]
    found: list[Stay] = []
    for part in np.split(np.arange(len(times)), np.flatnonzero(np.diff(times) > GAP_S) + 1):
        if len(part) > 1:
            found += _merged(_stays(times[part], _smoothed(times[part], measured[part]), condition))
    return [stay for stay in found if stay.to_s - stay.from_s >= BRIEF_S]


def _smoothed(at_s: Values, distances_m: Values) -> Values:
    """Return the mean around each moment; the window is as long before as after, so it shrinks at the ends."""
    half_s = np.minimum(HALF_WINDOW_S, np.minimum(at_s - at_s[0], at_s[-1] - at_s))
    begin = np.searchsorted(at_s, at_s - half_s - 1e-9, "left")
    end = np.searchsorted(at_s, at_s + half_s + 1e-9, "right")
    total = np.concatenate([[0.0], np.cumsum(distances_m)])
    mean: Values = (total[end] - total[begin]) / (end - begin)
    return mean


def _margins_m(distances_m: Values, condition: DistanceCondition) -> Values:
    """Return by how much the condition holds at each moment; below 0 it does not."""
    below_m = np.inf if condition.below_m is None else condition.below_m
    above_m = -np.inf if condition.above_m is None else condition.above_m
    margins: Values = np.minimum(below_m - distances_m, distances_m - above_m)
    return margins


def _stays(at_s: Values, distances_m: Values, condition: DistanceCondition) -> list[Stay]:
    margins_m = _margins_m(distances_m, condition)
    inside = margins_m > 0
    changes = np.flatnonzero(inside[1:] != inside[:-1])
    shares = margins_m[changes] / (margins_m[changes] - margins_m[changes + 1])
    crossed_s = at_s[changes] + shares * (at_s[changes + 1] - at_s[changes])
    bounds_s = [float(at_s[0])] * bool(inside[0]) + [float(time_s) for time_s in crossed_s]
    bounds_s += [float(at_s[-1])] * bool(inside[-1])
    return [
        Stay(from_s, to_s, is_entered=number > 0 or not inside[0])
        for number, (from_s, to_s) in enumerate(zip(bounds_s[::2], bounds_s[1::2], strict=True))
    ]


def _merged(found: Sequence[Stay]) -> list[Stay]:
    """Join stays with hardly any time between them."""
    joined: list[Stay] = []
    for stay in found:
        if joined and stay.from_s - joined[-1].to_s < BRIEF_S:
            joined[-1] = Stay(joined[-1].from_s, stay.to_s, joined[-1].is_entered)
        else:
            joined.append(stay)
    return joined
