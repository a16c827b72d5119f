"""The figures that a condition was judged by, part by part, for whoever asks why."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from stadimeter.core.condition import (
    ClosingCondition,
    Condition,
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
    Pace,
    approach_of,
    limit_now_s,
    pace_of,
    probability_of_contact,
    sigmas_that_count,
)
from stadimeter.core.conditions.figures import in_sight
from stadimeter.core.conditions.known import Known
from stadimeter.core.conditions.leaf import figures_of, leaf_holds
from stadimeter.core.conditions.probability import probability_between
from stadimeter.core.conditions.thresholds import LimitsCondition, limits_of, probabilities_of, widened_limits
from stadimeter.core.conditions.turning_points import contact_points, limit_points
from stadimeter.core.conditions.verdict import Part, parts_of
from stadimeter.core.conditions.words import leaf_in_words


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """The figures that a simple condition was judged by. Those that it does not have are None.

    Attributes:
        quantity: What it is about, such as ``distance``.
        about: The targets, or the rule, that it is about; empty for the time of day and a count of all targets.
        words: The figures in words.
        holds: Whether it holds; None if that cannot be known.
        unit: The SI unit of the figures; empty for those without.
        value: The figure now.
        sigma: Its standard deviation, where that is known.
        low: The lower limit that it is judged by now, deadband included.
        high: The upper limit.
        probability: How likely the figure is within them.
        begin_points: The figures at which it would begin to speak for the alarm.
        end_points: The figures at which it would cease to.
    """

    quantity: str
    about: tuple[str, ...]
    words: str
    holds: bool | None
    unit: str = ""
    value: float | None = None
    sigma: float | None = None
    low: float | None = None
    high: float | None = None
    probability: float | None = None
    begin_points: tuple[float, ...] = ()
    end_points: tuple[float, ...] = ()

    @property
    def begins_at(self) -> str:
        """Where it would begin to speak for the alarm, such as ``1.91 m``; empty if it never would."""
        return self._points(self.begin_points)

    @property
    def ends_at(self) -> str:
        """Where it would cease to, such as ``2.12 m``; empty if it never would."""
        return self._points(self.end_points)

    def _points(self, points: tuple[float, ...]) -> str:
        if self.unit == "rad":
            return " or ".join(f"{math.degrees(point):.1f}°" for point in points)
        return " or ".join(f"{point:.2f} {self.unit}" for point in points)


def evidence(condition: Condition, known: Known, held: tuple[bool, ...], *, is_active: bool) -> tuple[Evidence, ...]:
    """Return the figures behind what `conditions.judge` returns for the same arguments.

    Args:
        condition: The condition.
        known: What is known in this cycle.
        held: From the verdict on the sample before.
        is_active: Whether the alarm is active.

    Returns:
        One for each simple part, from left to right.
    """
    return tuple(_evidence(part, known) for part in parts_of(condition, held, is_active=is_active))


def _evidence(part: Part, known: Known) -> Evidence:
    leaf = part.leaf
    found = Evidence(
        quantity=_quantity(leaf),
        about=_about(leaf),
        words=leaf_in_words(leaf, known, is_on=part.is_on, names_target=True),
        holds=leaf_holds(leaf, known, part.is_on),
    )
    match leaf:
        case DistanceCondition() | DirectionCondition() | ClosingCondition() | SeparationCondition():
            found = _with_limits(found, leaf, known, is_on=part.is_on)
        case TimeToContactCondition():
            found = _with_contact(found, leaf, known, is_on=part.is_on)
        case CountCondition():
            count = float(in_sight(known, leaf.targets))
            found = replace(found, value=count, low=_float(leaf.at_least), high=_float(leaf.at_most))
        case PresenceCondition():
            since_s = known.tracks[leaf.target].since_s
            is_so = known.tracks[leaf.target].is_valid is leaf.seen
            held_s = known.now_s - since_s if is_so and since_s is not None else 0.0
            found = replace(found, unit="s", value=held_s, low=leaf.for_s) if leaf.for_s else found
        case _:
            pass
    if part.is_inverted:  # the whole begins when this part ends
        return replace(found, begin_points=found.end_points, end_points=found.begin_points)
    return found


def _with_limits(found: Evidence, leaf: LimitsCondition, known: Known, *, is_on: bool) -> Evidence:
    found = replace(found, unit=_UNITS[type(leaf)], words=found.words + _UNCOUNTED.get(type(leaf), ""))
    figures = figures_of(leaf, known)
    if figures is None:
        return found
    value, sigma, noise = figures
    low, high = widened_limits(leaf, value, noise) if is_on else limits_of(leaf)
    is_plain = probabilities_of(leaf)[0] is None
    return replace(
        found,
        value=value,
        sigma=None if isinstance(leaf, DirectionCondition) else sigma,
        low=low if math.isfinite(low) else None,
        high=high if math.isfinite(high) else None,
        probability=None if is_plain else probability_between(low, high, value, sigma),
        begin_points=limit_points(leaf, figures, is_on=False),
        end_points=limit_points(leaf, figures, is_on=True),
    )


def _with_contact(found: Evidence, leaf: TimeToContactCondition, known: Known, *, is_on: bool) -> Evidence:
    found = replace(found, unit="s")
    approach = approach_of(known.tracks[leaf.target])
    if approach is None or pace_of(approach, leaf.closing_min_mps, sigmas_that_count(leaf)) is not Pace.KNOWN:
        return found
    time_s, limit_s = approach.time_s(leaf.contact_m), limit_now_s(leaf, approach, is_on=is_on)
    likely = None if leaf.probability_on is None else probability_of_contact(leaf, approach, limit_s)
    return replace(
        found,
        value=time_s,
        sigma=approach.time_sigma_s(time_s),
        high=limit_s,
        probability=likely,
        begin_points=contact_points(leaf, approach, is_on=False),
        end_points=contact_points(leaf, approach, is_on=True),
    )


def _quantity(leaf: Leaf) -> str:
    return leaf.quantity if isinstance(leaf, DistanceCondition | DirectionCondition) else _QUANTITIES[type(leaf)]


def _about(leaf: Leaf) -> tuple[str, ...]:
    match leaf:
        case SeparationCondition() | CountCondition():
            return tuple(leaf.targets)
        case RuleCondition():
            return (leaf.rule,)
        case ScheduleCondition():
            return ()
        case _:
            return (leaf.target,)


def _float(number: int | None) -> float | None:
    return None if number is None else float(number)


_UNITS: dict[type[LimitsCondition], str] = {
    DistanceCondition: "m",
    DirectionCondition: "rad",
    ClosingCondition: "m/s",
    SeparationCondition: "m",
}
_UNCOUNTED: dict[type[LimitsCondition], str] = {
    DirectionCondition: "; how sure a direction is, is not known",
    SeparationCondition: "; how sure the directions are is not known, and not counted",
}
_QUANTITIES: dict[type[Leaf], str] = {
    ClosingCondition: "closing speed",
    TimeToContactCondition: "time to contact",
    SeparationCondition: "separation",
    PresenceCondition: "presence",
    CountCondition: "count",
    RuleCondition: "rule",
    ScheduleCondition: "time of day",
}
