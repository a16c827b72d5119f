"""The figures behind a simple condition, in words."""

from __future__ import annotations

import math

from stadimeter.core.condition import (
    ClosingCondition,
    CountCondition,
    DirectionCondition,
    DistanceCondition,
    Leaf,
    PresenceCondition,
    RuleCondition,
    ScheduleCondition,
    SeparationCondition,
    TimeToContactCondition,
)
from stadimeter.core.conditions.contact import (
    Approach,
    Pace,
    approach_of,
    limit_now_s,
    pace_of,
    probability_of_contact,
    sigmas_that_count,
)
from stadimeter.core.conditions.figures import in_sight, no_figures
from stadimeter.core.conditions.known import Known
from stadimeter.core.conditions.leaf import figures_of, passed_through
from stadimeter.core.conditions.probability import probability_between
from stadimeter.core.conditions.thresholds import LimitsCondition, limits_of, probabilities_of, widened_limits
from stadimeter.core.rules.words import metres

_DAYS = ("Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday", "Sunday")


def leaf_in_words(condition: Leaf, known: Known, *, is_on: bool, names_target: bool = False) -> str:
    """Return the figures behind a simple condition.

    Args:
        condition: The condition.
        known: What is known in this cycle.
        is_on: Whether it is judged by what ends it.
        names_target: Whether to say which target it is about, where that is not said anyway.

    Returns:
        The words.
    """
    match condition:
        case DistanceCondition() | DirectionCondition() | ClosingCondition() | SeparationCondition():
            words, names_target = _limits(condition, known, is_on=is_on, names_target=names_target)
        case TimeToContactCondition():
            words, names_target = _contact(condition, known, is_on=is_on, names_target=names_target)
        case PresenceCondition():
            return _presence(condition, known)
        case CountCondition():
            return _count(condition, known)
        case RuleCondition():
            return _other_rule(condition, known)
        case ScheduleCondition():
            return _schedule(condition, known)
    return f"{condition.target} {words}" if names_target and not isinstance(condition, SeparationCondition) else words


def time_of_day(second: float) -> str:
    """Return a time of day.

    Args:
        second: Seconds since midnight.

    Returns:
        Such as ``22:30``, or ``22:30:15`` if it is not a whole minute.
    """
    minutes, seconds = divmod(int(second), 60)
    whole = f"{minutes // 60 % 24:02d}:{minutes % 60:02d}"
    return f"{whole}:{seconds:02d}" if seconds else whole


def days(weekdays: tuple[int, ...]) -> str:
    """Return days of the week.

    Args:
        weekdays: 0 for Monday; empty for every day.

    Returns:
        Such as `` on Monday and Tuesday``; empty for every day.
    """
    return f" on {' and '.join(_DAYS[day] for day in weekdays)}" if weekdays else ""


def unseen(condition: LimitsCondition | TimeToContactCondition, known: Known) -> str:
    """Return why a figure is not known.

    Args:
        condition: The condition that is about it.
        known: What is known in this cycle.

    Returns:
        The words.
    """
    targets = condition.targets if isinstance(condition, SeparationCondition) else (condition.target,)
    tracks = [known.tracks[target] for target in targets]
    away = [track for track in tracks if not track.is_valid]
    return " and ".join(no_figures(track) for track in away or tracks)


def figure_in_words(condition: LimitsCondition, value: float, sigma: float) -> str:
    """Return a figure with its standard deviation.

    Args:
        condition: The condition that is about it.
        value: The figure in the SI unit.
        sigma: Its standard deviation.

    Returns:
        Such as ``2.43 m ± 0.04`` or ``bearing +12.0°``.
    """
    match condition:
        case DistanceCondition():
            return metres(value, sigma)
        case DirectionCondition():
            return f"{condition.quantity} {math.degrees(value):+.1f}°"
        case ClosingCondition():
            return f"closing at {value:.2f} m/s ± {sigma:.2f}"
        case _:
            first, second = condition.targets
            return f"{first} and {second} {metres(value, sigma)} apart"


def limits_in_words(condition: LimitsCondition, low: float, high: float) -> str:
    """Return limits with their unit.

    Args:
        condition: The condition that they are of.
        low: The lower limit in the SI unit, or minus infinity.
        high: The upper limit, or infinity.

    Returns:
        Such as ``between 1.00 and 2.00 m``.
    """
    unit = " m"
    if isinstance(condition, DirectionCondition):
        low, high, unit = math.degrees(low), math.degrees(high), "°"
    elif isinstance(condition, ClosingCondition):
        unit = " m/s"
    digits = 1 if unit == "°" else 2
    if math.isinf(low):
        return f"below {high:.{digits}f}{unit}"
    if math.isinf(high):
        return f"above {low:.{digits}f}{unit}"
    return f"between {low:.{digits}f} and {high:.{digits}f}{unit}"


def _limits(condition: LimitsCondition, known: Known, *, is_on: bool, names_target: bool) -> tuple[str, bool]:
    figures = figures_of(condition, known)
    if figures is None:
        return unseen(condition, known), False
    passed = None if is_on else passed_through(condition, known)
    if passed is not None:
        return f"passed through between two frames: {passed[0]:.2f} m, then {passed[1]:.2f} m", names_target
    value, sigma, noise = figures
    low, high = widened_limits(condition, value, noise) if is_on else limits_of(condition)
    words = f"{figure_in_words(condition, value, sigma)}, {limits_in_words(condition, low, high)}"
    likely_on, likely_off = probabilities_of(condition)
    if likely_on is None:
        return words, names_target
    likely = probability_between(low, high, value, sigma)
    return words + _likely(likely, likely_on, likely_off, is_on=is_on), names_target


def _likely(likely: float, likely_on: float, likely_off: float, *, is_on: bool) -> str:
    turns = f"ends at {likely_off:.2f}" if is_on else f"begins at {likely_on:.2f}"
    return f": P {likely:.2f}, {turns}"


def _contact(condition: TimeToContactCondition, known: Known, *, is_on: bool, names_target: bool) -> tuple[str, bool]:
    approach = approach_of(known.tracks[condition.target])
    if approach is None:
        return unseen(condition, known), False
    speed = f"closing at {approach.closing_mps:.2f} m/s ± {approach.closing_sigma_mps:.2f}"
    pace = pace_of(approach, condition.closing_min_mps, sigmas_that_count(condition))
    if pace is Pace.SLOW:
        return f"{speed}, slower than {condition.closing_min_mps:.2f} m/s", names_target
    if pace is Pace.UNSURE:
        return f"{metres(approach.distance_m, approach.sigma_m)}, {speed}: too unsure for a time", names_target
    return _time(condition, approach, is_on=is_on), names_target


def _time(condition: TimeToContactCondition, approach: Approach, *, is_on: bool) -> str:
    limit_s = limit_now_s(condition, approach, is_on=is_on)
    time_s = approach.time_s(condition.contact_m)
    words = f"contact in {time_s:.2f} s ± {approach.time_sigma_s(time_s):.2f}, below {limit_s:.2f} s"
    if condition.probability_on is None:
        return words
    likely = probability_of_contact(condition, approach, limit_s)
    return words + _likely(likely, condition.probability_on, condition.probability_off, is_on=is_on)


def _presence(condition: PresenceCondition, known: Known) -> str:
    track = known.tracks[condition.target]
    words = f"{track.target} is {track.status.value}"
    if condition.for_s and track.is_valid is condition.seen and track.since_s is not None:
        words += f" for {known.now_s - track.since_s:.1f} s of {condition.for_s:g} s"
    return words + (f": {track.reason}" if track.reason else "")


def _count(condition: CountCondition, known: Known) -> str:
    limits = [f"at least {condition.at_least}"] if condition.at_least is not None else []
    limits += [f"at most {condition.at_most}"] if condition.at_most is not None else []
    targets = condition.targets or tuple(known.tracks)
    return f"{in_sight(known, targets)} of {len(targets)} in sight, {' and '.join(limits)}"


def _other_rule(condition: RuleCondition, known: Known) -> str:
    state = {True: "is active", False: "is not active", None: "has nothing to judge by"}
    return f"the rule {condition.rule} {state[known.active.get(condition.rule)]}"


def _schedule(condition: ScheduleCondition, known: Known) -> str:
    when = f"between {time_of_day(condition.from_s)} and {time_of_day(condition.to_s)}{days(condition.weekdays)}"
    if known.wall is None:
        return f"the time of day is not known yet, {when}"
    return f"{_DAYS[known.wall.weekday]} {time_of_day(known.wall.second_of_day // 60 * 60)}, {when}"
