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

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.bounds import MAX_ANGLE_RAD, MAX_LENGTH_M, MAX_SPEED_MPS, MIN_QUANTITY
from stadimeter.core.conditions.figures import (
    Direction,
    Uncertain,
    closing_of,
    direction_of,
    probability_between,
    separation_of,
)
from stadimeter.core.conditions.leaf import UNKNOWN, Figure, JudgedFigure, Leaf, Rest, RuleInputs, Threshold

# Nothing is in doubt this many standard deviations from a threshold.
FAR_SIGMAS = 12.0

_BISECTIONS = 48


class LimitsCondition(Leaf):
    """The base of conditions with thresholds on one figure."""

    __slots__ = ()

    has_figures = True
    target: str
    deadband_sigmas: float = 0.0
    """The deadband in standard deviations of the noise; that in the SI unit counts if it is larger."""
    ends: ClassVar[tuple[str, str]]
    """The fields of the lower threshold and of the upper one."""
    bounds: ClassVar[tuple[float, float]]
    """The least and the largest value that a threshold may have."""

    @property
    def section(self) -> str:
        """Where its thresholds stand in the table of a condition; empty for that table itself."""
        return ""

    @property
    def can_end(self) -> bool:
        """Whether a figure that is never below zero can come back over the deadband."""
        low, high = self.limits
        return self.is_signed or math.isinf(low) or math.isfinite(high) or self.deadband < low

    @property
    def thresholds(self) -> tuple[Threshold, ...]:
        """One threshold, ``above`` or ``below``; or the two ends of ``between``, however they were written.

        The lower end stays below the upper one, and alone above the deadband: else it could never end.
        """
        (low, high), (least, most), (lower, upper) = self.limits, self.bounds, self.ends
        inside = f"{self.section}." if self.section else ""
        if math.isinf(low) and math.isinf(high):
            return ()
        if math.isinf(low):
            return (Threshold(f"{inside}below", upper, least, most),)
        if math.isinf(high):
            above_band = least if self.is_signed else math.nextafter(self.deadband, math.inf)
            return (Threshold(f"{inside}above", lower, max(least, above_band), most),)
        near, far = ("near", "far") if self.unit == "m" else ("low", "high")
        return (
            Threshold(f"{inside}between.{near}", lower, least, math.nextafter(high, -math.inf)),
            Threshold(f"{inside}between.{far}", upper, math.nextafter(low, math.inf), most),
        )

    @property
    def targets_named(self) -> tuple[str, ...]:
        """Its target."""
        return (self.target,)

    @property
    def deadband(self) -> float:
        """How far the figure must come back at least, in the SI unit."""
        raise NotImplementedError

    @property
    def figure(self) -> Figure:
        """The figure that it watches."""
        raise NotImplementedError

    def uncertain(self, inputs: RuleInputs) -> Uncertain | None:
        """Return the figure and how sure it is; None while there is no finite figure to act on."""
        raise NotImplementedError

    def deadband_at(self, noise: float) -> float:
        """Return how far a figure must come back over a threshold where its noise has this standard deviation."""
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
        """Return whether it holds for a finite figure, judged by what ends it if `is_on`, else by what begins it."""
        low, high = self.widened_limits(value, noise) if is_on else self.limits
        likely_on, likely_off = self.probability_on, self.probability_off
        if likely_on is None:
            return low < value < high
        likely = probability_between(low, high, value, sigma)
        # What is likely enough to begin does not end, whatever else is asked for: it would begin again at once.
        return likely >= likely_on or (is_on and likely > likely_off)

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:
        """Return whether it holds; see `Leaf.holds`."""
        figures = self.uncertain(inputs)
        return None if figures is None else self.is_within(*figures, is_on)

    def figures(self) -> tuple[Figure, ...]:
        """Return the figure that it watches."""
        return (self.figure,)

    def rest(self, inputs: RuleInputs, is_on: bool) -> Rest | None:
        """Return for how long it stays as it is: until its figure comes or goes, or gets to a threshold."""
        figures = self.uncertain(inputs)
        if figures is None:
            return Rest(((self.figure, UNKNOWN, UNKNOWN),))
        interval = self.rest_interval(figures[0], is_on)
        return None if interval is None else Rest(((self.figure, *interval),))

    def rest_interval(self, value: float, is_on: bool) -> tuple[float, float] | None:
        """Return the interval around a figure in which it stays as it is, whatever the standard deviation.

        On one side of a threshold a figure is more likely than not to be on that side, and what ends a condition lies
        further out than what begins it. So with the usual probabilities, around one half, nothing changes before.
        """
        low, high = self.limits
        likely_on, likely_off = self.probability_on, self.probability_off
        if likely_on is not None and not likely_off <= 0.5 <= likely_on:
            return None
        if not is_on:
            if value < low:
                return math.nextafter(UNKNOWN, 0.0), math.nextafter(low, -math.inf)
            return (math.nextafter(high, math.inf), math.inf) if value > high else None
        is_narrow = math.isfinite(low) and math.isfinite(high)  # a figure in there may still be unlikely to be
        if not low < value < high or (likely_on is not None and is_narrow):
            return None
        return math.nextafter(low, math.inf), math.nextafter(high, -math.inf)

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:
        """Return the figure behind `holds`; None while there is no finite figure to act on."""
        figures = self.uncertain(inputs)
        if figures is None:
            return None
        value, sigma, noise = figures
        low, high = self.widened_limits(value, noise) if is_on else self.limits
        likely = None if self.probability_on is None else probability_between(low, high, value, sigma)
        return JudgedFigure(value=value, sigma=sigma, low=low, high=high, probability=likely)

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


def value_of(figures: Uncertain | None) -> float:
    """Return a figure without how sure it is; `UNKNOWN` for none."""
    return UNKNOWN if figures is None else figures[0]


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


class ClosingCondition(LimitsCondition, Struct, frozen=True, kw_only=True):
    """How fast the target comes nearer.

    It takes more than for a distance to be sure: a target that was just seen first may move at any speed.

    Attributes:
        above_mps: Holds above this; None for no such threshold. A target that goes away closes at less than nothing.
        below_mps: Holds below this.
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

    unit = "m/s"
    noun = "closing speed"
    section = "closing_speed"
    ends = ("above_mps", "below_mps")
    bounds = (-MAX_SPEED_MPS, MAX_SPEED_MPS)

    @property
    def limits(self) -> tuple[float, float]:
        """In m/s; infinite where there is none."""
        return ends_of(self.above_mps, self.below_mps)

    @property
    def deadband(self) -> float:
        """In m/s."""
        return self.deadband_mps

    @property
    def figure(self) -> Figure:
        """The closing speed of its target."""
        return Figure(_closing_mps, (self.target,))

    def uncertain(self, inputs: RuleInputs) -> Uncertain | None:
        """Return the speed; see `LimitsCondition.uncertain`."""
        return closing_of(inputs.tracks[self.target])


class DirectionCondition(LimitsCondition, Struct, frozen=True, kw_only=True):
    """In which direction the target is.

    Attributes:
        quantity: Bearing, positive to the right, or elevation, positive upwards.
        above_rad: Holds above this; None for no such threshold.
        below_rad: Holds below this. With both, it holds between them.
        deadband_rad: How far the target must come back before the condition ends.
        target: The target; empty for that of the rule.
    """

    quantity: Direction = "bearing"
    above_rad: float | None = None
    below_rad: float | None = None
    deadband_rad: float = 0.02
    target: str = ""

    unit = "rad"
    ends = ("above_rad", "below_rad")
    bounds = (-MAX_ANGLE_RAD, MAX_ANGLE_RAD)

    @property
    def noun(self) -> str:
        """Bearing or elevation."""
        return self.quantity

    @property
    def section(self) -> str:
        """The table of a direction is called like its quantity."""
        return self.quantity

    @property
    def limits(self) -> tuple[float, float]:
        """In radians; infinite where there is none."""
        return ends_of(self.above_rad, self.below_rad)

    @property
    def deadband(self) -> float:
        """In radians."""
        return self.deadband_rad

    @property
    def figure(self) -> Figure:
        """The bearing or the elevation of its target."""
        return Figure(_direction_rad, (self.target, self.quantity))

    def uncertain(self, inputs: RuleInputs) -> Uncertain | None:
        """Return the angle; see `LimitsCondition.uncertain`."""
        return direction_of(inputs.tracks[self.target], self.quantity)

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:
        """Return the angle, without a standard deviation: that is not known."""
        reading = LimitsCondition.reading(self, inputs, is_on)
        return None if reading is None else replace(reading, sigma=None)


class SeparationCondition(LimitsCondition, Struct, frozen=True, kw_only=True):
    """How far two targets are from each other.

    Attributes:
        above_m: Holds when they are further apart than this; None for no such threshold.
        below_m: Holds when they are nearer to each other than this.
        deadband_m: How far they must come back before the condition ends.
        deadband_sigmas: The same in standard deviations of the noise; the larger of the two counts.
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

    unit = "m"
    noun = "separation"
    section = "separation"
    ends = ("above_m", "below_m")
    bounds = (MIN_QUANTITY, MAX_LENGTH_M)

    @property
    def targets_named(self) -> tuple[str, ...]:
        """The two."""
        return self.targets

    @property
    def limits(self) -> tuple[float, float]:
        """In metres; infinite where there is none."""
        return ends_of(self.above_m, self.below_m)

    @property
    def deadband(self) -> float:
        """In metres."""
        return self.deadband_m

    @property
    def figure(self) -> Figure:
        """The distance of the two from each other."""
        return Figure(_separation_m, self.targets)

    def uncertain(self, inputs: RuleInputs) -> Uncertain | None:
        """Return the separation; see `LimitsCondition.uncertain`."""
        first, second = self.targets
        return separation_of(inputs.tracks[first], inputs.tracks[second])


def _closing_mps(inputs: RuleInputs, target: str) -> float:
    return value_of(closing_of(inputs.tracks[target]))


def _direction_rad(inputs: RuleInputs, target: str, quantity: Direction) -> float:
    return value_of(direction_of(inputs.tracks[target], quantity))


def _separation_m(inputs: RuleInputs, first: str, second: str) -> float:
    return value_of(separation_of(inputs.tracks[first], inputs.tracks[second]))
