"""Two filters side by side: one for a target that keeps its speed, one for a target that changes it.

A filter for the calm target smooths much, and lags behind one that starts or stops. A filter for the moving target
follows, and hardly smooths. Which of them is right at a moment is told by which one expected the measurements better.
This is the interacting multiple model estimator: H. Blom and Y. Bar-Shalom, "The interacting multiple model algorithm
for systems with Markovian switching coefficients", IEEE Transactions on Automatic Control 33 (8), 1988; Bar-Shalom, Li,
Kirubarajan, "Estimation with Applications to Tracking and Navigation", Wiley 2001, section 11.6.6.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from stadimeter.core.tracking import filter as kalman
from stadimeter.core.tracking.filter import FilterState

CALM_SHARE, ABRUPT_SHARE = 0.025, 2.0
"""How far the rate of a calm target wanders, and of one that changes its speed, as a share of what is usual."""
CALM_FOR_S, ABRUPT_FOR_S = 20.0, 0.4
"""For how long, on average, a target stays calm, and for how long it goes on changing its speed."""

_USUALLY_CALM = CALM_FOR_S / (CALM_FOR_S + ABRUPT_FOR_S)
_CHANGES_PER_S = 1 / CALM_FOR_S + 1 / ABRUPT_FOR_S
_SURELY = 1e-3
"""Neither filter is ever written off more than this: a target may change at any time."""
_MOST_LOG_ODDS = 50.0


class MotionState(NamedTuple):
    """What both filters know at one moment.

    Attributes:
        calm: The filter of a target that keeps its speed.
        abrupt: The filter of a target that changes it.
        calm_share: How likely the target keeps its speed, 0 to 1.
    """

    calm: FilterState
    abrupt: FilterState
    calm_share: float

    def estimate(self) -> FilterState:
        """Return what both say together.

        Returns:
            Distance and rate with their variances.
        """
        return kalman.mixed(self.calm, self.abrupt, self.calm_share)


class Surprise(NamedTuple):
    """How far a measurement is from what each filter expected, and the variance of such differences.

    Attributes:
        calm_m: The difference from what the filter of the calm target expected; negative if nearer.
        calm_var_m2: The variance of such differences.
        abrupt_m: The same for the filter of the target that changes its speed.
        abrupt_var_m2: The variance of such differences.
    """

    calm_m: float
    calm_var_m2: float
    abrupt_m: float
    abrupt_var_m2: float

    @property
    def sigmas(self) -> float:
        """In standard deviations, for the filter that is surprised less; zero or more."""
        return min(self.calm_sigmas, abs(self.abrupt_m) / math.sqrt(self.abrupt_var_m2))

    @property
    def calm_sigmas(self) -> float:
        """In standard deviations, for the filter of the calm target; zero or more."""
        return abs(self.calm_m) / math.sqrt(self.calm_var_m2)


def start(distance_m: float, noise_m: float) -> MotionState:
    """Return the state after the first measurement.

    Args:
        distance_m: The measured distance.
        noise_m: Standard deviation of its noise, above zero.

    Returns:
        The state.
    """
    state = kalman.start(distance_m, noise_m)
    return MotionState(calm=state, abrupt=state, calm_share=0.5)


def predict(state: MotionState, step_s: float, acceleration_mps2: float, correlation: float) -> MotionState:
    """Return what is expected of the next frame.

    Args:
        state: What is known now.
        step_s: How much later, zero or more.
        acceleration_mps2: How far the rate usually wanders in one second, as a standard deviation in m/s.
        correlation: Of the noise from one frame to the next, 0 to below 1.

    Returns:
        The expectation, less sure than before.
    """
    calm, abrupt, share = state
    as_before = math.exp(-step_s * _CHANGES_PER_S)
    stays_calm = share * (_USUALLY_CALM + (1.0 - _USUALLY_CALM) * as_before)
    stays_abrupt = (1.0 - share) * (1.0 - _USUALLY_CALM + _USUALLY_CALM * as_before)
    share = stays_calm + (1.0 - share) - stays_abrupt
    from_calm = kalman.mixed(calm, abrupt, stays_calm / share)
    from_abrupt = kalman.mixed(abrupt, calm, stays_abrupt / (1.0 - share))
    return MotionState(
        kalman.predict(from_calm, step_s, CALM_SHARE * acceleration_mps2, correlation),
        kalman.predict(from_abrupt, step_s, ABRUPT_SHARE * acceleration_mps2, correlation),
        share,
    )


def compare(state: MotionState, distance_m: float, noise_m: float) -> Surprise:
    """Return how far a measurement is from the expectation.

    Args:
        state: The expectation at the measurement's time.
        distance_m: The measured distance.
        noise_m: Standard deviation of its noise, above zero.

    Returns:
        How much each filter is surprised.
    """
    calm_m, calm_var_m2 = kalman.surprise(state.calm, distance_m, noise_m)
    abrupt_m, abrupt_var_m2 = kalman.surprise(state.abrupt, distance_m, noise_m)
    return Surprise(calm_m, calm_var_m2, abrupt_m, abrupt_var_m2)


def update(state: MotionState, noise_m: float, surprise: Surprise) -> MotionState:
    """Return what is known after a measurement.

    Args:
        state: The expectation at the measurement's time.
        noise_m: Standard deviation of the measurement's noise, above zero.
        surprise: How far the measurement is from the expectation, as `compare` says.

    Returns:
        The state.
    """
    calm, abrupt, share = state
    calm_m, calm_var, abrupt_m, abrupt_var = surprise
    likelier = 0.5 * (abrupt_m * abrupt_m / abrupt_var - calm_m * calm_m / calm_var + math.log(abrupt_var / calm_var))
    odds = share / (1.0 - share) * math.exp(min(max(likelier, -_MOST_LOG_ODDS), _MOST_LOG_ODDS))
    return MotionState(
        kalman.update(calm, noise_m, calm_m, calm_var),
        kalman.update(abrupt, noise_m, abrupt_m, abrupt_var),
        min(max(odds / (1.0 + odds), _SURELY), 1.0 - _SURELY),
    )
