"""Conditions on any quantity of a target, on how it differs between two targets, and on standing still."""

from __future__ import annotations

from msgspec import Struct

from stadimeter.core.bounds import MAX_BY_UNIT, MIN_QUANTITY
from stadimeter.core.conditions import quantities
from stadimeter.core.conditions.figures import Uncertain
from stadimeter.core.conditions.leaf import RuleInputs, Threshold
from stadimeter.core.conditions.limits import LimitsCondition
from stadimeter.core.tracking.transverse import AskedMotion

# How the noun of a difference begins.
DIFFERENCE = "difference in "

# What is compared, and whether the first target is to have more of it than the second. The contrary is written by
# naming the two the other way round.
COMPARISONS: dict[str, tuple[str, bool]] = {
    "nearer_than": ("distance", False),
    "left_of": ("bearing", False),
    "higher_than": ("height_above_camera", True),
}


class FigureCondition(LimitsCondition, Struct, frozen=True, kw_only=True):
    """A quantity of the target, or its difference from that of another, is within limits.

    All figures are in the SI unit of the quantity.

    Attributes:
        above: Holds above this; None for no such threshold.
        below: Holds below this.
        deadband: How far the figure must come back before the condition ends.
        deadband_sigmas: The same in standard deviations of the noise; the larger of the two counts.
        probability_on: The condition begins when it is at least this likely; None compares the figures alone.
        probability_off: The condition ends when it is, deadband included, at most this likely.
        target: The target; empty for that of the rule.
        other: The target that it is compared with; empty for none.
        within_m: Of standing still, how far from where it began to stand a target still counts as there.
    """

    quantity: str
    above: float | None = None
    below: float | None = None
    deadband: float = 0.0
    deadband_sigmas: float = 3.0
    probability_on: float | None = 0.7
    probability_off: float = 0.5
    target: str = ""
    other: str = ""
    within_m: float = quantities.STILL_WITHIN_M

    @property
    def is_comparison(self) -> bool:
        """True if it is on a difference."""
        return bool(self.other) and self.quantity != quantities.OF_TWO

    @property
    def comparison(self) -> str:
        """The key that a comparison is written with."""
        return next(key for key, (quantity, _) in COMPARISONS.items() if quantity == self.quantity)

    @property
    def noun(self) -> str:
        """The quantity in words."""
        return f"{DIFFERENCE if self.is_comparison else ''}{quantities.noun_of(self.quantity)}"

    @property
    def section(self) -> str:
        """The table of a quantity is called like it, that of a place so, and that of a comparison like its key."""
        if self.is_comparison:
            return self.comparison
        if self.quantity in quantities.AXES:
            return "place"
        return "speed" if self.quantity == "sideways_speed" else self.quantity

    @property
    def unit(self) -> str:
        """That of the quantity."""
        return quantities.QUANTITIES[self.quantity].unit

    @property
    def is_signed(self) -> bool:
        """True if the figure may be below zero; a difference always may."""
        return self.is_comparison or quantities.QUANTITIES[self.quantity].is_signed

    @property
    def bounds(self) -> tuple[float, float]:  # type: ignore[override]  # of a distance it is a constant
        """Those of the quantity."""
        return -MAX_BY_UNIT[self.unit] if self.is_signed else MIN_QUANTITY, MAX_BY_UNIT[self.unit]

    @property
    def thresholds(self) -> tuple[Threshold, ...]:
        """As of any limits; the time of standing still is written as ``for``."""
        found = LimitsCondition.thresholds.fget(self)  # type: ignore[attr-defined]
        return tuple([each._replace(key="still.for") for each in found]) if self.quantity == "still" else found

    @property
    def targets_named(self) -> tuple[str, ...]:
        """The target, and the other one."""
        return (self.target, self.other) if self.other else (self.target,)

    @property
    def motion(self) -> AskedMotion | None:
        """That of its target."""
        return quantities.motion_of(self.target, self.quantity, self.within_m)

    def uncertain(self, inputs: RuleInputs) -> Uncertain | None:
        """Return the figure; see `LimitsCondition.uncertain`."""
        return quantities.uncertain_of(inputs, *self._of)

    @property
    def _of(self) -> tuple[str, str, str, float]:
        return self.target, self.quantity, self.other, self.within_m
