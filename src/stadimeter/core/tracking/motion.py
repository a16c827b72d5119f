"""Three filters side by side: for a target that keeps its speed, one that sways, and one that manoeuvres.

The constant-velocity filter smooths much, and lags behind a target that starts or stops. The manoeuvring filter
follows, and hardly smooths. The swaying filter is for what lies between them: a person who shifts from foot to foot, a
ball in a hand. With two filters only, such a target is neither: it is followed no better than by the raw measurements,
and its stated error is a third too small. The innovations of each measurement say which filter is right at the moment.
This is the interacting multiple model estimator: H. Blom and Y. Bar-Shalom, "The interacting multiple model algorithm
for systems with Markovian switching coefficients", IEEE Transactions on Automatic Control 33 (8), 1988; Bar-Shalom, Li,
Kirubarajan, "Estimation with Applications to Tracking and Navigation", Wiley 2001, section 11.6.6.

A target keeps to its model for a while, and then takes any of them by how usual each is. With transitions of this form
a filter's mixture is one of itself and of the estimate of all together, which is worked out for each frame anyway.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from stadimeter.core.tracking import filter as kalman
from stadimeter.core.tracking.filter import FilterState

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
# estimate of a mean, see `stadimeter.core.tracking.noise_level`. Noise with heavy tails counts for what it is worth.
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
