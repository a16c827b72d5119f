"""The true noise of a target, learnt from its measurements: how large it is, how long it lasts, what stays.

A detector states the noise that it knows of: pixels, contrast, blur. What it cannot know, a stripe that turns with the
ball, a finger, a carpet, shows over time. Three things are learnt, slowly and within bounds:

The **level** is the logarithm of the noise's variance over the stated one. It is judged by how far a measurement is
from the line through the two before it: of that, the target's own motion explains next to nothing at usual frame rates,
and the motion models explain nothing away. (They would: to a filter for manoeuvres, noise is a target that manoeuvres
all the time.) Each normalised square moves the level by a small step, up if it is above its mean and down if it is
below: stochastic approximation (H. Robbins, S. Monro, "A stochastic approximation method", Annals of Mathematical
Statistics 22 (3), 1951). The step is in proportion to what the noise has in the variance, so where motion may explain
all, nothing is learnt. A large square counts as `MAX_SQUARE`, and that of an outlier half as much (P. Huber, "Robust
Statistics", Wiley 1981, chapter 5; F. Hampel's redescending influence): an outlier or a leap is not learnt as noise.

The **autocorrelation** from frame to frame is less than configured if successive innovations alternate: those of a
filter with the right autocorrelation are white (R. Mehra, "On the identification of variances and adaptive Kalman
filtering", IEEE Transactions on Automatic Control 15 (2), 1970). It is not learnt to be more: a target that drifts
would look like that.

What **stays**: a figure that varies clearly less than stated does not err less for that. Its error is the same in every
frame, as that of an edge under a compression that does not change, and no filter averages it away. That share of the
stated variance is passed on as it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from stadimeter.core.measurement import Sighting
from stadimeter.core.tracking.filter import FRESH_SHARE
from stadimeter.core.tracking.motion import SWAYING_SHARE
from stadimeter.core.tracking.settings import Tracking

# Time constants of learning.
LEVEL_WITHIN_S, AUTOCORRELATION_WITHIN_S = 1.0, 5.0

# 98.6 % of normally distributed figures have a smaller normalised square.
MAX_SQUARE = 6.0

# The mean of a normalised square that is cut there.
_USUAL_SQUARE = 0.974

# How far below the stated noise it is followed.
MIN_LEVEL = -2.0

# Below this share of the stated variance, a figure varies surely less than stated.
STAYS_BELOW = 0.4

# Sightings that are further apart say nothing of each other.
LINE_WITHIN_S = 1.0

# The figure that is learnt may be somewhat below zero, so that zero is not its lower end but what it hovers around.
_MAX_SIGMAS = 2.5
_MIN_AUTOCORRELATION = -0.2


class NoiseEstimate(NamedTuple):
    """The learnt noise of a target.

    Attributes:
        level: The logarithm of its variance over the stated one.
        less_correlated: The autocorrelation from frame to frame, less the configured one; zero or below.
        innovation_sigmas: The newest innovation, in standard deviations.
    """

    level: float = 0.0
    less_correlated: float = 0.0
    innovation_sigmas: float = 0.0

    @property
    def factor(self) -> float:
        """Ratio of the noise's standard deviation to the stated one, 1 or more."""
        return math.exp(0.5 * self.level) if self.level > 0.0 else 1.0

    @property
    def staying_share(self) -> float:
        """The share of the stated variance that stays from frame to frame, 0 to 1."""
        return max(0.0, 1.0 - math.exp(self.level) / STAYS_BELOW) if self.level < 0.0 else 0.0

    def autocorrelation(self, settings: Tracking) -> float:
        """Return the autocorrelation from one frame to the next, 0 to that of the settings."""
        autocorrelation = settings.autocorrelation + self.less_correlated
        return max(0.0, autocorrelation)


def learn(
    noise: NoiseEstimate, innovation_sigmas: float, line: LineDeviation | None, step_s: float, settings: Tracking
) -> NoiseEstimate:
    """Return the estimate of the noise after a measurement.

    Args:
        noise: What was known before.
        innovation_sigmas: The measurement's innovation, in standard deviations.
        line: How far it is from the line through the two before it; None where there is none.
        step_s: The time since the measurement before.
        settings: How to track.
    """
    if settings.noise_factor_max <= 1.0:
        return noise
    # Like 1 - exp(-x), and cheaper.
    slow, quick = step_s / (step_s + AUTOCORRELATION_WITHIN_S), step_s / (step_s + LEVEL_WITHIN_S)
    sigmas = min(max(innovation_sigmas, -_MAX_SIGMAS), _MAX_SIGMAS)
    # The product of successive innovations, each in its standard deviations, has the mean 0 if they are white, and is
    # negative if they alternate. Cut at 2.5 sigma, one leap moves the estimate by little.
    less = noise.less_correlated + noise.innovation_sigmas * sigmas * slow
    less = min(max(less, _MIN_AUTOCORRELATION - settings.autocorrelation), 0.0)
    level = noise.level
    if line is not None:
        # Robbins and Monro: level += gain (square - its mean), with the square cut at 6, at 3 for an outlier. 0.974 is
        # the mean of a chi-square figure of one degree of freedom that is cut at 6.
        is_outlier = abs(innovation_sigmas) > settings.gate_sigmas
        change = _excess(line, level, MAX_SQUARE / 2 if is_outlier else MAX_SQUARE)
        level += change * quick
        level = min(max(level, MIN_LEVEL), 2.0 * math.log(settings.noise_factor_max))
    return NoiseEstimate(level, less, sigmas)


class LineDeviation(NamedTuple):
    """Distance of a measurement from the line through the two before it.

    Attributes:
        off_m: The difference.
        noise_var_m2: Its variance from the noise, if that is as stated.
        motion_var_m2: Its variance from the motion of a target that sways.
    """

    off_m: float
    noise_var_m2: float
    motion_var_m2: float


def compare_with_line(
    noise: NoiseEstimate, before: tuple[Sighting, Sighting], now: Sighting, settings: Tracking
) -> LineDeviation | None:
    """Return a sighting's distance from the line through the two before it; None where these are too far apart.

    Args:
        noise: What is known of the noise.
        before: The two sightings before, the older one first.
        now: The sighting.
        settings: How to track.
    """
    older, newer = before
    step_s, step_before_s = now.at_s - newer.at_s, newer.at_s - older.at_s
    if not (0.0 < step_s <= LINE_WITHIN_S and 0.0 < step_before_s <= LINE_WITHIN_S):
        return None
    # The difference is z₂ − (1+r)·z₁ + r·z₀, with r the ratio of the steps. Noise that keeps the share ρ of itself from
    # frame to frame cancels in it as far as it is kept.
    r, rho = step_s / step_before_s, noise.autocorrelation(settings)
    stretched = (1.0 + r) * (1.0 + r)
    shares = 1.0 + stretched + r * r - 2.0 * (1.0 - FRESH_SHARE) * rho * (stretched - r * rho)
    stated_m = newer.noise_m * settings.noise_factor
    # White-noise acceleration of density q² adds q²·step²·(step + step before)/3.
    q_mps2 = SWAYING_SHARE * settings.acceleration_mps2
    return LineDeviation(
        off_m=now.distance_m - newer.distance_m - r * (newer.distance_m - older.distance_m),
        noise_var_m2=shares * stated_m * stated_m,
        motion_var_m2=q_mps2 * q_mps2 * step_s * step_s * (step_s + step_before_s) / 3.0,
    )


def _excess(line: LineDeviation, level: float, most: float) -> float:
    """Return the excess of a normalised square over its mean, weighted by what the noise has in it."""
    noise_var_m2 = line.noise_var_m2 * math.exp(level)
    var_m2 = noise_var_m2 + line.motion_var_m2
    return (min(line.off_m * line.off_m / var_m2, most) - _USUAL_SQUARE) * noise_var_m2 / var_m2
