"""Whether a condition holds, given how sure the distance is.

A condition begins when it is likely enough, and ends when, widened by a deadband, it is no longer likely. The deadband
is in standard deviations of the distance: since these grow with the square of the distance, a fixed deadband tuned at
2 m chatters 15 times a minute at 8 m. The decision by probability follows JCGM 106:2012, "The role of measurement
uncertainty in conformity assessment" (a guard band chosen by which error one accepts).
"""

from __future__ import annotations

import math

from stadimeter.core.plan import Condition, DistanceCondition, PresenceCondition, Quantity
from stadimeter.core.rules.words import metres
from stadimeter.core.track import Track


def holds(condition: Condition, track: Track, *, is_active: bool) -> bool | None:
    """Return whether a condition holds.

    Args:
        condition: The condition.
        track: The target.
        is_active: Whether it held until now: then it is judged by what ends it, not by what begins it.

    Returns:
        True or False; None if it cannot be known. None is never taken for either.
    """
    if isinstance(condition, PresenceCondition):
        return track.is_valid == condition.seen
    figures = quantity_of(track, condition.quantity)
    if figures is None:
        return None
    low_m, high_m = _limits_now(condition, *figures, is_active=is_active)
    if condition.probability_on is None:
        return low_m < figures[0] < high_m
    likely = probability_between(low_m, high_m, *figures)
    return likely > condition.probability_off if is_active else likely >= condition.probability_on


def in_words(condition: Condition, track: Track, *, is_active: bool) -> str:
    """Return the figures behind what `holds` returns for the same arguments.

    Args:
        condition: The condition.
        track: The target.
        is_active: Whether it is judged by what ends it.

    Returns:
        The words.
    """
    if isinstance(condition, PresenceCondition):
        return f"{track.target} is {track.status.value}" + (f": {track.reason}" if track.reason else "")
    figures = quantity_of(track, condition.quantity)
    if figures is None:
        return no_figures(track)
    low_m, high_m = _limits_now(condition, *figures, is_active=is_active)
    words = f"{metres(*figures)}, {_limits_in_words(low_m, high_m)}"
    if condition.probability_on is None:
        return words
    likely = probability_between(low_m, high_m, *figures)
    turns = f"ends at {condition.probability_off:.2f}" if is_active else f"begins at {condition.probability_on:.2f}"
    return f"{words}: P {likely:.2f}, {turns}"


def rests(condition: DistanceCondition, value_m: float, *, is_active: bool) -> bool:
    """Return whether a condition surely stays as it is until the distance crosses one of its limits.

    On one side of a limit a target is more likely than not to be on that side, whatever the standard deviation. What
    ends a condition lies further out than what begins it. So with the usual probabilities nothing changes before.

    Args:
        condition: The condition.
        value_m: The distance now.
        is_active: Whether the condition holds, and is judged by what ends it.

    Returns:
        Whether it rests.
    """
    low_m, high_m = _limits(condition)
    likely_on = condition.probability_on
    if likely_on is not None and not condition.probability_off <= 0.5 <= likely_on:
        return False
    if not is_active:
        return not low_m <= value_m <= high_m
    is_narrow = math.isfinite(low_m) and math.isfinite(high_m)  # a target in there may still be unlikely to be
    return low_m < value_m < high_m and (likely_on is None or not is_narrow)


def quantity_of(track: Track, quantity: Quantity) -> tuple[float, float] | None:
    """Return the figure that a rule is about, and its standard deviation.

    Args:
        track: The target.
        quantity: Distance or depth.

    Returns:
        Both in metres, or None while there is no finite figure to act on.
    """
    figure_m = track.distance_m if quantity == "distance" else track.depth_m
    if not track.is_valid or figure_m is None or track.sigma_m is None:
        return None
    if not (math.isfinite(figure_m) and math.isfinite(track.sigma_m)):
        return None
    return figure_m, track.sigma_m


def no_figures(track: Track) -> str:
    """Return in words that there is no distance to act on.

    Args:
        track: The target.

    Returns:
        The words.
    """
    return f"{track.target} is {track.status.value}: {track.reason or 'no distance'}"


def _limits_now(
    condition: DistanceCondition, value_m: float, sigma_m: float, *, is_active: bool
) -> tuple[float, float]:
    return widened_limits(condition, value_m, sigma_m) if is_active else _limits(condition)


def _limits(condition: DistanceCondition) -> tuple[float, float]:
    low_m = -math.inf if condition.above_m is None else condition.above_m
    high_m = math.inf if condition.below_m is None else condition.below_m
    return low_m, high_m


def widened_limits(condition: DistanceCondition, value_m: float, sigma_m: float) -> tuple[float, float]:
    """Return the limits that end a condition: its own, widened by the deadband.

    Args:
        condition: The condition.
        value_m: The distance now.
        sigma_m: Its standard deviation, which is scaled to each limit with the square of the distance.

    Returns:
        The lower and the upper limit in metres; infinite where there is none.
    """
    low_m, high_m = _limits(condition)
    return low_m - _deadband_m(condition, low_m, value_m, sigma_m), high_m + _deadband_m(
        condition, high_m, value_m, sigma_m
    )


def _deadband_m(condition: DistanceCondition, limit_m: float, value_m: float, sigma_m: float) -> float:
    if math.isinf(limit_m):
        return 0.0
    # Far from the limit the scaling law says nothing useful, and the condition is clear anyway.
    ratio = min(max(limit_m / value_m, 0.5), 2.0) if value_m > 0 else 1.0
    sigma_at_limit_m = sigma_m * ratio * ratio
    return max(condition.deadband_m, condition.deadband_sigmas * sigma_at_limit_m)


def probability_between(low_m: float, high_m: float, value_m: float, sigma_m: float) -> float:
    """Return how likely the true distance is between two limits, for a normal distribution.

    Args:
        low_m: The lower limit, or minus infinity.
        high_m: The upper limit, or infinity.
        value_m: The distance.
        sigma_m: Its standard deviation, zero or more.

    Returns:
        From 0 to 1.
    """
    return _probability_below(high_m, value_m, sigma_m) - _probability_below(low_m, value_m, sigma_m)


def _probability_below(limit_m: float, value_m: float, sigma_m: float) -> float:
    if math.isinf(limit_m):
        return 1.0 if limit_m > 0 else 0.0
    if sigma_m <= 0:
        return 1.0 if value_m < limit_m else 0.0
    return 0.5 * math.erfc((value_m - limit_m) / (sigma_m * math.sqrt(2)))


def _limits_in_words(low_m: float, high_m: float) -> str:
    if math.isinf(low_m):
        return f"below {high_m:.2f} m"
    if math.isinf(high_m):
        return f"above {low_m:.2f} m"
    return f"between {low_m:.2f} and {high_m:.2f} m"
