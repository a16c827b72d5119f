"""Conditions on any quantity of a target, on how it differs between two targets, and on standing still."""

from __future__ import annotations

import math

from msgspec import Struct

from stadimeter.core.bounds import MAX_BY_UNIT, MIN_QUANTITY
from stadimeter.core.conditions import quantities
from stadimeter.core.conditions.leaf import JudgedFigure, Leaf, RuleInputs, Threshold, back_words, closing_words
from stadimeter.core.conditions.limits import LimitsCondition
from stadimeter.core.conditions.quantities import Uncertain
from stadimeter.core.tracking.transverse import AskedMotion
from stadimeter.core.words import duration, figure_in_words, length, metres, uncertain_figure

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
        found = super().thresholds
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

    @property
    def _is_apart(self) -> bool:
        return self.quantity == quantities.OF_TWO

    @property
    def sides(self) -> tuple[str, str]:  # type: ignore[override]  # of others it is a constant
        """Words of its own for how far two targets are apart."""
        return ("nearer to each other than ", "further apart than ") if self._is_apart else Leaf.sides

    @property
    def doubt(self) -> str:  # type: ignore[override]
        """The doubt about directions, which are compared as they are."""
        if self._is_apart:
            return "; how sure the directions are is not known, and not counted"
        is_direction = self.noun in {"bearing", "elevation"}
        return "; how sure a direction is, is not known" if is_direction else ""

    @property
    def subject(self) -> str:
        """The quantity and the target, or both targets."""
        return f"`{self.target}` and `{self.other}` are" if self._is_apart else super().subject

    @property
    def begins(self) -> str:
        """Words of its own for standing still and for a comparison."""
        if self.quantity == "still":
            return f"`{self.target}` has not moved by more than {length(self.within_m)} for {duration(self.limits[0])}"
        if self.is_comparison:
            by = abs(next(limit for limit in self.limits if math.isfinite(limit)))
            more = f" by {figure_in_words(by, self.unit)}" if by else ""
            return f"`{self.target}` is {self.comparison.replace('_', ' ')} `{self.other}`{more}"
        return super().begins

    @property
    def ends(self) -> str:
        """A clause on the figures that it must come back to; standing still ends with any motion."""
        if self.quantity == "still":
            return "it has moved"
        if self._is_apart:
            return f"they are {back_words(self, self.deadband, self.deadband_sigmas)}"
        return super().ends

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:
        """Return the figure and the thresholds; of two targets apart both are named already. See `Leaf.verdict`."""
        named = names_target and not self._is_apart
        return Leaf.verdict(self, inputs, is_on, names_target=named, with_probability=with_probability)

    def value_words(self, reading: JudgedFigure) -> str:
        """Return the figure, with its standard deviation where that is known."""
        value, sigma = reading.value, reading.sigma or 0.0
        if self.quantity == "closing_speed":
            return closing_words(value, sigma)
        if self._is_apart:
            return f"{self.target} and {self.other} {metres(value, sigma)} apart"
        if reading.sigma is not None:
            return uncertain_figure(self.noun + (f" to {self.other}" if self.other else ""), value, sigma, self.unit)
        if self.unit == "rad":
            return f"{self.noun} {math.degrees(value):+.1f}°"
        return Leaf.value_words(self, reading)
