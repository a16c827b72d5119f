"""Whether a simple condition holds, and for how long it surely stays so."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

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
from stadimeter.core.conditions.contact import Pace, approach_of, contact_holds, pace_of, sigmas_that_count
from stadimeter.core.conditions.figures import (
    closing_of,
    direction_of,
    in_sight,
    quantity_of,
    separation_of,
)
from stadimeter.core.conditions.known import Known
from stadimeter.core.conditions.thresholds import (
    LimitsCondition,
    Uncertain,
    has_passed,
    is_near_or_far,
    is_within,
    rests_within,
)
from stadimeter.core.observation import WallTime


def leaf_holds(condition: Leaf, known: Known, is_on: bool) -> bool | None:
    """Return whether a simple condition holds.

    Args:
        condition: The condition.
        known: What is known in this cycle.
        is_on: Whether it is judged by what ends it, where that differs from what begins it.

    Returns:
        True or False; None if it cannot be known.
    """
    return _HOLDS[type(condition)](condition, known, is_on)


def leaf_rests(condition: Leaf, known: Known, is_on: bool) -> bool:
    """Return whether a simple condition surely stays as it is until a figure of it crosses one of its limits.

    Args:
        condition: The condition.
        known: What is known in this cycle.
        is_on: Whether it is judged by what ends it.

    Returns:
        Whether it rests. One that changes by the passing of time rests until `leaf_due_s`.
    """
    rests = _RESTS.get(type(condition))
    return rests is None or rests(condition, known, is_on)


def leaf_due_s(condition: Leaf, known: Known) -> float:
    """Return when a simple condition changes if nothing happens until then.

    Args:
        condition: The condition.
        known: What is known in this cycle.

    Returns:
        On the run's monotonic clock; infinite for never, and for schedules, which go by another clock.
    """
    if not isinstance(condition, PresenceCondition) or not condition.for_s:
        return math.inf
    track = known.tracks[condition.target]
    if track.is_valid is not condition.seen or track.since_s is None:
        return math.inf
    due_s = track.since_s + condition.for_s
    return due_s if known.now_s < due_s else math.inf


def figures_of(condition: LimitsCondition, known: Known) -> Uncertain | None:
    """Return the figure that a condition is about, and how sure it is.

    Args:
        condition: The condition.
        known: What is known in this cycle.

    Returns:
        The figure, its standard deviation and that of its noise, in the SI unit; None while there is no finite figure
        to act on.
    """
    tracks = known.tracks
    match condition:
        case DistanceCondition():
            return quantity_of(tracks[condition.target], condition.quantity)
        case DirectionCondition():
            return direction_of(tracks[condition.target], condition.quantity)
        case ClosingCondition():
            return closing_of(tracks[condition.target])
        case _:
            first, second = condition.targets
            return separation_of(tracks[first], tracks[second])


def passed_through(condition: Leaf, known: Known) -> tuple[float, float] | None:
    """Return between which distances a target went through the limits of a condition, unseen by any frame.

    Args:
        condition: The condition.
        known: What is known in this cycle.

    Returns:
        The distance in the frame before and in this one, in metres; None if it did not.
    """
    if not isinstance(condition, DistanceCondition) or condition.above_m is None or condition.below_m is None:
        return None
    track = known.before.get(condition.target)
    before = None if track is None else quantity_of(track, condition.quantity)
    now = quantity_of(known.tracks[condition.target], condition.quantity)
    if before is None or now is None or not has_passed(condition, before, now):
        return None
    return before[0], now[0]


def is_scheduled(condition: ScheduleCondition, wall: WallTime) -> bool:
    """Return whether a time of day is within a schedule.

    Args:
        condition: The schedule.
        wall: The local time of day.

    Returns:
        Whether it is.
    """
    second, days = wall.second_of_day, condition.weekdays
    is_today = not days or wall.weekday in days
    if condition.from_s < condition.to_s:
        return is_today and condition.from_s <= second < condition.to_s
    began_yesterday = not days or (wall.weekday - 1) % 7 in days
    return (is_today and second >= condition.from_s) or (began_yesterday and second < condition.to_s)


def _distance(condition: DistanceCondition, known: Known, is_on: bool) -> bool | None:
    figures = quantity_of(known.tracks[condition.target], condition.quantity)
    if figures is None:
        return None
    if is_near_or_far(condition, *figures, is_on):
        return True
    has_two = condition.above_m is not None and condition.below_m is not None
    return has_two and not is_on and passed_through(condition, known) is not None


def _limits(condition: LimitsCondition, known: Known, is_on: bool) -> bool | None:
    figures = figures_of(condition, known)
    return None if figures is None else is_within(condition, *figures, is_on=is_on)


def _contact(condition: TimeToContactCondition, known: Known, is_on: bool) -> bool | None:
    approach = approach_of(known.tracks[condition.target])
    return None if approach is None else contact_holds(condition, approach, is_on=is_on)


def _presence(condition: PresenceCondition, known: Known, _: bool) -> bool:
    track = known.tracks[condition.target]
    if track.is_valid is not condition.seen:
        return False
    return not condition.for_s or (track.since_s is not None and known.now_s >= track.since_s + condition.for_s)


def _count(condition: CountCondition, known: Known, _: bool) -> bool:
    count = in_sight(known, condition.targets)
    least, most = condition.at_least, condition.at_most
    return (least is None or count >= least) and (most is None or count <= most)


def _other_rule(condition: RuleCondition, known: Known, _: bool) -> bool | None:
    return known.active.get(condition.rule)


def _schedule(condition: ScheduleCondition, known: Known, _: bool) -> bool | None:
    return None if known.wall is None else is_scheduled(condition, known.wall)


def _distance_rests(condition: DistanceCondition, known: Known, is_on: bool) -> bool:
    figures = quantity_of(known.tracks[condition.target], condition.quantity)
    if figures is None:
        return True
    if not rests_within(condition, figures[0], is_on):
        return False
    return is_on or passed_through(condition, known) is None


def _limits_rest(condition: LimitsCondition, known: Known, is_on: bool) -> bool:
    figures = figures_of(condition, known)
    return figures is None or rests_within(condition, figures[0], is_on)


def _contact_rests(condition: TimeToContactCondition, known: Known, is_on: bool) -> bool:
    approach = approach_of(known.tracks[condition.target])
    if approach is None:
        return True
    pace = pace_of(approach, condition.closing_min_mps, sigmas_that_count(condition))
    if pace is not Pace.KNOWN:
        return pace is Pace.SLOW
    likely_on = condition.probability_on
    if likely_on is not None and not condition.probability_off <= 0.5 <= likely_on:
        return False
    time_s = approach.time_s(condition.contact_m)
    return time_s < condition.below_s if is_on else time_s > condition.below_s


_HOLDS: dict[type[Leaf], Callable[[Any, Known, bool], bool | None]] = {
    DistanceCondition: _distance,
    DirectionCondition: _limits,
    ClosingCondition: _limits,
    SeparationCondition: _limits,
    TimeToContactCondition: _contact,
    PresenceCondition: _presence,
    CountCondition: _count,
    RuleCondition: _other_rule,
    ScheduleCondition: _schedule,
}

_RESTS: dict[type[Leaf], Callable[[Any, Known, bool], bool]] = {
    DistanceCondition: _distance_rests,
    DirectionCondition: _limits_rest,
    ClosingCondition: _limits_rest,
    SeparationCondition: _limits_rest,
    TimeToContactCondition: _contact_rests,
    ScheduleCondition: lambda condition, known, is_on: False,  # noqa: ARG005 - the time of day is no figure
}
"""The conditions that may change though none of their figures crosses a limit; the others always rest."""
