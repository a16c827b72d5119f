"""Rates of rare events: counts, their confidence, and extrapolation to where nothing was counted.

False alarms get rarer the further away from its threshold the target stands. They are counted at several clearances
where they are frequent enough, and where they get rare a straight line is laid through the logarithms: its slope is
that of all settings together, its height that of each. A normal distribution falls off faster than a line, so the line
errs on the safe side. Outliers do not fall off at all; the distance at which the target stood is therefore tried too,
and the larger of the two rates holds.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from stadimeter.workbench.tuning.noise import Floats

DAY_S = 86400.0
SURE = 0.95
DRAWS = 400
"""Bootstrap draws of the counts, for the confidence of the line."""

_SIGMAS_OF_SURE = 1.645
_HALF = 0.5
"""Where nothing was counted, half a count stands for it: the logarithm of zero is not a number."""
OFTEN_SHARE = 0.5
"""An alarm gets rare where it is raised less than this share as often as anywhere."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Count:
    """The raises of an alarm while the target stood at one clearance.

    Attributes:
        clearance: Distance from the threshold, in standard deviations of the noise.
    """

    clearance: float
    raises: int
    duration_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Slope:
    """The fall of the logarithm of a rate, for each standard deviation further away.

    Attributes:
        per_sigma: The change of the logarithm, zero or less.
    """

    per_sigma: float
    sigma: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Rate:
    """False alarms a day.

    Attributes:
        at_most_a_day: It is at most this, with 95 % confidence, as far as the counts go.
    """

    a_day: float
    at_most_a_day: float


def at_most(count: int) -> float:
    """Return the 95 % upper limit of a Poisson variable's mean, where `count` events were counted.

    For none it is 3.0, the "rule of three". The formula is that of Wilson and Hilferty, "The distribution of
    chi-square", PNAS 17 (12), 1931.
    """
    more = count + 1
    return float(more * (1 - 1 / (9 * more) + _SIGMAS_OF_SURE / (3 * math.sqrt(more))) ** 3)


def slope_of(all_counts: Iterable[Sequence[Count]]) -> Slope:
    """Return the slope that all settings have together."""
    tails = [_tail(counts) for counts in all_counts]
    rise = spread = 0.0
    for at, raises, duration_s in tails:
        logs = np.log(raises / duration_s)
        off = at - np.average(at, weights=raises)
        rise += float(np.sum(raises * off * logs))
        spread += float(np.sum(raises * off * off))
    # All settings were tried on the same noise: together they tell no more than one of them.
    return Slope(per_sigma=min(rise / spread, 0.0), sigma=math.sqrt(len(tails) / spread))


def rate_at(
    counts: Sequence[Count], slope: Slope, clearances: Floats, far: Count | None, random: np.random.Generator
) -> Rate:
    """Return how often a day an alarm is raised by a target that spends the same time at each clearance.

    Args:
        counts: By growing clearance.
        clearances: Distances from the threshold, in standard deviations of the noise.
        far: The count at the median clearance, if that is further away than all else; else None.
    """
    at, raises, duration_s = _tail(counts)
    nearer = np.array(
        [count.raises / count.duration_s for count in counts if count.clearance < at[0]], dtype=np.float64
    )
    most_often = max(float(nearer.max(initial=0.0)), raises[0] / duration_s[0])
    likeliest = _a_day((at, raises, duration_s), slope.per_sigma, clearances, most_often)
    slopes = np.minimum(random.normal(slope.per_sigma, slope.sigma, DRAWS), 0.0)
    # A parametric bootstrap: counts and slope are drawn anew; the 95th percentile of the drawn rates is the limit.
    again = np.maximum(random.poisson(raises, (DRAWS, len(raises))), _HALF)
    drawn = [
        _a_day((at, each, duration_s), float(by), clearances, most_often)
        for each, by in zip(again, slopes, strict=True)
    ]
    most = float(np.quantile(drawn, SURE))
    if far is not None and far.raises:
        likeliest = max(likeliest, far.raises / far.duration_s * DAY_S)
        most = max(most, at_most(far.raises) / far.duration_s * DAY_S)
    return Rate(a_day=likeliest, at_most_a_day=max(likeliest, most))


def _tail(counts: Sequence[Count]) -> tuple[Floats, Floats, Floats]:
    """Return clearances, raises and durations, from where it gets rare to where it is never raised.

    Nearer than that it is raised about as often wherever the target stands, or more seldom because it hardly ever ends.
    """
    raises = [count.raises for count in counts]
    often = max(index for index, each in enumerate(raises) if each >= OFTEN_SHARE * max(raises))
    first = min(often, len(raises) - 2)
    empty = next((index for index in range(first, len(raises)) if not raises[index]), len(raises) - 1)
    used = counts[first : max(empty + 1, first + 2)]
    return (
        np.array([count.clearance for count in used]),
        np.array([max(count.raises, _HALF) for count in used]),
        np.array([count.duration_s for count in used]),
    )


def _a_day(tail: tuple[Floats, Floats, Floats], per_sigma: float, clearances: Floats, most_often: float) -> float:
    """Return the rate, by the line, and nowhere more than where it is raised most often."""
    at, raises, duration_s = tail
    # The likeliest height of a Poisson rate exp(height + slope · clearance), given the slope: counts over exposure.
    height = math.log(raises.sum() / np.sum(duration_s * np.exp(per_sigma * at)))
    rates = np.minimum(np.exp(height + per_sigma * clearances), most_often)
    return float(DAY_S * np.mean(rates))
