"""At which figures a condition would begin, and at which it would end, if all else stayed as it is.

Found by bisection over what `thresholds` and `contact` say, so that there is one place that decides. The noise of a
distance is taken to grow with its square on the way there, and the rest of what is unsure, an error of the scale, in
proportion to it; the standard deviations of other figures are taken to stay as they are.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from stadimeter.core.condition import DistanceCondition, TimeToContactCondition
from stadimeter.core.conditions.contact import Approach, contact_holds
from stadimeter.core.conditions.thresholds import LimitsCondition, Uncertain, is_within, limits_of, widened_limits

_Holds = Callable[[float], bool]

FAR_SIGMAS = 12.0
"""Nothing is in doubt this many standard deviations from a limit."""

_STEPS = 48


def limit_points(condition: LimitsCondition, figures: Uncertain, *, is_on: bool) -> tuple[float, ...]:
    """Return the figures at which a condition with limits begins, or ends.

    Args:
        condition: The condition.
        figures: The figure now, its standard deviation and that of its noise.
        is_on: Whether to return where it ends, in place of where it begins.

    Returns:
        None, one or two, the smaller first. None if it can never do so: the figure is too unsure everywhere.
    """
    value, sigma, noise = figures
    is_scaled = isinstance(condition, DistanceCondition) and value > 0
    unsure_at = _scaled(figures) if is_scaled else lambda _: (sigma, noise)

    def holds(figure: float) -> bool:
        return is_within(condition, figure, *unsure_at(figure), is_on=is_on)

    low, high = limits_of(condition)
    wide = widened_limits(condition, value, noise)
    points: list[float] = []
    if math.isfinite(low):
        inside = (low + high) / 2 if math.isfinite(high) else 2 * low if is_scaled else low + FAR_SIGMAS * sigma + 1
        points += _turn(holds, inside, 0.0 if is_scaled else min(low, wide[0]) - FAR_SIGMAS * sigma - 1)
    if math.isfinite(high):
        inside = (low + high) / 2 if math.isfinite(low) else 0.0 if is_scaled else high - FAR_SIGMAS * sigma - 1
        points += _turn(holds, inside, 2 * high if is_scaled else max(high, wide[1]) + FAR_SIGMAS * sigma + 1)
    return tuple(points)


def contact_points(condition: TimeToContactCondition, approach: Approach, *, is_on: bool) -> tuple[float, ...]:
    """Return the time to contact at which a condition begins, or ends, at the speed that the target has.

    Args:
        condition: The condition.
        approach: The target.
        is_on: Whether to return where it ends, in place of where it begins.

    Returns:
        That time in seconds; nothing while the speed is not known well enough.
    """
    if approach.closing_mps <= 0:
        return ()

    def holds(time_s: float) -> bool:
        there = approach._replace(distance_m=condition.contact_m + time_s * approach.closing_mps)
        return contact_holds(condition, there, is_on=is_on) is True

    sigma_s = approach.time_sigma_s(condition.below_s + condition.deadband_s)
    margin_s = condition.deadband_s + (FAR_SIGMAS + condition.deadband_sigmas) * sigma_s + 1
    return tuple(_turn(holds, condition.below_s - margin_s, condition.below_s + margin_s))


def _scaled(figures: Uncertain) -> Callable[[float], tuple[float, float]]:
    """Return how sure a distance would be elsewhere: the standard deviation, and that of the noise."""
    value_m, sigma_m, noise_m = figures
    noise_per_m = noise_m / (value_m * value_m)
    scale_sigma = math.sqrt(max(0.0, sigma_m * sigma_m - noise_m * noise_m)) / value_m

    def unsure_at(distance_m: float) -> tuple[float, float]:
        there_m = noise_per_m * distance_m * distance_m
        return math.hypot(there_m, scale_sigma * distance_m), there_m

    return unsure_at


def _turn(holds: _Holds, inside: float, outside: float) -> list[float]:
    """Return where a condition that holds inside ceases to."""
    if not holds(inside) or holds(outside):
        return []
    for _ in range(_STEPS):
        middle = (inside + outside) / 2
        if holds(middle):
            inside = middle
        else:
            outside = middle
    return [(inside + outside) / 2]
