"""Whether a figure is within the limits of a condition, given how sure it is.

A condition begins when it is likely enough, and ends when, widened by a deadband, it is no longer likely. How likely it
is follows from all that is unsure of the figure. The decision by probability follows JCGM 106:2012, "The role of
measurement uncertainty in conformity assessment" (a guard band chosen by which error one accepts).

The deadband is in standard deviations of the noise, the part that differs from frame to frame: since that of a distance
grows with its square, a fixed deadband tuned at 2 m chatters 15 times a minute at 8 m. An error of the scale, such as
that of a camera that is not calibrated, is the same in every frame. It moves the distance at which an alarm begins, but
never makes one come and go, and a deadband for it would only make alarms last.
"""

from __future__ import annotations

import math

from stadimeter.core.condition import ClosingCondition, DirectionCondition, DistanceCondition, SeparationCondition
from stadimeter.core.conditions.probability import probability_below, probability_between

Uncertain = tuple[float, float, float]
"""A value, its standard deviation, and the part of that which differs from frame to frame."""

LimitsCondition = DistanceCondition | DirectionCondition | ClosingCondition | SeparationCondition
"""The conditions with a lower limit, an upper limit, or both."""

_LENGTHS = (DistanceCondition, SeparationCondition)


def limits_of(condition: LimitsCondition) -> tuple[float, float]:
    """Return the limits within which a condition begins.

    Args:
        condition: The condition.

    Returns:
        The lower and the upper limit in the SI unit; infinite where there is none.
    """
    if isinstance(condition, _LENGTHS):
        low, high = condition.above_m, condition.below_m
    elif isinstance(condition, DirectionCondition):
        low, high = condition.above_rad, condition.below_rad
    else:
        low, high = condition.above_mps, condition.below_mps
    return -math.inf if low is None else low, math.inf if high is None else high


def widened_limits(condition: LimitsCondition, value: float, noise: float) -> tuple[float, float]:
    """Return the limits outside which a condition ends: its own, widened by the deadband.

    Args:
        condition: The condition.
        value: The figure now.
        noise: The standard deviation of its noise. That of a distance is scaled to each limit with the square of the
            distance.

    Returns:
        The lower and the upper limit in the SI unit; infinite where there is none.
    """
    low, high = limits_of(condition)
    if isinstance(condition, DistanceCondition):
        return low - _distance_band_m(condition, low, value, noise), high + _distance_band_m(
            condition, high, value, noise
        )
    band = deadband_of(condition, noise)
    return low - band, high + band


def deadband_of(condition: LimitsCondition, noise_at_limit: float) -> float:
    """Return how far a figure must come back over a limit before a condition ends.

    Args:
        condition: The condition.
        noise_at_limit: The standard deviation of the figure's noise there.

    Returns:
        In the SI unit.
    """
    match condition:
        case DirectionCondition():
            return condition.deadband_rad
        case ClosingCondition():
            return max(condition.deadband_mps, condition.deadband_sigmas * noise_at_limit)
        case _:
            return max(condition.deadband_m, condition.deadband_sigmas * noise_at_limit)


def probabilities_of(condition: LimitsCondition) -> tuple[float | None, float]:
    """Return how likely a condition must be to begin, and may be at most to end.

    Args:
        condition: The condition.

    Returns:
        Both; None for the first if the figures alone are compared.
    """
    if isinstance(condition, DirectionCondition):
        return None, 0.5
    return condition.probability_on, condition.probability_off


def is_within(condition: LimitsCondition, value: float, sigma: float, noise: float, *, is_on: bool) -> bool:
    """Return whether a condition holds for a figure.

    Args:
        condition: The condition.
        value: The figure, finite.
        sigma: Its standard deviation.
        noise: The part of that which differs from frame to frame.
        is_on: Whether it held until now: then it is judged by what ends it, not by what begins it.

    Returns:
        Whether it holds.
    """
    low, high = widened_limits(condition, value, noise) if is_on else limits_of(condition)
    likely_on, likely_off = probabilities_of(condition)
    if likely_on is None:
        return low < value < high
    likely = probability_between(low, high, value, sigma)
    # What is likely enough to begin does not end, whatever else is asked for: it would begin again at once.
    return likely >= likely_on or (is_on and likely > likely_off)


def is_near_or_far(condition: DistanceCondition, value_m: float, sigma_m: float, noise_m: float, is_on: bool) -> bool:
    """Return what `is_within` returns, in half the time; most conditions are on a distance, with one limit."""
    above_m, below_m, likely_on = condition.above_m, condition.below_m, condition.probability_on
    if likely_on is None or (above_m is not None and below_m is not None):
        return is_within(condition, value_m, sigma_m, noise_m, is_on=is_on)
    if below_m is not None:
        limit_m = below_m + _distance_band_m(condition, below_m, value_m, noise_m) if is_on else below_m
        likely = probability_below(limit_m, value_m, sigma_m)
    elif above_m is not None:
        limit_m = above_m - _distance_band_m(condition, above_m, value_m, noise_m) if is_on else above_m
        likely = 1.0 - probability_below(limit_m, value_m, sigma_m)
    else:
        likely = 1.0
    return likely >= likely_on or (is_on and likely > condition.probability_off)


def has_passed(condition: DistanceCondition, before: Uncertain, now: Uncertain) -> bool:
    """Return whether a target went through the limits of a condition between two frames, where none saw it.

    A distance does not jump: a target that was surely on one side, and now surely is on the other, was in between.

    Args:
        condition: The condition. One with a single limit cannot be passed through.
        before: The distance in the frame before, and how sure it was.
        now: The same in this one.

    Returns:
        Whether it did.
    """
    if condition.above_m is None or condition.below_m is None:
        return False
    sides = _sure_side(condition, before), _sure_side(condition, now)
    return 0 not in sides and sides[0] != sides[1]


def _sure_side(condition: DistanceCondition, figures: Uncertain) -> int:
    """Return 1 for surely further than both limits, -1 for surely nearer than both, else 0."""
    low_m, high_m = limits_of(condition)
    sure, (value_m, sigma_m, _) = condition.probability_on, figures
    if sure is None:
        return (value_m >= high_m) - (value_m <= low_m)
    nearer, further = probability_below(low_m, value_m, sigma_m), 1.0 - probability_below(high_m, value_m, sigma_m)
    return (further >= sure) - (nearer >= sure)


def rests_within(condition: LimitsCondition, value: float, is_on: bool) -> bool:
    """Return whether a condition surely stays as it is until the figure crosses one of its limits.

    On one side of a limit a figure is more likely than not to be on that side, whatever the standard deviation. What
    ends a condition lies further out than what begins it. So with the usual probabilities nothing changes before.

    Args:
        condition: The condition.
        value: The figure now.
        is_on: Whether the condition holds, and is judged by what ends it.

    Returns:
        Whether it rests.
    """
    low, high = limits_of(condition)
    likely_on, likely_off = probabilities_of(condition)
    if likely_on is not None and not likely_off <= 0.5 <= likely_on:
        return False
    if not is_on:
        return not low <= value <= high
    is_narrow = math.isfinite(low) and math.isfinite(high)  # a figure in there may still be unlikely to be
    return low < value < high and (likely_on is None or not is_narrow)


def _distance_band_m(condition: DistanceCondition, limit_m: float, value_m: float, noise_m: float) -> float:
    if math.isinf(limit_m):
        return 0.0
    # Far from the limit the scaling law says nothing useful, and the condition is clear anyway.
    ratio = min(max(limit_m / value_m, 0.5), 2.0) if value_m > 0 else 1.0
    return max(condition.deadband_m, condition.deadband_sigmas * noise_m * ratio * ratio)
