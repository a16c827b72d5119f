"""How soon a target will be here, if it goes on as it does.

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

from stadimeter.core.condition import TimeToContactCondition
from stadimeter.core.conditions.probability import probability_below
from stadimeter.core.track import Track


class Approach(NamedTuple):
    """How a target comes nearer.

    Attributes:
        distance_m: Its distance.
        noise_m: The standard deviation of that as far as it differs from frame to frame.
        scale_sigma: The rest of it, by which distance and speed may be wrong together, as a share of either.
        closing_mps: Its closing speed.
        closing_sigma_mps: The standard deviation of the noise of that.
        cov_m2ps: The covariance of the two noises.
    """

    distance_m: float
    noise_m: float
    scale_sigma: float
    closing_mps: float
    closing_sigma_mps: float
    cov_m2ps: float

    @property
    def sigma_m(self) -> float:
        """The standard deviation of the distance, all known causes included."""
        return math.hypot(self.noise_m, self.scale_sigma * self.distance_m)

    def time_s(self, contact_m: float) -> float:
        """Return the time to contact.

        Args:
            contact_m: The distance that counts as contact.

        Returns:
            In seconds; infinite for a target that does not come nearer, below 0 for one that is nearer already.
        """
        return (self.distance_m - contact_m) / self.closing_mps if self.closing_mps > 0 else math.inf

    def time_sigma_s(self, at_s: float) -> float:
        """Return the standard deviation of a time to contact, to first order.

        Args:
            at_s: The time to contact. Taken at a limit in its place, it is what the standard deviation is there.

        Returns:
            In seconds; infinite for a target that does not come nearer.
        """
        return self.sigma_after_m(at_s) / self.closing_mps if self.closing_mps > 0 else math.inf

    def time_noise_s(self, at_s: float) -> float:
        """Return the part of `time_sigma_s` that differs from frame to frame.

        Args:
            at_s: The time to contact.

        Returns:
            In seconds; infinite for a target that does not come nearer.
        """
        return math.sqrt(self._noise_after_m2(at_s)) / self.closing_mps if self.closing_mps > 0 else math.inf

    def sigma_after_m(self, after_s: float) -> float:
        """Return how sure it is where the target will be.

        Args:
            after_s: How much later.

        Returns:
            The standard deviation of its distance then, in metres, for a speed that stays as it is.
        """
        scale_m = self.scale_sigma * (self.distance_m - after_s * self.closing_mps)
        return math.sqrt(self._noise_after_m2(after_s) + scale_m * scale_m)

    def _noise_after_m2(self, after_s: float) -> float:
        spread_m = after_s * self.closing_sigma_mps
        variance_m2 = self.noise_m * self.noise_m + spread_m * spread_m - 2 * after_s * self.cov_m2ps
        return max(0.0, variance_m2)


class Pace(IntEnum):
    """What is known of a closing speed."""

    SLOW = 0
    """It is surely below the least that counts."""
    UNSURE = 1
    """It may be below the least that counts, or zero."""
    KNOWN = 2
    """It is above the least that counts, and surely above zero."""


def approach_of(track: Track) -> Approach | None:
    """Return how a target comes nearer.

    Args:
        track: The target.

    Returns:
        The figures, or None while there are no finite ones to act on.
    """
    distance_m, sigma_m = track.distance_m, track.sigma_m
    closing_mps, closing_sigma_mps = track.closing_mps, track.closing_sigma_mps
    if not track.is_valid or distance_m is None or sigma_m is None or closing_mps is None or closing_sigma_mps is None:
        return None
    noise_m = sigma_m if track.noise_m is None else track.noise_m
    cov_m2ps = track.closing_cov_m2ps or 0.0
    if not math.isfinite(distance_m + sigma_m + noise_m + closing_mps + closing_sigma_mps + cov_m2ps):
        return None
    return Approach(
        distance_m, noise_m, _scale_sigma(distance_m, sigma_m, noise_m), closing_mps, closing_sigma_mps, cov_m2ps
    )


def pace_of(approach: Approach, closing_min_mps: float, speed_sigmas: float) -> Pace:
    """Return what is known of a closing speed.

    Args:
        approach: The target.
        closing_min_mps: The least speed that counts.
        speed_sigmas: What is that many standard deviations away is sure.

    Returns:
        What is known.
    """
    closing_mps, unsure_mps = approach.closing_mps, speed_sigmas * approach.closing_sigma_mps
    if closing_mps >= closing_min_mps and closing_mps > unsure_mps:
        return Pace.KNOWN
    return Pace.SLOW if closing_mps + unsure_mps < closing_min_mps else Pace.UNSURE


def sigmas_that_count(condition: TimeToContactCondition) -> float:
    """Return how sure of the speed a condition asks to be.

    Args:
        condition: The condition.

    Returns:
        The number of standard deviations; 0 for one that compares the figures alone.
    """
    return 0.0 if condition.probability_on is None else condition.speed_sigmas


def limit_now_s(condition: TimeToContactCondition, approach: Approach, *, is_on: bool) -> float:
    """Return the time to contact that a condition is judged by.

    Args:
        condition: The condition.
        approach: The target.
        is_on: Whether it is judged by what ends it: then the limit is later by the deadband.

    Returns:
        In seconds.
    """
    if not is_on:
        return condition.below_s
    band_s = condition.deadband_s
    if condition.deadband_sigmas and approach.closing_mps > 0:
        band_s = max(band_s, condition.deadband_sigmas * approach.time_noise_s(condition.below_s))
    return condition.below_s + band_s


def probability_of_contact(condition: TimeToContactCondition, approach: Approach, within_s: float) -> float:
    """Return how likely a target is to be in contact in time.

    Args:
        condition: What counts as contact.
        approach: The target.
        within_s: The time.

    Returns:
        From 0 to 1.
    """
    left_m = approach.distance_m - condition.contact_m - approach.closing_mps * within_s
    return probability_below(0.0, left_m, approach.sigma_after_m(within_s))


def contact_holds(condition: TimeToContactCondition, approach: Approach, *, is_on: bool) -> bool | None:
    """Return whether a target will be here soon.

    Args:
        condition: The condition.
        approach: The target.
        is_on: Whether it is judged by what ends it.

    Returns:
        True or False; None while the speed is not known well enough to tell.
    """
    sigmas = sigmas_that_count(condition)
    pace = pace_of(approach, condition.closing_min_mps, sigmas)
    if pace is Pace.SLOW:
        return False
    if pace is Pace.UNSURE:
        fastest_mps = approach.closing_mps + sigmas * approach.closing_sigma_mps
        is_far = fastest_mps * (condition.below_s + condition.deadband_s) < approach.distance_m - condition.contact_m
        return False if is_far else None
    limit_s = limit_now_s(condition, approach, is_on=is_on)
    if condition.probability_on is None:
        return approach.time_s(condition.contact_m) < limit_s
    likely = probability_of_contact(condition, approach, limit_s)
    return likely >= condition.probability_on or (is_on and likely > condition.probability_off)


def _scale_sigma(distance_m: float, sigma_m: float, noise_m: float) -> float:
    return math.sqrt(max(0.0, sigma_m * sigma_m - noise_m * noise_m)) / distance_m if distance_m > 0 else 0.0
