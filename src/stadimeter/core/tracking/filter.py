"""A Kalman filter on distance and its rate of change, for noise that lasts from frame to frame.

The state is the distance d in metres, its rate v in m/s, and the noise u of the newest measurement in units of its
standard deviation. Between frames the rate wanders: white-noise acceleration of density q, so that the rate's standard
deviation grows by ``acceleration_mps2`` in the first second. This continuous form makes one prediction over 2 s the
same as two over 1 s, so the frame rate does not matter. Source of the matrices: Bar-Shalom, Li, Kirubarajan,
"Estimation with Applications to Tracking and Navigation", Wiley 2001, section 6.2.2 (continuous white noise
acceleration model); section 8.2 for noise that is correlated, which becomes a part of the state.

A measurement is d + s·u + e, where u keeps the share ρ of itself from one frame to the next and e is new in each frame.
Frames that err together carry less news than their number says, and are also better compared with each other than
their standard deviation says. A filter without that memory, whose measurements count as (1+ρ)/(1−ρ) times as unsure
instead, is right for a mean over many frames only: following a moving target, it states nearly twice its true error.

Every measurement brings its own standard deviation, which for a target of known size grows with the square of the
distance. With a constant one instead, errors are a third larger and an abrupt stop overshoots six times as far.
"""

# ruff: noqa: FURB136 - these run several times a frame, and `max` takes five times as long

from __future__ import annotations

import math
from typing import NamedTuple

# Standard deviation of the rate of a target that was just seen for the first time.
RATE_AT_START_MPS = 1.5

# No measurement is taken to be better than this; a claim of zero would make the filter deaf.
NOISE_FLOOR_M = 1e-4

# The share of the noise's variance that is new in each frame, whatever the autocorrelation of the rest.
FRESH_SHARE = 0.1

_KEPT, _FRESH = math.sqrt(1 - FRESH_SHARE), FRESH_SHARE


class FilterState(NamedTuple):
    """State and covariance of the filter at one moment. A tuple, because several are made for each frame.

    Attributes:
        distance_m: The distance.
        rate_mps: Its rate of change; negative when approaching.
        noise: What lasts of the newest measurement's noise, in standard deviations.
        var_distance_m2: Variance of the distance.
        cov_m2ps: Covariance of distance and rate.
        var_rate_m2ps2: Variance of the rate.
        cov_noise_m: Covariance of distance and noise.
        cov_rate_noise_mps: Covariance of rate and noise.
        var_noise: Variance of the noise.
    """

    distance_m: float
    rate_mps: float
    noise: float
    var_distance_m2: float
    cov_m2ps: float
    var_rate_m2ps2: float
    cov_noise_m: float
    cov_rate_noise_mps: float
    var_noise: float


def start(distance_m: float, noise_m: float) -> FilterState:
    """Return the state after a first measurement: at that distance, and at rest, but not sure of that."""
    return FilterState(
        distance_m=distance_m,
        rate_mps=0.0,
        noise=0.0,
        var_distance_m2=noise_m * noise_m,
        cov_m2ps=0.0,
        var_rate_m2ps2=RATE_AT_START_MPS**2,
        cov_noise_m=-noise_m * _KEPT,
        cov_rate_noise_mps=0.0,
        var_noise=1.0,
    )


def start_moving(
    distance_m: float, noise_m: float, rate_mps: float, noise_before_m: float, step_s: float
) -> FilterState:
    """Return the state after two measurements, with the rate that they give.

    Args:
        distance_m: The second one.
        noise_m: Standard deviation of its noise.
        rate_mps: Their difference divided by `step_s`.
        noise_before_m: Standard deviation of the noise of the first one.
        step_s: The time between them, above zero.
    """
    # Two-point differencing: the rate's variance is (σ₁² + σ₂²) / t², and it shares the noise of the second distance,
    # hence the covariances.
    return start(distance_m, noise_m)._replace(
        rate_mps=rate_mps,
        cov_m2ps=noise_m * noise_m / step_s,
        var_rate_m2ps2=(noise_m * noise_m + noise_before_m * noise_before_m) / (step_s * step_s),
        cov_rate_noise_mps=-noise_m * _KEPT / step_s,
    )


def predict(state: FilterState, step_s: float, acceleration_mps2: float, autocorrelation: float) -> FilterState:
    """Return the state that is expected in the next frame.

    Args:
        state: What is known now.
        step_s: How much later, zero or more.
        acceleration_mps2: How far the rate may wander in one second, as a standard deviation in m/s.
        autocorrelation: ρ, of the noise from one frame to the next, 0 to below 1.
    """
    distance_m, rate_mps, noise, var_distance, cov, var_rate, cov_noise, cov_rate_noise, var_noise = state
    distance_m += step_s * rate_mps
    # Process noise of white acceleration with density q = a²: Q = q [[t³/3, t²/2], [t²/2, t]] in m², m²/s, m²/s². The
    # noise decays to ρ of itself and is filled up to a variance of 1.
    wander = acceleration_mps2 * acceleration_mps2 * step_s
    cov_rate = cov + step_s * var_rate
    return FilterState(
        distance_m if distance_m > 0.0 else 0.0,
        rate_mps,
        autocorrelation * noise,
        var_distance + step_s * (cov + cov_rate + wander * step_s / 3),
        cov_rate + wander * step_s / 2,
        var_rate + wander,
        autocorrelation * (cov_noise + step_s * cov_rate_noise),
        autocorrelation * cov_rate_noise,
        1.0 - autocorrelation * autocorrelation * (1.0 - var_noise),
    )


def innovation(state: FilterState, distance_m: float, noise_m: float) -> tuple[float, float]:
    """Return the innovation of a measurement in metres, negative if nearer than expected, and its variance in m².

    Args:
        state: The expectation at the measurement's time.
        distance_m: The measured distance.
        noise_m: Standard deviation of its noise, above zero.
    """
    # S = H P H' + R with H = (1, 0, s √0.9): what lasts of the noise is measured with the distance. The 0.1 that is new
    # in each frame is R, so S never vanishes.
    kept_m = noise_m * _KEPT
    var_kept = kept_m * (2 * state.cov_noise_m + kept_m * state.var_noise)
    expected_m = state.distance_m + kept_m * state.noise
    return distance_m - expected_m, state.var_distance_m2 + var_kept + _FRESH * noise_m * noise_m


def update(state: FilterState, noise_m: float, error_m: float, error_var_m2: float) -> FilterState:
    """Return the state that is known after a measurement.

    Args:
        state: The expectation at the measurement's time.
        noise_m: Standard deviation of the measurement's noise, above zero.
        error_m: Its innovation.
        error_var_m2: The variance of that.
    """
    kept_m = noise_m * _KEPT
    distance_m, rate_mps, noise, var_distance, cov, var_rate, cov_noise, cov_rate_noise, var_noise = state
    # P H', column by column; divided by S it is the gain K, and P - K (P H')' the new covariance. Variances are held at
    # 0 or above against rounding.
    seen_distance = var_distance + kept_m * cov_noise
    seen_rate = cov + kept_m * cov_rate_noise
    seen_noise = cov_noise + kept_m * var_noise
    gain, rate_gain, noise_gain = seen_distance / error_var_m2, seen_rate / error_var_m2, seen_noise / error_var_m2
    distance_m += gain * error_m
    var_distance -= gain * seen_distance
    var_rate -= rate_gain * seen_rate
    var_noise -= noise_gain * seen_noise
    return FilterState(
        distance_m if distance_m > 0.0 else 0.0,
        rate_mps + rate_gain * error_m,
        noise + noise_gain * error_m,
        var_distance if var_distance > 0.0 else 0.0,
        cov - gain * seen_rate,
        var_rate if var_rate > 0.0 else 0.0,
        cov_noise - gain * seen_noise,
        cov_rate_noise - rate_gain * seen_noise,
        var_noise if var_noise > 0.0 else 0.0,
    )


def mix(one: FilterState, other: FilterState, share: float) -> FilterState:
    """Return the state with the mean and the covariance of two, of which `one` has the probability `share`."""
    # Moments of a mixture: the mean of the covariances, and the spread of the means, p (1 - p) d d'.
    rest = 1.0 - share
    d1, v1, u1, dd1, dv1, vv1, du1, vu1, uu1 = one
    d2, v2, u2, dd2, dv2, vv2, du2, vu2, uu2 = other
    d, v, u = d1 - d2, v1 - v2, u1 - u2  # how far the two are apart, which makes both of them less sure
    apart = share * rest
    return FilterState(
        d2 + share * d,
        v2 + share * v,
        u2 + share * u,
        share * dd1 + rest * dd2 + apart * d * d,
        share * dv1 + rest * dv2 + apart * d * v,
        share * vv1 + rest * vv2 + apart * v * v,
        share * du1 + rest * du2 + apart * d * u,
        share * vu1 + rest * vu2 + apart * v * u,
        share * uu1 + rest * uu2 + apart * u * u,
    )
