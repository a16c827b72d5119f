"""The condition that a target is nearer or further than a threshold, judged with the track's standard deviation."""

from __future__ import annotations

import math

from msgspec import Struct

from stadimeter.core.bounds import MAX_LENGTH_M, MIN_QUANTITY
from stadimeter.core.conditions.leaf import JudgedFigure, Leaf, RuleInputs, back_words
from stadimeter.core.conditions.limits import LimitsCondition, turning_point
from stadimeter.core.conditions.quantities import DistanceKind, Uncertain, probability_below, quantity_of
from stadimeter.core.words import metres


class DistanceCondition(LimitsCondition, Struct, frozen=True, kw_only=True):
    """A condition that the target is nearer or further than a threshold.

    Attributes:
        above: Holds when further than this, in metres; None for no such threshold.
        below: Holds when nearer than this. With both, it holds between them.
        quantity: Whether the thresholds are on the straight-line distance or on the depth along the optical axis.
        deadband: How far past the threshold the target must go before the condition ends, in metres.
        deadband_sigmas: The same in standard deviations of the noise; the larger of the two counts.
        probability_on: The condition begins when it is at least this likely; None compares the figures alone.
        probability_off: The condition ends when it is, deadband included, at most this likely.
        target: The target; empty for that of the rule.
    """

    above: float | None = None
    below: float | None = None
    quantity: DistanceKind = "distance"
    deadband: float = 0.0
    deadband_sigmas: float = 3.0
    probability_on: float | None = 0.7
    probability_off: float = 0.5
    target: str = ""

    unit = "m"
    sides = ("nearer than ", "further than ")
    bounds = (MIN_QUANTITY, MAX_LENGTH_M)

    @property
    def noun(self) -> str:
        """Distance or depth."""
        return self.quantity

    def uncertain(self, inputs: RuleInputs) -> Uncertain | None:
        """Return the distance or depth; see `LimitsCondition.uncertain`."""
        return quantity_of(inputs.tracks[self.target], self.quantity)

    def widened_limits(self, value: float, noise: float) -> tuple[float, float]:
        """Return the thresholds outside which it ends. The noise at each is scaled with the square of the distance."""
        low, high = self.limits
        return low - self._deadband_m(low, value, noise), high + self._deadband_m(high, value, noise)

    def _deadband_m(self, limit_m: float, value_m: float, noise_m: float) -> float:
        if math.isinf(limit_m):
            return 0.0
        # Far from the threshold the scaling law says nothing useful, and the condition is clear anyway.
        ratio = min(max(limit_m / value_m, 0.5), 2.0) if value_m > 0 else 1.0
        return max(self.deadband, self.deadband_sigmas * noise_m * ratio * ratio)

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:
        """Check whether it holds; one between two thresholds also in the frame in which it was passed through."""
        figures = quantity_of(inputs.tracks[self.target], self.quantity)
        if figures is None:
            return None
        if self.is_within(*figures, is_on):
            return True
        return not is_on and self.passed_through(inputs) is not None

    def passed_through(self, inputs: RuleInputs) -> tuple[float, float] | None:
        """Return between which distances a target went through both thresholds unseen; None if it did not.

        A distance does not jump: a target that was surely on one side, and now surely is on the other, was in between.
        """
        if self.above is None or self.below is None:
            return None
        track = inputs.before.get(self.target)
        before = None if track is None else quantity_of(track, self.quantity)
        now = self.uncertain(inputs)
        if before is None or now is None:
            return None
        sides = self._sure_side(before), self._sure_side(now)
        return None if 0 in sides or sides[0] == sides[1] else (before[0], now[0])

    def _sure_side(self, figures: Uncertain) -> int:
        """Return 1 for surely further than both thresholds, -1 for surely nearer than both, else 0."""
        low_m, high_m = self.limits
        sure, (value_m, sigma_m, _) = self.probability_on, figures
        if sure is None:
            return (value_m >= high_m) - (value_m <= low_m)
        nearer, further = probability_below(low_m, value_m, sigma_m), 1.0 - probability_below(high_m, value_m, sigma_m)
        return (further >= sure) - (nearer >= sure)

    def limit_points(self, figures: Uncertain, *, is_on: bool) -> tuple[float, ...]:
        """Return the distances at which it begins, or ends.

        On the way there the noise is taken to grow with the square of the distance, and an error of the scale in
        proportion to it.
        """
        value_m, sigma_m, noise_m = figures
        if value_m <= 0:
            return LimitsCondition.limit_points(self, figures, is_on=is_on)
        noise_per_m = noise_m / (value_m * value_m)
        scale_sigma = math.sqrt(max(0.0, sigma_m * sigma_m - noise_m * noise_m)) / value_m

        def holds(distance_m: float) -> bool:
            there_m = noise_per_m * distance_m * distance_m
            return self.is_within(distance_m, math.hypot(there_m, scale_sigma * distance_m), there_m, is_on)

        low, high = self.limits
        points: list[float] = []
        middle = (low + high) / 2
        if math.isfinite(low):
            points += turning_point(holds, middle if math.isfinite(high) else 2 * low, 0.0)
        if math.isfinite(high):
            points += turning_point(holds, middle if math.isfinite(low) else 0.0, 2 * high)
        return tuple(points)

    @property
    def subject(self) -> str:
        """The target: the sides say that a distance is meant."""
        return f"`{self.target}` is"

    @property
    def within(self) -> str:
        """The thresholds, and whether they are on the depth."""
        return f"{super().within}{' along the optical axis' if self.quantity == 'depth' else ''}"

    @property
    def ends(self) -> str:
        """A clause on the distance that the target must come back to."""
        return f"it is {back_words(self, self.deadband, self.deadband_sigmas)}"

    def verdict(self, inputs: RuleInputs, is_on: bool, *, names_target: bool, with_probability: bool) -> str:
        """Return the distance and the thresholds, or between which distances it passed through; see `Leaf.verdict`."""
        passed = None if is_on else self.passed_through(inputs)
        if passed is not None:
            named = f"{self.target} " if names_target else ""
            return f"{named}passed through between two frames: {passed[0]:.2f} m, then {passed[1]:.2f} m"
        return Leaf.verdict(self, inputs, is_on, names_target=names_target, with_probability=with_probability)

    def value_words(self, reading: JudgedFigure) -> str:
        """Return the distance."""
        return metres(reading.value, reading.sigma or 0.0)
