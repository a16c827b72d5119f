"""The time until a target will be here, if it goes on as it does.

The time to contact t = (d − c) / v is a ratio, and has no normal distribution: near v = 0 it has not even a mean. But
t < T says the same as d − c − v·T < 0, of which the left side is normally distributed, with the variance
σ_d² + T²·σ_v² − 2·T·cov(d, v). So the probability is exact, given those of distance and speed. It says nothing while
the speed may as well be zero: then the time is judged only if even the fastest speed that is plausible is too slow.

These variances are those of the noise. An error of the scale makes distance and speed wrong by the same share: it
changes d − v·T by that share, and so hardly counts for a target that will be here by then.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

from msgspec import Struct

from stadimeter.core.bounds import MAX_DURATION_S, MIN_QUANTITY
from stadimeter.core.conditions.leaf import JudgedFigure, Leaf, RuleInputs, Threshold, back_words, closing_words
from stadimeter.core.conditions.limits import FAR_SIGMAS, turning_point
from stadimeter.core.conditions.quantities import probability_below
from stadimeter.core.measurement import Track
from stadimeter.core.words import length, metres


class Approach(NamedTuple):
    """The way a target comes nearer."""

    distance_m: float
    noise_m: float
    """The part of its standard deviation that differs from frame to frame."""
    scale_sigma: float
    """The rest of it, by which distance and speed may be wrong together, as a share of either."""
    closing_mps: float
    closing_sigma_mps: float
    cov_m2ps: float
    """The covariance of the noises of distance and closing speed."""

    @property
    def sigma_m(self) -> float:
        """The standard deviation of the distance, all known causes included."""
        return math.hypot(self.noise_m, self.scale_sigma * self.distance_m)

    def time_s(self, contact_m: float) -> float:
        """Return the time until a distance; infinite for a target that does not come nearer, below 0 if it is past."""
        return (self.distance_m - contact_m) / self.closing_mps if self.closing_mps > 0 else math.inf

    def time_sigma_s(self, at_s: float) -> float:
        """Return the standard deviation of a time to contact, to first order; infinite if it does not come."""
        return self.sigma_after_m(at_s) / self.closing_mps if self.closing_mps > 0 else math.inf

    def time_noise_s(self, at_s: float) -> float:
        """Return the part of `time_sigma_s` that differs from frame to frame."""
        return math.sqrt(self._noise_after_m2(at_s)) / self.closing_mps if self.closing_mps > 0 else math.inf

    def sigma_after_m(self, after_s: float) -> float:
        """Return the standard deviation of the distance some time later, for a speed that stays as it is."""
        scale_m = self.scale_sigma * (self.distance_m - after_s * self.closing_mps)
        return math.sqrt(self._noise_after_m2(after_s) + scale_m * scale_m)

    def earliest_s(self, contact_m: float, speed_sigmas: float) -> float:
        """Return the time to contact at the fastest speed that is plausible; infinite if even that is none."""
        fastest_mps = self.closing_mps + speed_sigmas * self.closing_sigma_mps
        return (self.distance_m - contact_m) / fastest_mps if fastest_mps > 0 else math.inf

    def _noise_after_m2(self, after_s: float) -> float:
        spread_m = after_s * self.closing_sigma_mps
        variance_m2 = self.noise_m * self.noise_m + spread_m * spread_m - 2 * after_s * self.cov_m2ps
        return max(0.0, variance_m2)


class SpeedKnowledge(IntEnum):
    """The knowledge of a closing speed."""

    SLOW = 0
    """It is surely below the least that counts."""
    UNSURE = 1
    """It may be below the least that counts, or zero."""
    KNOWN = 2
    """It is above the least that counts, and surely above zero."""


def approach_of(track: Track) -> Approach | None:
    """Describe how a target comes nearer; None while there are no finite figures to act on."""
    distance_m, sigma_m = track.distance_m, track.sigma_m
    closing_mps, closing_sigma_mps = track.closing_mps, track.closing_sigma_mps
    if not track.is_valid or distance_m is None or sigma_m is None or closing_mps is None or closing_sigma_mps is None:
        return None
    noise_m = sigma_m if track.noise_m is None else track.noise_m
    cov_m2ps = track.closing_cov_m2ps or 0.0
    if not math.isfinite(distance_m + sigma_m + noise_m + closing_mps + closing_sigma_mps + cov_m2ps):
        return None
    scale_sigma = math.sqrt(max(0.0, sigma_m * sigma_m - noise_m * noise_m)) / distance_m if distance_m > 0 else 0.0
    return Approach(distance_m, noise_m, scale_sigma, closing_mps, closing_sigma_mps, cov_m2ps)


def pace_of(approach: Approach, closing_min_mps: float, speed_sigmas: float) -> SpeedKnowledge:
    """Return the knowledge of a closing speed: what is `speed_sigmas` standard deviations away is sure."""
    closing_mps, unsure_mps = approach.closing_mps, speed_sigmas * approach.closing_sigma_mps
    if closing_mps >= closing_min_mps and closing_mps > unsure_mps:
        return SpeedKnowledge.KNOWN
    return SpeedKnowledge.SLOW if closing_mps + unsure_mps < closing_min_mps else SpeedKnowledge.UNSURE


class TimeToContactCondition(Leaf, Struct, frozen=True, kw_only=True):
    """A condition on the time until the target will be here, if it goes on as it does.

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

    unit = "s"
    noun = "time to contact"
    has_figures = True
    sides = ("", "later than ")

    @property
    def limits(self) -> tuple[float, float]:
        """In seconds; there is no lower one."""
        return -math.inf, self.below_s

    @property
    def thresholds(self) -> tuple[Threshold, ...]:
        """The time."""
        return (Threshold("time_to_contact.below", "below_s", MIN_QUANTITY, MAX_DURATION_S),)

    @property
    def targets_named(self) -> tuple[str, ...]:
        """Its target."""
        return (self.target,)

    @property
    def sigmas_that_count(self) -> float:
        """Number of standard deviations the speed must be sure by; 0 for one that compares the figures alone."""
        return 0.0 if self.probability_on is None else self.speed_sigmas

    def holds(self, inputs: RuleInputs, is_on: bool) -> bool | None:
        """Check whether it holds; None also while the speed is not known well enough to tell."""
        approach = approach_of(inputs.tracks[self.target])
        return None if approach is None else self._holds(approach, is_on)

    def speed_knowledge(self, approach: Approach) -> SpeedKnowledge:
        """Return the knowledge of the closing speed."""
        return pace_of(approach, self.closing_min_mps, self.sigmas_that_count)

    def _holds(self, approach: Approach, is_on: bool) -> bool | None:
        pace = self.speed_knowledge(approach)
        if pace is SpeedKnowledge.SLOW:
            return False
        if pace is SpeedKnowledge.UNSURE:
            earliest_s = approach.earliest_s(self.contact_m, self.sigmas_that_count)
            return False if earliest_s > self.below_s + self.deadband_s else None
        limit_s = self._limit_s(approach, is_on=is_on)
        if self.probability_on is None:
            return approach.time_s(self.contact_m) < limit_s
        likely = self._likely(approach, limit_s)
        return likely >= self.probability_on or (is_on and likely > self.probability_off)

    def _limit_s(self, approach: Approach, *, is_on: bool) -> float:
        """Return the time that it is judged by: what ends it is later by the deadband."""
        if not is_on:
            return self.below_s
        band_s = self.deadband_s
        if self.deadband_sigmas and approach.closing_mps > 0:
            band_s = max(band_s, self.deadband_sigmas * approach.time_noise_s(self.below_s))
        return self.below_s + band_s

    def _likely(self, approach: Approach, within_s: float) -> float:
        left_m = approach.distance_m - self.contact_m - approach.closing_mps * within_s
        return probability_below(0.0, left_m, approach.sigma_after_m(within_s))

    def reading(self, inputs: RuleInputs, is_on: bool) -> JudgedFigure | None:
        """Return the time to contact; None also while the speed is not known well enough to tell."""
        approach = self._known_approach(inputs)
        if approach is None:
            return None
        time_s, limit_s = approach.time_s(self.contact_m), self._limit_s(approach, is_on=is_on)
        likely = None if self.probability_on is None else self._likely(approach, limit_s)
        return JudgedFigure(value=time_s, sigma=approach.time_sigma_s(time_s), high=limit_s, probability=likely)

    def turning_points(self, inputs: RuleInputs, *, is_on: bool) -> tuple[float, ...]:
        """Return the time to contact at which it begins, or ends, at the speed that the target has."""
        approach = self._known_approach(inputs)
        if approach is None or approach.closing_mps <= 0:
            return ()

        def holds(time_s: float) -> bool:
            there = approach._replace(distance_m=self.contact_m + time_s * approach.closing_mps)
            return self._holds(there, is_on) is True

        sigma_s = approach.time_sigma_s(self.below_s + self.deadband_s)
        margin_s = self.deadband_s + (FAR_SIGMAS + self.deadband_sigmas) * sigma_s + 1
        return tuple(turning_point(holds, self.below_s - margin_s, self.below_s + margin_s))

    def _known_approach(self, inputs: RuleInputs) -> Approach | None:
        approach = approach_of(inputs.tracks[self.target])
        return approach if approach and self.speed_knowledge(approach) is SpeedKnowledge.KNOWN else None

    @property
    def begins(self) -> str:
        """A clause on the place and the time."""
        where = f"{length(self.contact_m)} away" if self.contact_m else "here"
        slower = f"(if faster than {self.closing_min_mps:g} m/s)"
        return f"`{self.target}` will be {where} within {self.below_s:g} s {slower}"

    @property
    def ends(self) -> str:
        """A clause on the time that contact must be later by."""
        return f"contact is {back_words(self, self.deadband_s, self.deadband_sigmas)}"

    def value_words(self, reading: JudgedFigure) -> str:
        """Return the time."""
        return f"contact in {reading.value:.2f} s ± {reading.sigma or 0.0:.2f}"

    def unread(self, inputs: RuleInputs, named: str) -> str:
        """Return in words why there is no time: no figures at all, too slow, or too unsure."""
        approach = approach_of(inputs.tracks[self.target])
        if approach is None:
            return Leaf.unread(self, inputs, named)
        speed = closing_words(approach.closing_mps, approach.closing_sigma_mps)
        if self.speed_knowledge(approach) is SpeedKnowledge.SLOW:
            return f"{named}{speed}, slower than {self.closing_min_mps:.2f} m/s"
        return f"{named}{metres(approach.distance_m, approach.sigma_m)}, {speed}: too unsure for a time"
