"""What a condition can say, in SI units. Whether it holds is judged in `stadimeter.core.conditions.verdict`.

A condition holds, does not hold, or cannot be known. What is not known is never taken for either.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, TypeVar, cast

Quantity = Literal["distance", "depth"]
Direction = Literal["bearing", "elevation"]


@dataclass(frozen=True, slots=True, kw_only=True)
class DistanceCondition:
    """Whether the target is nearer or further than a limit, judged with the track's standard deviation.

    Attributes:
        above_m: Holds when further than this; None for no such limit.
        below_m: Holds when nearer than this; None for no such limit. With both, it holds between them.
        quantity: Whether the limits are on the straight-line distance or on the depth along the optical axis.
        deadband_m: How far the target must come back before the condition ends.
        deadband_sigmas: The same in standard deviations of the noise, the part that differs from frame to frame; the
            larger of the two counts.
        probability_on: The condition begins when it is at least this likely; None compares the figures alone.
        probability_off: The condition ends when it is, deadband included, at most this likely.
        target: The target; empty for that of the rule.
    """

    above_m: float | None = None
    below_m: float | None = None
    quantity: Quantity = "distance"
    deadband_m: float = 0.0
    deadband_sigmas: float = 3.0
    probability_on: float | None = 0.7
    probability_off: float = 0.5
    target: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class DirectionCondition:
    """In which direction the target is. How sure a direction is, is not known: the figures alone are compared.

    Attributes:
        quantity: Bearing, positive to the right, or elevation, positive upwards.
        above_rad: Holds above this; None for no such limit.
        below_rad: Holds below this; None for no such limit. With both, it holds between them.
        deadband_rad: How far the target must come back before the condition ends.
        target: The target; empty for that of the rule.
    """

    quantity: Direction = "bearing"
    above_rad: float | None = None
    below_rad: float | None = None
    deadband_rad: float = 0.02
    target: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosingCondition:
    """How fast the target comes nearer.

    It takes more than for a distance to be sure: a target that was just seen first may move at any speed.

    Attributes:
        above_mps: Holds above this; None for no such limit. A target that goes away closes at less than nothing.
        below_mps: Holds below this; None for no such limit.
        deadband_mps: How far the speed must come back before the condition ends.
        deadband_sigmas: The same in standard deviations; the larger of the two counts.
        probability_on: The condition begins when it is at least this likely; None compares the figures alone.
        probability_off: The condition ends when it is, deadband included, at most this likely.
        target: The target; empty for that of the rule.
    """

    above_mps: float | None = None
    below_mps: float | None = None
    deadband_mps: float = 0.0
    deadband_sigmas: float = 2.0
    probability_on: float | None = 0.95
    probability_off: float = 0.5
    target: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeToContactCondition:
    """How soon the target will be here, if it goes on as it does.

    The time to contact of a target at distance d that closes at v, contact being at distance c, is (d − c) / v. It is
    below T when d − c − v·T < 0, which is normally distributed where its ratio is not; its standard deviation follows
    from those of d and v.

    Attributes:
        below_s: Holds when it is sooner than this.
        contact_m: The distance that counts as contact.
        closing_min_mps: A target that closes more slowly than this does not come at all. A speed that is not surely
            known, to `speed_sigmas`, leaves the condition unknown.
        speed_sigmas: How many standard deviations the speed must be above zero to be known.
        deadband_s: How much later the contact must be before the condition ends.
        deadband_sigmas: The same in standard deviations of the time's noise; the larger of the two counts.
        probability_on: The condition begins when it is at least this likely; None compares the figures alone.
        probability_off: The condition ends when it is, deadband included, at most this likely.
        target: The target; empty for that of the rule.
    """

    below_s: float
    contact_m: float = 0.0
    closing_min_mps: float = 0.1
    speed_sigmas: float = 2.0
    deadband_s: float = 0.5
    deadband_sigmas: float = 2.0
    probability_on: float | None = 0.7
    probability_off: float = 0.5
    target: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class SeparationCondition:
    """How far two targets are from each other. Unknown while either is out of sight.

    Attributes:
        targets: The two.
        above_m: Holds when they are further apart than this; None for no such limit.
        below_m: Holds when they are nearer to each other than this; None for no such limit.
        deadband_m: How far they must come back before the condition ends.
        deadband_sigmas: The same in standard deviations of the noise, the part that differs from frame to frame; the
            larger of the two counts.
        probability_on: The condition begins when it is at least this likely; None compares the figures alone.
        probability_off: The condition ends when it is, deadband included, at most this likely.
    """

    targets: tuple[str, str]
    above_m: float | None = None
    below_m: float | None = None
    deadband_m: float = 0.0
    deadband_sigmas: float = 3.0
    probability_on: float | None = 0.7
    probability_off: float = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class PresenceCondition:
    """Whether the target is in sight.

    Attributes:
        seen: True: holds while the target is tracked. False: holds while it is lost or was never seen.
        for_s: Only when that has been so for this long without a break.
        target: The target; empty for that of the rule.
    """

    seen: bool
    for_s: float = 0.0
    target: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class CountCondition:
    """How many targets are in sight.

    Attributes:
        targets: Of these; empty for all.
        at_least: Holds with no fewer than this; None for no such limit.
        at_most: Holds with no more than this; None for no such limit.
    """

    targets: tuple[str, ...] = ()
    at_least: int | None = None
    at_most: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RuleCondition:
    """Whether another rule is active. Unknown while that rule has nothing to judge by.

    Attributes:
        rule: The other rule.
    """

    rule: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ScheduleCondition:
    """Whether it is a certain time of day, local time. Unknown while the clock is not synchronised.

    Attributes:
        from_s: It begins this long after midnight.
        to_s: It ends this long after midnight; before or at `from_s`, on the day after.
        weekdays: On these days, 0 for Monday; the day on which it begins counts. Empty for every day.
    """

    from_s: float
    to_s: float
    weekdays: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class AllOf:
    """Holds when each of its conditions holds.

    Attributes:
        conditions: One or more.
    """

    conditions: tuple[Condition, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class AnyOf:
    """Holds when at least one of its conditions holds.

    Attributes:
        conditions: One or more.
    """

    conditions: tuple[Condition, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Not:
    """Holds when its condition does not.

    Attributes:
        condition: The condition.
    """

    condition: Condition


Leaf = (
    DistanceCondition
    | DirectionCondition
    | ClosingCondition
    | TimeToContactCondition
    | SeparationCondition
    | PresenceCondition
    | CountCondition
    | RuleCondition
    | ScheduleCondition
)
Condition = Leaf | AllOf | AnyOf | Not

_C = TypeVar("_C", bound=Condition)


def leaves(condition: Condition) -> Iterator[Leaf]:
    """Go through the simple conditions that a condition is made of, from left to right.

    Args:
        condition: The condition.

    Yields:
        Each of them; the condition itself if it is simple.
    """
    match condition:
        case AllOf() | AnyOf():
            for part in condition.conditions:
                yield from leaves(part)
        case Not():
            yield from leaves(condition.condition)
        case _:
            yield condition


def about(condition: _C, target: str) -> _C:
    """Return a condition in which every part that names no target is about one.

    Args:
        condition: The condition.
        target: The target.

    Returns:
        The condition; the same object if each part names its target.
    """
    match condition:
        case AllOf() | AnyOf():
            parts = tuple(about(part, target) for part in condition.conditions)
            is_same = all(part is old for part, old in zip(parts, condition.conditions, strict=True))
            return condition if is_same else replace(condition, conditions=parts)
        case Not():
            part = about(condition.condition, target)
            return condition if part is condition.condition else replace(condition, condition=part)
        case _ if any(field.name == "target" for field in fields(condition)) and not getattr(condition, "target", ""):
            return cast(_C, replace(cast(Any, condition), target=target))
        case _:
            return condition


def depends_on(condition: Condition) -> frozenset[str]:
    """Return the names of the rules that a condition asks for.

    Args:
        condition: The condition.

    Returns:
        The names.
    """
    return frozenset(leaf.rule for leaf in leaves(condition) if isinstance(leaf, RuleCondition))


def targets_of(condition: Condition) -> frozenset[str]:
    """Return the names of the targets that a condition is about.

    Args:
        condition: The condition.

    Returns:
        The names; without those of a count of all targets.
    """
    names: set[str] = set()
    for leaf in leaves(condition):
        match leaf:
            case SeparationCondition() | CountCondition():
                names.update(leaf.targets)
            case RuleCondition() | ScheduleCondition():
                pass
            case _:
                names.add(leaf.target)
    return frozenset(names)
