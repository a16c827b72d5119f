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
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import ClassVar

from stadimeter.core.conditions.figures import Uncertain, no_figures, probability_between
from stadimeter.core.conditions.inputs import RuleInputs
from stadimeter.core.conditions.intervals import ALL, GONE, SEEN, Box, Intervals, Truth, interval
from stadimeter.core.conditions.leaf import UNKNOWN, Evidence, Figure, Leaf, Rest

FAR_SIGMAS = 12.0
"""Nothing is in doubt this many standard deviations from a threshold."""

_BISECTIONS = 48


class LimitsCondition(Leaf):
    """The base of conditions with thresholds on one figure."""

    __slots__ = ()

    has_figures = True
    uncounted: ClassVar[str] = ""
    """What its probability does not count, in words."""

    deadband_sigmas: float
    probability_on: float | None
    probability_off: float
    target: str

    @property
    def targets_named(self) -> tuple[str, ...]:
        """Its target."""
        return (self.target,)

    @property
    def is_sure(self) -> bool:
        """Whether it asks how likely it is."""
        return self.chances()[0] is not None

    @property
    def limits(self) -> tuple[float, float]:
        """The thresholds within which it begins, in the SI unit; infinite where there is none."""
        raise NotImplementedError

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

    def chances(self) -> tuple[float | None, float]:
        """Return how likely it must be to begin (None compares the figures alone), and may be at most to end."""
        return self.probability_on, self.probability_off

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
        likely_on, likely_off = self.chances()
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
        likely_on, likely_off = self.chances()
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

    # Words ----------------------------------------------------------------------------------------------------------

    def said(self, value: float, sigma: float) -> str:
        """Return a figure with its standard deviation, such as ``2.43 m ± 0.04``."""
        raise NotImplementedError

    def limits_said(self, low: float, high: float) -> str:
        """Return thresholds with their unit, such as ``between 1.00 and 2.00 m``."""
        scale, digits, unit = (math.degrees(1.0), 1, "°") if self.unit == "rad" else (1.0, 2, f" {self.unit}")
        low, high = low * scale, high * scale
        if math.isinf(low):
            return f"below {high:.{digits}f}{unit}"
        if math.isinf(high):
            return f"above {low:.{digits}f}{unit}"
        return f"between {low:.{digits}f} and {high:.{digits}f}{unit}"

    def in_words(self, inputs: RuleInputs, is_on: bool, *, names_target: bool) -> str:
        """Return the figures behind `holds`; see `Leaf.in_words`."""
        figures = self.uncertain(inputs)
        if figures is None:
            return self._unseen(inputs)
        value, sigma, noise = figures
        low, high = self.widened_limits(value, noise) if is_on else self.limits
        words = f"{self.said(value, sigma)}, {self.limits_said(low, high)}"
        return self._named(words) if names_target else words

    def probability_in_words(self, inputs: RuleInputs, is_on: bool) -> str:
        """Return how likely it is; see `Leaf.probability_in_words`."""
        figures = self.uncertain(inputs)
        likely_on, likely_off = self.chances()
        if figures is None or likely_on is None:
            return ""
        value, sigma, noise = figures
        low, high = self.widened_limits(value, noise) if is_on else self.limits
        return likely_said(probability_between(low, high, value, sigma), likely_on, likely_off, is_on=is_on)

    def _named(self, words: str) -> str:
        return f"{self.targets_named[0]} {words}"

    def _unseen(self, inputs: RuleInputs) -> str:
        tracks = [inputs.tracks[target] for target in self.targets_named]
        away = [track for track in tracks if not track.is_valid]
        return " and ".join(no_figures(track) for track in away or tracks)

    def evidence(self, inputs: RuleInputs, is_on: bool) -> Evidence:
        """Return the figures behind `holds`; see `Leaf.evidence`."""
        found = Leaf.evidence(self, inputs, is_on)
        found = replace(found, words=found.words + self.uncounted)
        figures = self.uncertain(inputs)
        if figures is None:
            return found
        value, sigma, noise = figures
        low, high = self.widened_limits(value, noise) if is_on else self.limits
        is_plain = self.chances()[0] is None
        return replace(
            found,
            value=value,
            sigma=None if self.unit == "rad" else sigma,
            low=low if math.isfinite(low) else None,
            high=high if math.isfinite(high) else None,
            probability=None if is_plain else probability_between(low, high, value, sigma),
            begin_points=self.limit_points(figures, is_on=False),
            end_points=self.limit_points(figures, is_on=True),
        )

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

    # What `check` reasons about -------------------------------------------------------------------------------------

    def situations_of(self, truth: Truth, axis: str, possible: Intervals = ALL) -> Iterator[Box]:
        """Yield the boxes of a condition about one target, whose figure is an axis of that target."""
        (target,) = self.targets_named
        if truth is Truth.UNKNOWN:
            yield {("in sight", target): GONE}
            return
        inside = interval(*self.limits)
        yield {("in sight", target): SEEN, (axis, target): possible & (inside if truth is Truth.TRUE else ~inside)}


def value_of(figures: Uncertain | None) -> float:
    """Return a figure without how sure it is; `UNKNOWN` for none."""
    return UNKNOWN if figures is None else figures[0]


def moved(low: float | None, high: float | None, by: float) -> tuple[float | None, float | None]:
    """Return thresholds moved outwards."""
    return None if low is None else low - by, None if high is None else high + by


def ends_of(low: float | None, high: float | None) -> tuple[float, float]:
    """Return thresholds with infinities in place of None."""
    return -math.inf if low is None else low, math.inf if high is None else high


def likely_said(likely: float, likely_on: float, likely_off: float, *, is_on: bool) -> str:
    """Return a probability in words, with the one at which the condition begins or ends."""
    turns = f"ends at {likely_off:.2f}" if is_on else f"begins at {likely_on:.2f}"
    return f": P {likely:.2f}, {turns}"


def surely(words: str, probability_on: float | None) -> str:
    """Return when a condition begins, with the probability that it takes."""
    return words if probability_on is None else f"{words} with a probability of {probability_on:.0%}"


def within_said(limits: tuple[float, float], say: Callable[[float], str], below: str, above: str) -> str:
    """Return thresholds in words, such as ``nearer than 0.50 m (1.6 ft)``."""
    low, high = limits
    if math.isfinite(low) and math.isfinite(high):
        return f"between {say(low)} and {say(high)}"
    return f"{above}{say(low)}" if math.isfinite(low) else f"{below}{say(high)}"


def back_said(
    limits: tuple[float, float], say: Callable[[float], str], below: str, above: str, *, band: tuple[float, float, str]
) -> str:
    """Return where a condition ends, which the deadband moves away from where it begins.

    Args:
        limits: The thresholds; infinite for none.
        say: Writes a figure with its unit.
        below: Said before the lower threshold, such as ``nearer than``.
        above: Said before the upper one.
        band: The deadband in the unit that follows, its standard deviations of the noise, and that unit.
    """
    (low, high), (deadband, sigmas, unit) = limits, band
    fixed = 0.0 if sigmas else deadband
    there = [f"{below}{say(low - fixed)}"] if math.isfinite(low) else []
    there += [f"{above}{say(high + fixed)}"] if math.isfinite(high) else []
    if not sigmas:
        return " or ".join(there)
    noise = f"{sigmas:g} standard deviations of the noise"
    width = f"{deadband:g} {unit} or {noise}, whichever is more," if deadband else noise
    return f"{' or '.join(there)} by {width}"


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
