"""Conditions with a lower threshold, an upper one, or both, and how sure it is that a figure is within them.

A condition begins when it is likely enough, and ends when, widened by a deadband (hysteresis), it is no longer likely.
The decision by probability follows JCGM 106:2012, "The role of measurement uncertainty in conformity assessment" (a
guard band chosen by which error one accepts).

The deadband is in standard deviations of the noise, the part that differs from frame to frame: since that of a distance
grows with its square, a fixed deadband tuned at 2 m chatters 15 times a minute at 8 m. An error of the scale, such as
that of a camera that is not calibrated, is the same in every frame. It moves the distance at which an alarm begins, but
never makes one come and go, and a deadband for it would only make alarms last.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import ClassVar

from stadimeter.core.conditions.leaf import JudgedFigure, Leaf, RuleInputs, Threshold, back_words
from stadimeter.core.conditions.quantities import Uncertain, probability_between

# Nothing is in doubt this many standard deviations from a threshold.
FAR_SIGMAS = 12.0

_BISECTIONS = 48


class LimitsCondition(Leaf):
    """The base of conditions with thresholds on one figure."""

    __slots__ = ()

    has_figures = True
    target: str
    above: float | None
    below: float | None
    deadband: float
    """The amount the figure must come back at least, in the SI unit."""
    deadband_sigmas: float = 0.0
    """The deadband in standard deviations of the noise; that in the SI unit counts if it is larger."""
    bounds: ClassVar[tuple[float, float]]
    """The least and the largest value that a threshold may have."""

    @property
    def limits(self) -> tuple[float, float]:
        """In the unit; infinite where there is none."""
        return ends_of(self.above, self.below)

    @property
    def section(self) -> str:
        """The section of its thresholds in the table of a condition; empty for that table itself."""
        return ""

    @property
    def thresholds(self) -> tuple[Threshold, ...]:
        """One threshold, ``above`` or ``below``; or the two ends of ``between``, however they were written.

        The lower end stays below the upper one, and alone above the deadband: else it could never end.
        """
        (low, high), (least, most) = self.limits, self.bounds
        inside = f"{self.section}." if self.section else ""
        if math.isinf(low) and math.isinf(high):
            return ()
        if math.isinf(low):
            return (Threshold(f"{inside}below", "below", least, most),)
        if math.isinf(high):
            above_band = least if self.is_signed else math.nextafter(self.deadband, math.inf)
            return (Threshold(f"{inside}above", "above", max(least, above_band), most),)
        near, far = ("near", "far") if self.unit == "m" else ("low", "high")
        return (
            Threshold(f"{inside}between.{near}", "above", least, math.nextafter(high, -math.inf)),
            Threshold(f"{inside}between.{far}", "below", math.nextafter(low, math.inf), most),
        )

    @property
    def targets_named(self) -> tuple[str, ...]:
        """Its target."""
        return (self.target,)

    def uncertain(self, inputs: RuleInputs) -> Uncertain | None:
        """Return the figure and how sure it is; None while there is no finite figure to act on."""
        raise NotImplementedError

    @property
    def ends(self) -> str:
        """A clause on the figures that it must come back to."""
        return f"its {self.noun} is {back_words(self, self.deadband, self.deadband_sigmas)}"

    def deadband_at(self, noise: float) -> float:
        """Return the amount a figure must come back over a threshold where its noise has this standard deviation."""
        return max(self.deadband, self.deadband_sigmas * noise)

    def widened_limits(self, value: float, noise: float) -> tuple[float, float]:  # noqa: ARG002 - by some kinds
        """Return the thresholds outside which it ends: its own, widened by the deadband.

        Args:
            value: The figure now.
            noise: The standard deviation of its noise now.
        """
        low, high = self.limits
        band = self.deadband_at(noise)
        return low - band, high + band

    def is_within(self, value: float, sigma: float, noise: float, is_on: bool) -> bool:
        """Check whether it holds for a finite figure, judged by what ends it if `is_on`, else by what begins it."""
        low, high = self.widened_limits(value, noise) if is_on else self.limits
        likely_on, likely_off = self.probability_on, self.probability_off
        if likely_on is None:
            return low < value < high
        likely = probability_between(low, high, value, sigma)
        # What is likely enough to begin does not end, whatever else is asked for: it would begin again at once.
        return likely >= likely_on or (is_on and likely > likely_off)

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:
        """Check whether it holds; see `Leaf.holds`."""
        figures = self.uncertain(inputs)
        return None if figures is None else self.is_within(*figures, is_on)

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:
        """Return the figure behind `holds`; None while there is no finite figure to act on."""
        figures = self.uncertain(inputs)
        if figures is None:
            return None
        value, sigma, noise = figures
        low, high = self.widened_limits(value, noise) if is_on else self.limits
        likely = None if self.probability_on is None else probability_between(low, high, value, sigma)
        return JudgedFigure(value=value, sigma=sigma or None, low=low, high=high, probability=likely)

    def turning_points(self, inputs: RuleInputs, *, is_on: bool) -> tuple[float, ...]:
        """Return the figures at which it begins, or ends; see `Leaf.turning_points`."""
        figures = self.uncertain(inputs)
        return () if figures is None else self.limit_points(figures, is_on=is_on)

    def limit_points(self, figures: Uncertain, *, is_on: bool) -> tuple[float, ...]:
        """Return the figures at which it begins, or ends if `is_on`, with the standard deviations as they are now.

        None, one or two, the smaller first; none if it can never do so since the figure is too unsure everywhere.
        """
        value, sigma, noise = figures
        low, high = self.limits
        wide = self.widened_limits(value, noise)
        far = FAR_SIGMAS * sigma + 1

        def holds(figure: float) -> bool:
            return self.is_within(figure, sigma, noise, is_on)

        points: list[float] = []
        middle = (low + high) / 2
        if math.isfinite(low):
            points += turning_point(holds, middle if math.isfinite(high) else low + far, min(low, wide[0]) - far)
        if math.isfinite(high):
            points += turning_point(holds, middle if math.isfinite(low) else high - far, max(high, wide[1]) + far)
        return tuple(points)


def ends_of(low: float | None, high: float | None) -> tuple[float, float]:
    """Return thresholds with infinities in place of None."""
    return -math.inf if low is None else low, math.inf if high is None else high


def turning_point(holds: Callable[[float], bool], inside: float, outside: float) -> list[float]:
    """Return where a condition that holds inside ceases to, by bisection over what decides; nothing if it does not."""
    if not holds(inside) or holds(outside):
        return []
    for _ in range(_BISECTIONS):
        middle = (inside + outside) / 2
        if holds(middle):
            inside = middle
        else:
            outside = middle
    return [(inside + outside) / 2]
