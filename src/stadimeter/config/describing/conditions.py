"""Says in plain words when a condition begins and when it ends, with the figures it works out to."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from stadimeter.config.units import FOOT_M
from stadimeter.core.condition import (
    AllOf,
    AnyOf,
    ClosingCondition,
    Condition,
    CountCondition,
    DirectionCondition,
    DistanceCondition,
    Leaf,
    Not,
    PresenceCondition,
    RuleCondition,
    ScheduleCondition,
    SeparationCondition,
    TimeToContactCondition,
    leaves,
)
from stadimeter.core.conditions.words import days, time_of_day
from stadimeter.core.durations import duration

_OF_FIGURES = (
    DistanceCondition, DirectionCondition, ClosingCondition, TimeToContactCondition, SeparationCondition,
)  # fmt: skip
_Said = Callable[[float], str]
_Band = tuple[float | None, float | None, float, float, _Said]
"""The lower and the upper limit, the deadband and its standard deviations, and how such a figure is written."""


def length(metres: float) -> str:
    """Write a length in metres and in feet.

    Args:
        metres: The length.

    Returns:
        Such as ``3.05 m (10.0 ft)``.
    """
    return f"{metres:.2f} m ({metres / FOOT_M:.1f} ft)"


def begins(condition: Condition) -> str:
    r"""Say when a condition begins to hold.

    Args:
        condition: The condition.

    Returns:
        A clause, such as ``\`ball\` is nearer than 0.50 m (1.6 ft) with a probability of 80%``.
    """
    match condition:
        case AllOf():
            return " and ".join(_inner(part) for part in condition.conditions)
        case AnyOf():
            return " or ".join(_inner(part) for part in condition.conditions)
        case Not():
            return f"not ({begins(condition.condition)})"
        case _:
            return _leaf(condition)


def ends(condition: Condition) -> str:
    """Say when a condition has ceased to hold.

    Args:
        condition: The condition.

    Returns:
        A clause, such as ``it is further than 0.50 m (1.6 ft) by 3 standard deviations of the noise``.
    """
    match condition:
        case DistanceCondition():
            return f"it is {_back(_band(condition), 'nearer than ', 'further than ')}"
        case DirectionCondition():
            return f"its {condition.quantity} is {_back(_band(condition), 'below ', 'above ')}"
        case ClosingCondition():
            return f"its closing speed is {_back(_band(condition), 'below ', 'above ')}"
        case SeparationCondition():
            return f"they are {_back(_band(condition), 'nearer to each other than ', 'further apart than ')}"
        case TimeToContactCondition():
            return f"contact is {_back(_band(condition), '', 'later than ')}"
        case _:
            return "that has ended"


def needs_figures(condition: Condition) -> bool:
    """Return whether a condition asks for a figure that is not known while its target is out of sight.

    Args:
        condition: The condition.

    Returns:
        Whether any part of it does.
    """
    return any(isinstance(leaf, _OF_FIGURES) for leaf in leaves(condition))


def _inner(condition: Condition) -> str:
    words = begins(condition)
    return f"({words})" if isinstance(condition, AllOf | AnyOf) else words


def _leaf(condition: Leaf) -> str:
    match condition:
        case DistanceCondition():
            along = " along the optical axis" if condition.quantity == "depth" else ""
            words = f"`{condition.target}` is {_within(_band(condition), 'further than ', 'nearer than ')}{along}"
        case DirectionCondition():
            return f"the {condition.quantity} of `{condition.target}` is {_within(_band(condition))}"
        case ClosingCondition():
            words = f"the closing speed of `{condition.target}` is {_within(_band(condition))}"
        case SeparationCondition():
            first, second = condition.targets
            apart = _within(_band(condition), "further apart than ", "nearer to each other than ")
            words = f"`{first}` and `{second}` are {apart}"
        case TimeToContactCondition():
            words = _contact(condition)
        case _:
            return _circumstance(condition)
    certainty = condition.probability_on
    return words if certainty is None else f"{words} with a probability of {certainty:.0%}"


def _contact(condition: TimeToContactCondition) -> str:
    where = f"{length(condition.contact_m)} away" if condition.contact_m else "here"
    slower = f" (if faster than {condition.closing_min_mps:g} m/s)"
    return f"`{condition.target}` will be {where} within {condition.below_s:g} s{slower}"


def _circumstance(condition: PresenceCondition | CountCondition | RuleCondition | ScheduleCondition) -> str:
    match condition:
        case PresenceCondition():
            since = f" for {duration(condition.for_s)}" if condition.for_s else ""
            return f"`{condition.target}` is {'in' if condition.seen else 'out of'} sight{since}"
        case CountCondition():
            return f"{_number(condition)} {_of(condition.targets)} in sight"
        case RuleCondition():
            return f"`{condition.rule}` is active"
        case _:
            begin, end = time_of_day(condition.from_s), time_of_day(condition.to_s)
            return f"it is between {begin} and {end}{days(condition.weekdays)}"


def _number(condition: CountCondition) -> str:
    least, most = condition.at_least, condition.at_most
    if least is None or most is None:
        return f"at most {most}" if least is None else f"at least {least}"
    return f"{least}" if least == most else f"{least} to {most}"


def _of(targets: Sequence[str]) -> str:
    return f"of {', '.join(f'`{target}`' for target in targets)} are" if targets else "targets are"


def _band(
    condition: DistanceCondition | DirectionCondition | ClosingCondition | SeparationCondition | TimeToContactCondition,
) -> _Band:
    match condition:
        case DistanceCondition() | SeparationCondition():
            ends_m = condition.above_m, condition.below_m
            return *ends_m, condition.deadband_m, condition.deadband_sigmas, length
        case DirectionCondition():
            return condition.above_rad, condition.below_rad, condition.deadband_rad, 0.0, _degrees
        case ClosingCondition():
            ends_mps = condition.above_mps, condition.below_mps
            return *ends_mps, condition.deadband_mps, condition.deadband_sigmas, _speed
        case _:
            return None, condition.below_s, condition.deadband_s, condition.deadband_sigmas, _seconds


def _within(band: _Band, above: str = "above ", below: str = "below ") -> str:
    low, high, _, _, say = band
    if low is not None and high is not None:
        return f"between {say(low)} and {say(high)}"
    return f"{above}{say(low)}" if low is not None else f"{below}{say(high or 0.0)}"


def _back(band: _Band, below: str, above: str) -> str:
    """Say where the condition ends, which the deadband moves away from where it begins."""
    low, high, deadband, sigmas, say = band
    fixed = 0.0 if sigmas else deadband
    there = [f"{below}{say(low - fixed)}"] if low is not None else []
    there += [f"{above}{say(high + fixed)}"] if high is not None else []
    if not sigmas:
        return " or ".join(there)
    noise = f"{sigmas:g} standard deviations of the noise"
    width = f"{deadband:g} {_UNITS[say]} or {noise}, whichever is more," if deadband else noise
    return f"{' or '.join(there)} by {width}"


def _degrees(angle_rad: float) -> str:
    return f"{math.degrees(angle_rad):.1f}°"


def _speed(speed_mps: float) -> str:
    return f"{speed_mps:.2f} m/s"


def _seconds(duration_s: float) -> str:
    return f"{duration_s:g} s"


_UNITS: dict[_Said, str] = {length: "m", _speed: "m/s", _seconds: "s"}
