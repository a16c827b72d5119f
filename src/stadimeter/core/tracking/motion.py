"""Two filters side by side: one for a target that keeps its speed, one for a target that changes it.

The constant-velocity filter smooths much, and lags behind a target that starts or stops. The manoeuvring filter
follows, and hardly smooths. The innovations of each measurement say which of them is right at the moment.
This is the interacting multiple model estimator: H. Blom and Y. Bar-Shalom, "The interacting multiple model algorithm
for systems with Markovian switching coefficients", IEEE Transactions on Automatic Control 33 (8), 1988; Bar-Shalom, Li,
Kirubarajan, "Estimation with Applications to Tracking and Navigation", Wiley 2001, section 11.6.6.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from stadimeter.core.tracking import filter as kalman
from stadimeter.core.tracking.filter import FilterState

CONSTANT_VELOCITY_SHARE, MANOEUVRING_SHARE = 0.025, 2.0
"""Process noise of each model, as a share of the configured acceleration."""
CONSTANT_VELOCITY_FOR_S, MANOEUVRING_FOR_S = 20.0, 0.4
"""Mean time that a target keeps to each model, from which its transition probabilities follow."""

_USUALLY_CONSTANT = CONSTANT_VELOCITY_FOR_S / (CONSTANT_VELOCITY_FOR_S + MANOEUVRING_FOR_S)
_CHANGES_PER_S = 1 / CONSTANT_VELOCITY_FOR_S + 1 / MANOEUVRING_FOR_S
_SURELY = 1e-3
"""Neither filter is ever written off more than this: a target may change at any time."""
_MOST_LOG_ODDS = 50.0


class MotionState(NamedTuple):
    """What both filters know at one moment.

    Attributes:
        constant: The constant-velocity filter.
        manoeuvring: The filter of a target that changes its speed.
        constant_share: Probability of the constant-velocity model, 0 to 1.
    """

    constant: FilterState
    manoeuvring: FilterState
    constant_share: float

    def estimate(self) -> FilterState:
        """Return the mean and covariance of both, weighted by their probabilities."""
        return kalman.mixed(self.constant, self.manoeuvring, self.constant_share)


class Innovation(NamedTuple):
    """How far a measurement is from what each filter expected, and the variance of such differences.

    Attributes:
        constant_m: The innovation of the constant-velocity filter; negative if the target is nearer than expected.
        constant_var_m2: The variance of such differences.
        manoeuvring_m: The same for the manoeuvring filter.
        manoeuvring_var_m2: The variance of such differences.
    """

    constant_m: float
    constant_var_m2: float
    manoeuvring_m: float
    manoeuvring_var_m2: float

    @property
    def sigmas(self) -> float:
        """In standard deviations, for the filter that is innovationd less; zero or more."""
        return min(self.constant_sigmas, abs(self.manoeuvring_m) / math.sqrt(self.manoeuvring_var_m2))

    @property
    def constant_sigmas(self) -> float:
        """In standard deviations, for the constant-velocity filter; zero or more."""
        return abs(self.constant_m) / math.sqrt(self.constant_var_m2)


def start(distance_m: float, noise_m: float) -> MotionState:
    """Return the state after a first measurement with noise of this standard deviation, above zero."""
    state = kalman.start(distance_m, noise_m)
    return MotionState(constant=state, manoeuvring=state, constant_share=0.5)


def predict(state: MotionState, step_s: float, acceleration_mps2: float, correlation: float) -> MotionState:
    """Return what is expected of the next frame.

    The mixing step of the IMM: each filter starts from a mixture of both, weighted by how likely the target came to its
    model from the other one.

    Args:
        state: What is known now.
        step_s: How much later, zero or more.
        acceleration_mps2: How far the rate usually wanders in one second, as a standard deviation in m/s.
        correlation: Of the noise from one frame to the next, 0 to below 1.
    """
    constant, manoeuvring, share = state
    as_before = math.exp(-step_s * _CHANGES_PER_S)
    stays_constant = share * (_USUALLY_CONSTANT + (1.0 - _USUALLY_CONSTANT) * as_before)
    stays_manoeuvring = (1.0 - share) * (1.0 - _USUALLY_CONSTANT + _USUALLY_CONSTANT * as_before)
    share = stays_constant + (1.0 - share) - stays_manoeuvring
    from_constant = kalman.mixed(constant, manoeuvring, stays_constant / share)
    from_manoeuvring = kalman.mixed(manoeuvring, constant, stays_manoeuvring / (1.0 - share))
    return MotionState(
        kalman.predict(from_constant, step_s, CONSTANT_VELOCITY_SHARE * acceleration_mps2, correlation),
        kalman.predict(from_manoeuvring, step_s, MANOEUVRING_SHARE * acceleration_mps2, correlation),
        share,
    )


def compare(state: MotionState, distance_m: float, noise_m: float) -> Innovation:
    """Return the innovation of each filter, for what it expected at the measurement's time."""
    constant_m, constant_var_m2 = kalman.innovation(state.constant, distance_m, noise_m)
    manoeuvring_m, manoeuvring_var_m2 = kalman.innovation(state.manoeuvring, distance_m, noise_m)
    return Innovation(constant_m, constant_var_m2, manoeuvring_m, manoeuvring_var_m2)


def update(state: MotionState, noise_m: float, innovation: Innovation) -> MotionState:
    """Return what is known after a measurement with noise of this standard deviation, and its innovation."""
    constant, manoeuvring, share = state
    constant_m, constant_var, manoeuvring_m, manoeuvring_var = innovation
    # Half the difference of the squared normalised innovations, and of the logarithms of their variances.
    squared = manoeuvring_m * manoeuvring_m / manoeuvring_var - constant_m * constant_m / constant_var
    likelier = 0.5 * (squared + math.log(manoeuvring_var / constant_var))
    odds = share / (1.0 - share) * math.exp(min(max(likelier, -_MOST_LOG_ODDS), _MOST_LOG_ODDS))
    return MotionState(
        kalman.update(constant, noise_m, constant_m, constant_var),
        kalman.update(manoeuvring, noise_m, manoeuvring_m, manoeuvring_var),
        min(max(odds / (1.0 + odds), _SURELY), 1.0 - _SURELY),
    )
