"""Conditions on any quantity of a target, on the difference of one quantity of two targets, and on standing still."""

from __future__ import annotations

import math

from msgspec import Struct

from stadimeter.core.bounds import MAX_DURATION_S, MIN_QUANTITY
from stadimeter.core.conditions.figures import Uncertain
from stadimeter.core.conditions.leaf import UNKNOWN, Figure, JudgedFigure, Leaf, Rest, RuleInputs, Threshold
from stadimeter.core.conditions.limits import LimitsCondition, ends_of, value_of
from stadimeter.core.conditions.quantities import (
    QUANTITIES,
    QuantityName,
    difference_of,
    noun_of,
    quantity_figure,
    uncertain_of,
)
from stadimeter.core.transverse_motion import AskedMotion

# A target that stands must be this far, at least, from where it began to stand to have moved.
STILL_WITHIN_M = 0.1

# How the noun of a difference begins.
DIFFERENCE = "difference in "

# What is compared, and whether the first target is to have more of it than the second.
COMPARISONS: dict[str, tuple[QuantityName, bool]] = {
    "nearer_than": ("distance", False),
    "further_than": ("distance", True),
    "left_of": ("bearing", False),
    "right_of": ("bearing", True),
    "lower_than": ("height_above_camera", False),
    "higher_than": ("height_above_camera", True),
}


class FigureCondition(LimitsCondition, Struct, frozen=True, kw_only=True):
    """A quantity of the target is within limits. All figures are in the SI unit of the quantity.

    Attributes:
        above: Holds above this; None for no such threshold.
        below: Holds below this.
        deadband: How far the figure must come back before the condition ends.
        deadband_sigmas: The same in standard deviations of the noise; the larger of the two counts.
        probability_on: The condition begins when it is at least this likely; None compares the figures alone.
        probability_off: The condition ends when it is, deadband included, at most this likely.
        target: The target; empty for that of the rule.
    """

    quantity: QuantityName
    above: float | None = None
    below: float | None = None
    deadband: float = 0.0
    deadband_sigmas: float = 3.0
    probability_on: float | None = 0.7
    probability_off: float = 0.5
    target: str = ""

    ends = ("above", "below")

    @property
    def noun(self) -> str:
        """The quantity in words."""
        return noun_of(self.quantity)

    @property
    def section(self) -> str:
        """The table of a quantity is called like it."""
        return self.quantity

    @property
    def unit(self) -> str:
        """That of the quantity."""
        return QUANTITIES[self.quantity].unit

    @property
    def is_signed(self) -> bool:
        """Whether the quantity may be below zero."""
        return QUANTITIES[self.quantity].is_signed

    @property
    def bounds(self) -> tuple[float, float]:  # type: ignore[override]  # of the other kinds it is a constant
        """Those of the quantity."""
        return QUANTITIES[self.quantity].bounds

    @property
    def limits(self) -> tuple[float, float]:
        """Infinite where there is none."""
        return ends_of(self.above, self.below)

    @property
    def figure(self) -> Figure:
        """The quantity of its target."""
        return quantity_figure(self.target, self.quantity)

    def uncertain(self, inputs: RuleInputs) -> Uncertain | None:
        """Return the quantity; see `LimitsCondition.uncertain`."""
        return uncertain_of(inputs, self.target, self.quantity)


class ComparisonCondition(FigureCondition, frozen=True, kw_only=True):
    """A quantity of the target less the same one of another target is within limits.

    Attributes:
        other: The other target.
    """

    other: str

    @property
    def noun(self) -> str:
        """The difference in words."""
        return f"{DIFFERENCE}{noun_of(self.quantity)}"

    @property
    def comparison(self) -> str:
        """The key that it is written with."""
        return next(key for key, what in COMPARISONS.items() if what == (self.quantity, self.above is not None))

    @property
    def section(self) -> str:
        """Its key."""
        return self.comparison

    @property
    def is_signed(self) -> bool:
        """A difference may always be below zero."""
        return True

    @property
    def bounds(self) -> tuple[float, float]:  # type: ignore[override]
        """As far below zero as above."""
        most = QUANTITIES[self.quantity].bounds[1]
        return -most, most

    @property
    def targets_named(self) -> tuple[str, ...]:
        """The target, and the other one."""
        return self.target, self.other

    @property
    def figure(self) -> Figure:
        """The difference."""
        motions = (AskedMotion(self.target), AskedMotion(self.other)) if QUANTITIES[self.quantity].needs_motion else ()
        return Figure(_difference, (self.target, self.other, self.quantity), motions)

    def uncertain(self, inputs: RuleInputs) -> Uncertain | None:
        """Return the difference; see `LimitsCondition.uncertain`."""
        return _uncertain_difference(inputs, self.target, self.other, self.quantity)


class StillCondition(Leaf, Struct, frozen=True, kw_only=True):
    """The target has not moved for some time, in any direction. Unknown while it is out of sight.

    Attributes:
        for_s: For how long.
        within_m: It has moved when it is further than this, and than its noise, from where it began to stand.
        target: The target; empty for that of the rule.
    """

    for_s: float
    within_m: float = STILL_WITHIN_M
    target: str = ""

    noun = "time without motion"
    unit = "s"
    is_by_cycle = True
    has_figures = True

    @property
    def limits(self) -> tuple[float, float]:
        """In seconds; there is no upper one."""
        return self.for_s, math.inf

    @property
    def thresholds(self) -> tuple[Threshold, ...]:
        """The time."""
        return (Threshold("still_for", "for_s", MIN_QUANTITY, MAX_DURATION_S),)

    @property
    def targets_named(self) -> tuple[str, ...]:
        """Its target."""
        return (self.target,)

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:  # noqa: ARG002 - its hysteresis is `within_m`
        """Return whether it holds; see `Leaf.holds`."""
        since_s = _still_since_s(inputs, self.target, self.within_m)
        return None if since_s == UNKNOWN else inputs.now_s >= since_s + self.for_s

    def figures(self) -> tuple[Figure, ...]:
        """Return since when its target has stood."""
        motions = (AskedMotion(self.target, self.within_m),)
        return (Figure(_still_since_s, (self.target, self.within_m), motions),)

    def rest(self, inputs: RuleInputs, is_on: bool) -> Rest:  # noqa: ARG002
        """Return that it stays as it is until its target moves, comes or goes, or until its time has come."""
        since_s = _still_since_s(inputs, self.target, self.within_m)
        due_s = since_s + self.for_s
        return Rest(((self.figures()[0], since_s, since_s),), due_s if inputs.now_s < due_s else math.inf)

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:  # noqa: ARG002
        """Return for how long it has stood; None while it is out of sight."""
        since_s = _still_since_s(inputs, self.target, self.within_m)
        return None if since_s == UNKNOWN else JudgedFigure(value=inputs.now_s - since_s, low=self.for_s)


def _uncertain_difference(inputs: RuleInputs, target: str, other: str, quantity: QuantityName) -> Uncertain | None:
    first, second = uncertain_of(inputs, target, quantity), uncertain_of(inputs, other, quantity)
    if first is None or second is None:
        return None
    return difference_of(first, second, inputs.viewpoint.focal_sigma)


def _difference(inputs: RuleInputs, target: str, other: str, quantity: QuantityName) -> float:
    return value_of(_uncertain_difference(inputs, target, other, quantity))


def _still_since_s(inputs: RuleInputs, target: str, within_m: float) -> float:
    motion = inputs.motions.get(target)
    since_s = motion.still_since_s(within_m) if motion is not None and inputs.tracks[target].is_valid else None
    return UNKNOWN if since_s is None else since_s
