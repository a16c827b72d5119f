"""Three filters side by side, for a target that keeps its speed, sways or manoeuvres, and the noise that they learn."""

from __future__ import annotations

import math
from typing import NamedTuple

from msgspec import Struct

from stadimeter.core.measurement import Sighting
from stadimeter.core.tracking import filter as kalman
from stadimeter.core.tracking.filter import FRESH_SHARE, FilterState

# Three filters side by side: for a target that keeps its speed, one that sways, and one that manoeuvres ---------------
#
# The constant-velocity filter smooths much, and lags behind a target that starts or stops. The manoeuvring filter
# follows, and hardly smooths. The swaying filter is for what lies between them: a person who shifts from foot to
# foot, a ball in a hand. With two filters only, such a target is neither: it is followed no better than by the raw
# measurements, and its stated error is a third too small. The innovations of each measurement say which filter is
# right at the moment. This is the interacting multiple model estimator: H. Blom and Y. Bar-Shalom, "The interacting
# multiple model algorithm for systems with Markovian switching coefficients", IEEE Transactions on Automatic
# Control 33 (8), 1988; Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation",
# Wiley 2001, section 11.6.6.
#
# A target keeps to its model for a while, and then takes any of them by how usual each is. With transitions of this
# form a filter's mixture is one of itself and of the estimate of all together, which is worked out for each frame
# anyway.

# Process noise of each model, as a share of the configured acceleration.
CONSTANT_VELOCITY_SHARE, SWAYING_SHARE, MANOEUVRING_SHARE = 0.025, 0.3, 2.0

# The share of time that targets keep to each model.
USUAL = (0.83, 0.15, 0.02)

# The mean time after which a target takes a model anew, which may be the same.
KEEPS_FOR_S = 2.0

# No filter is ever written off more than this: a target may change at any time.
_SURELY = 1e-3
_exp, _sqrt = math.exp, math.sqrt

# A measurement whose normalised square is larger pulls the first two filters no further than one of that size: Huber's
# estimate of a mean, see `stadimeter.core.tracking.motion`. Noise with heavy tails counts for what it is worth.
# The manoeuvring filter goes where it is seen.
TRUSTED_SQUARE = 4.0


class MotionState(NamedTuple):
    """State of all three filters at one moment.

    Attributes:
        constant: The constant-velocity filter.
        swaying: The filter of a target whose speed changes gently all the time.
        manoeuvring: The filter of a target that changes its speed abruptly.
        constant_share: Probability of the constant-velocity model, 0 to 1.
        swaying_share: Probability of the swaying model.
        manoeuvring_share: Probability of the manoeuvring model. The three add up to 1.
        together: The estimate, if it is worked out already.
    """

    constant: FilterState
    swaying: FilterState
    manoeuvring: FilterState
    constant_share: float
    swaying_share: float
    manoeuvring_share: float
    together: FilterState | None = None

    @property
    def distance_m(self) -> float:
        """The mean of all, weighted by their probabilities."""
        return (
            self.constant_share * self.constant.distance_m
            + self.swaying_share * self.swaying.distance_m
            + self.manoeuvring_share * self.manoeuvring.distance_m
        )

    def estimate(self) -> FilterState:
        """Return the mean and covariance of all, weighted by their probabilities."""
        if self.together is not None:
            return self.together
        changing_share = self.swaying_share + self.manoeuvring_share
        changing = kalman.mix(self.swaying, self.manoeuvring, self.swaying_share / changing_share)
        return kalman.mix(self.constant, changing, self.constant_share)


class Innovation(NamedTuple):
    """Distance of a measurement from what each filter expected, and the variance of such differences.

    The differences are in metres, negative if the target is nearer than expected; the variances in m².
    """

    constant_m: float
    constant_var_m2: float
    swaying_m: float
    swaying_var_m2: float
    manoeuvring_m: float
    manoeuvring_var_m2: float

    @property
    def sigmas(self) -> float:
        """In standard deviations, for the filter that expected it best; zero or more."""
        return min(
            self.constant_sigmas,
            abs(self.swaying_m) / math.sqrt(self.swaying_var_m2),
            abs(self.manoeuvring_m) / math.sqrt(self.manoeuvring_var_m2),
        )

    @property
    def constant_sigmas(self) -> float:
        """In standard deviations, for the constant-velocity filter; zero or more."""
        return abs(self.constant_m) / math.sqrt(self.constant_var_m2)


def start(distance_m: float, noise_m: float) -> MotionState:
    """Return the state after a first measurement with noise of this standard deviation, above zero."""
    return _start_alike(kalman.start(distance_m, noise_m))


def start_moving(
    distance_m: float, noise_m: float, rate_mps: float, noise_before_m: float, step_s: float
) -> MotionState:
    """Return the state after two measurements that are `step_s` apart; see `kalman.start_moving`."""
    return _start_alike(kalman.start_moving(distance_m, noise_m, rate_mps, noise_before_m, step_s))


def _start_alike(state: FilterState) -> MotionState:
    return MotionState(state, state, state, 0.5, 0.25, 0.25, state)


def predict(state: MotionState, step_s: float, acceleration_mps2: float, autocorrelation: float) -> MotionState:
    """Return the state that is expected in the next frame.

    The mixing step of the IMM: each filter starts from a mixture of all, weighted by how likely the target came to its
    model from another one.

    Args:
        state: What is known now.
        step_s: How much later, zero or more.
        acceleration_mps2: How far the rate usually wanders in one second, as a standard deviation in m/s.
        autocorrelation: Of the noise from one frame to the next, 0 to below 1.
    """
    # Probability that the target kept its model over the step; else it took one by how usual each is. A filter's new
    # prior is then a mixture of itself and of the estimate of all.
    together, kept = state.estimate(), math.exp(-step_s / KEEPS_FOR_S)
    taken = 1.0 - kept
    keeps_constant, keeps_swaying = kept * state.constant_share, kept * state.swaying_share
    keeps_manoeuvring = kept * state.manoeuvring_share
    constant_share, swaying_share = keeps_constant + taken * USUAL[0], keeps_swaying + taken * USUAL[1]
    manoeuvring_share = keeps_manoeuvring + taken * USUAL[2]
    constant = kalman.mix(state.constant, together, keeps_constant / constant_share)
    swaying = kalman.mix(state.swaying, together, keeps_swaying / swaying_share)
    manoeuvring = kalman.mix(state.manoeuvring, together, keeps_manoeuvring / manoeuvring_share)
    return MotionState(
        kalman.predict(constant, step_s, CONSTANT_VELOCITY_SHARE * acceleration_mps2, autocorrelation),
        kalman.predict(swaying, step_s, SWAYING_SHARE * acceleration_mps2, autocorrelation),
        kalman.predict(manoeuvring, step_s, MANOEUVRING_SHARE * acceleration_mps2, autocorrelation),
        constant_share,
        swaying_share,
        manoeuvring_share,
    )


def compare(state: MotionState, distance_m: float, noise_m: float) -> Innovation:
    """Return the innovation of each filter, for what it expected at the measurement's time."""
    return Innovation(
        *kalman.innovation(state.constant, distance_m, noise_m),
        *kalman.innovation(state.swaying, distance_m, noise_m),
        *kalman.innovation(state.manoeuvring, distance_m, noise_m),
    )


def normalise(state: MotionState, innovation: Innovation) -> float:
    """Return the innovation of all filters together in its standard deviations, negative if nearer than expected."""
    _, _, _, constant_share, swaying_share, manoeuvring_share, _ = state
    constant_m, constant_var, swaying_m, swaying_var, manoeuvring_m, manoeuvring_var = innovation
    mean_m = constant_share * constant_m + swaying_share * swaying_m + manoeuvring_share * manoeuvring_m
    # Variance of the mixture: of each model its own, and how far its innovation is from the mean of all.
    square_m2 = (
        constant_share * (constant_var + (constant_m - mean_m) ** 2)
        + swaying_share * (swaying_var + (swaying_m - mean_m) ** 2)
        + manoeuvring_share * (manoeuvring_var + (manoeuvring_m - mean_m) ** 2)
    )
    return mean_m / math.sqrt(square_m2)


def update(state: MotionState, noise_m: float, innovation: Innovation) -> MotionState:
    """Return the state after a measurement with noise of this standard deviation, and its innovation."""
    constant_m, constant_var, swaying_m, swaying_var, manoeuvring_m, manoeuvring_var = innovation
    # Normalised innovations squared (NIS), each chi-square with one degree of freedom if its model is right. The
    # likelihood of a measurement is exp(-NIS / 2) / √variance, but for a constant; the smallest NIS is taken off all so
    # that none underflows.
    constant_square = constant_m * constant_m / constant_var
    swaying_square = swaying_m * swaying_m / swaying_var
    manoeuvring_square = manoeuvring_m * manoeuvring_m / manoeuvring_var
    least = min(constant_square, swaying_square, manoeuvring_square)  # one likelihood stays above zero
    constant_share = state.constant_share * _exp(0.5 * (least - constant_square)) / _sqrt(constant_var)
    swaying_share = state.swaying_share * _exp(0.5 * (least - swaying_square)) / _sqrt(swaying_var)
    manoeuvring_share = state.manoeuvring_share * _exp(0.5 * (least - manoeuvring_square)) / _sqrt(manoeuvring_var)
    total = constant_share + swaying_share + manoeuvring_share
    # A floor of 0.1 % under each share.
    constant_share = (constant_share / total + _SURELY) / (1.0 + 3.0 * _SURELY)
    swaying_share = (swaying_share / total + _SURELY) / (1.0 + 3.0 * _SURELY)
    # Huber: beyond two standard deviations the variance is raised until the normalised square is 4, so that the pull
    # of a measurement does not grow with how far off it is.
    if constant_square > TRUSTED_SQUARE:
        constant_var *= constant_square / TRUSTED_SQUARE
    if swaying_square > TRUSTED_SQUARE:
        swaying_var *= swaying_square / TRUSTED_SQUARE
    constant = kalman.update(state.constant, noise_m, constant_m, constant_var)
    swaying = kalman.update(state.swaying, noise_m, swaying_m, swaying_var)
    manoeuvring = kalman.update(state.manoeuvring, noise_m, manoeuvring_m, manoeuvring_var)
    changing = kalman.mix(swaying, manoeuvring, swaying_share / (1.0 - constant_share))
    together = kalman.mix(constant, changing, constant_share)
    manoeuvring_share = 1.0 - constant_share - swaying_share
    return MotionState(constant, swaying, manoeuvring, constant_share, swaying_share, manoeuvring_share, together)


# Settings for tracking targets, as the configuration says -------------------------------------------------------------


class Tracking(Struct, frozen=True, kw_only=True):
    """Settings for tracking targets.

    Attributes:
        acceleration_mps2: Standard deviation of the target's acceleration that the filter expects.
        autocorrelation: Autocorrelation of the measurement noise from one frame to the next, 0 to below 1.
        gate_sigmas: A measurement further than this from the prediction is an outlier.
        outliers_max: After this many outliers in a row the target is taken to have jumped, and the track starts anew.
        confirm_frames: How many frames a new target must be measured in before it counts.
        coast_s: For how long a prediction stands in for measurements.
        noise_factor: How many times larger than stated the noise of measurements is, to begin with.
        noise_factor_max: How many times larger than that it may be found to be; 1 for not learning.
    """

    acceleration_mps2: float = 2.0
    autocorrelation: float = 0.6
    gate_sigmas: float = 4.0
    outliers_max: int = 5
    confirm_frames: int = 2
    coast_s: float = 0.3
    noise_factor: float = 1.0
    noise_factor_max: float = 6.0


# The true noise of a target, learnt from its measurements: how large it is, how long it lasts, what stays -------------
#
# A detector states the noise that it knows of: pixels, contrast, blur. What it cannot know, a stripe that turns
# with the ball, a finger, a carpet, shows over time. Three things are learnt, slowly and within bounds:
#
# The **level** is the logarithm of the noise's variance over the stated one. It is judged by how far a measurement
# is from the line through the two before it: of that, the target's own motion explains next to nothing at usual
# frame rates, and the motion models explain nothing away. (They would: to a filter for manoeuvres, noise is a
# target that manoeuvres all the time.) Each normalised square moves the level by a small step, up if it is above
# its mean and down if it is below: stochastic approximation (H. Robbins, S. Monro, "A stochastic approximation
# method", Annals of Mathematical Statistics 22 (3), 1951). The step is in proportion to what the noise has in the
# variance, so where motion may explain all, nothing is learnt. A large square counts as `MAX_SQUARE`, and that of
# an outlier half as much (P. Huber, "Robust Statistics", Wiley 1981, chapter 5; F. Hampel's redescending
# influence): an outlier or a leap is not learnt as noise.
#
# The **autocorrelation** from frame to frame is less than configured if successive innovations alternate: those of
# a filter with the right autocorrelation are white (R. Mehra, "On the identification of variances and adaptive
# Kalman filtering", IEEE Transactions on Automatic Control 15 (2), 1970). It is not learnt to be more: a target
# that drifts would look like that.
#
# What **stays**: a figure that varies clearly less than stated does not err less for that. Its error is the same in
# every frame, as that of an edge under a compression that does not change, and no filter averages it away. That
# share of the stated variance is passed on as it is.

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
