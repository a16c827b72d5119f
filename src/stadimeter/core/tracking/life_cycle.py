"""The life of a target: searching (tentative), tracking (confirmed), coasting, lost.

::

    searching ──confirmed──▶ tracking ──a frame without it──▶ coasting ──for too long──▶ lost
                                 ▲            measured again ◀────┘                        │
                                 └────────────────────── confirmed again ──────────────────┘

A new target must be measured in some frames in a row before it counts, so that one false detection moves nothing. An
outlier is refused like a frame without the target; several in a row mean that the target really jumped, and the track
starts anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.core.plan import Tracking
from stadimeter.core.track import Track, TrackStatus
from stadimeter.core.tracking import motion
from stadimeter.core.tracking.filter import NOISE_FLOOR_M
from stadimeter.core.tracking.motion import Innovation, MotionState

CONSTANT_VELOCITY_AT_LEAST = 0.5
"""A target that keeps its speed has a probability of the constant-velocity model above this."""

RESTLESS_S = 2.0
"""A target that made a leap may make another for so long, and is believed at once."""

_UNEXPECTED = Innovation(constant_m=math.inf, constant_var_m2=1.0, manoeuvring_m=math.inf, manoeuvring_var_m2=1.0)
"""The innovation where nothing was expected."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sighting:
    """A measurement that may be used: every figure is there and finite.

    Attributes:
        at_s: Capture time.
        distance_m: The distance.
        noise_m: The part of the standard deviation that differs from frame to frame.
        scale_sigma: The part of the standard deviation that no filter can reduce, as a share of the distance.
        depth_share: Depth divided by distance.
        bearing_rad: The bearing.
        elevation_rad: The elevation.
    """

    at_s: float
    distance_m: float
    noise_m: float
    scale_sigma: float
    depth_share: float
    bearing_rad: float
    elevation_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackState:
    """All that is remembered of a target from one cycle to the next.

    Attributes:
        filter: None before the first sighting.
        filter_at_s: The capture time that the filters' figures are for.
        sighting: The last sighting that was accepted.
        confirmations: How many frames in a row a target that does not count yet was seen in.
        suspect: What was seen in the newest frame, if it may be an error; None if it is not.
        leapt_at_s: When the target last really made a leap.
    """

    track: Track
    filter: MotionState | None = None
    filter_at_s: float = -math.inf
    sighting: Sighting | None = None
    confirmations: int = 0
    suspect: Sighting | None = None
    leapt_at_s: float = -math.inf


def new_track(target: str) -> TrackState:
    """Return the state of a target that was never seen."""
    return TrackState(track=Track(target=target))


def step(state: TrackState, measurement: Measurement | None, now_s: float, settings: Tracking) -> TrackState:
    """Take in what one cycle knows of the target.

    Args:
        state: What was known before.
        measurement: What the new frame says of the target; None in a cycle without a new frame.
        now_s: The run's monotonic clock, for noticing that nothing comes.
        settings: How to track.
    """
    after = _stepped(state, measurement, now_s, settings)
    if after.leapt_at_s < state.leapt_at_s:
        after = replace(after, leapt_at_s=state.leapt_at_s)
    if state.track.since_s is not None and after.track.is_valid is state.track.is_valid:
        return after
    return replace(after, track=replace(after.track, since_s=now_s))


def after_gap(state: TrackState, now_s: float, reason: str) -> TrackState:
    """Return a target as it is after time in which nobody looked: what was known of it is too old to go on with.

    It must be confirmed anew, and for how long it is in sight or out of sight is counted from now.

    Args:
        state: What was known before.
        now_s: The run's monotonic clock.
        reason: Why nobody looked.
    """
    track = replace(state.track, since_s=now_s)
    if track.is_valid:
        track = replace(track, status=TrackStatus.LOST, rejected=0, reason=reason)
    return replace(state, track=track, confirmations=0, suspect=None)


def _stepped(state: TrackState, measurement: Measurement | None, now_s: float, settings: Tracking) -> TrackState:
    if measurement is None:
        return _lose_if_late(state, now_s, settings, "no new frame")
    if measurement.captured_at_s <= state.filter_at_s:
        return state  # a repeated or late frame tells nothing new
    sighting = sighting_of(measurement)
    if sighting is None:
        return _miss(state, measurement, settings)
    if state.track.is_valid:
        return _follow(state, sighting, settings)
    return _consider(state, sighting, settings)


def sighting_of(measurement: Measurement) -> Sighting | None:
    """Return the figures of a measurement; None if the target was not measured or a figure is not finite."""
    distance_m, depth_m, sigma_m = measurement.distance_m, measurement.depth_m, measurement.sigma_m
    noise_m, bearing_rad, elevation_rad = measurement.noise_m, measurement.bearing_rad, measurement.elevation_rad
    if measurement.status is not MeasurementStatus.MEASURED:
        return None
    if distance_m is None or depth_m is None or sigma_m is None:
        return None
    if noise_m is None or bearing_rad is None or elevation_rad is None:
        return None
    if not math.isfinite(distance_m + depth_m + sigma_m + noise_m + bearing_rad + elevation_rad) or distance_m <= 0:
        return None
    return Sighting(
        at_s=measurement.captured_at_s,
        distance_m=distance_m,
        noise_m=max(noise_m, NOISE_FLOOR_M),
        scale_sigma=math.sqrt(max(0.0, sigma_m**2 - noise_m**2)) / distance_m,
        depth_share=depth_m / distance_m,
        bearing_rad=bearing_rad,
        elevation_rad=elevation_rad,
    )


def _lose_if_late(state: TrackState, now_s: float, settings: Tracking, reason: str) -> TrackState:
    track = state.track
    if not track.is_valid or track.measured_at_s is None:
        return state
    unseen_s = now_s - track.measured_at_s
    if unseen_s <= settings.coast_s:
        return state
    reason = f"not measured for {unseen_s:.2f} s, limit {settings.coast_s:.2f} s: {reason}"
    track = replace(track, status=TrackStatus.LOST, rejected=0, reason=reason)  # what was refused is no news any more
    return replace(state, track=track, confirmations=0)


def _miss(state: TrackState, measurement: Measurement, settings: Tracking) -> TrackState:
    """A frame without the target: predict for a moment, then give up."""
    reason = measurement.reason or "the measurement holds no usable figures"
    if not state.track.is_valid:
        return replace(state, track=replace(state.track, reason=reason), confirmations=0)
    at_s = measurement.captured_at_s
    return _coast(state, _predicted(state, at_s, settings), at_s, settings, reason)


def _consider(state: TrackState, sighting: Sighting, settings: Tracking) -> TrackState:
    """The target is seen, but does not count yet."""
    moved = _predicted(state, sighting.at_s, settings)
    innovation = _innovation(moved, sighting)
    agrees = state.confirmations > 0 and innovation.sigmas <= settings.gate_sigmas
    seen = _updated(moved, sighting, innovation) if agrees else _started(sighting)
    confirmations = state.confirmations + 1 if agrees else 1
    if confirmations >= settings.confirm_frames:
        return _shown(state.track, seen, sighting, TrackStatus.TRACKING)
    reason = f"seen in {confirmations} of the {settings.confirm_frames} frames in a row that it takes"
    return TrackState(
        track=replace(state.track, reason=reason),
        filter=seen,
        filter_at_s=sighting.at_s,
        sighting=sighting,
        confirmations=confirmations,
    )


def _follow(state: TrackState, sighting: Sighting, settings: Tracking) -> TrackState:
    """The target is seen while it counts: take the sighting in, unless it is an outlier."""
    moved = _predicted(state, sighting.at_s, settings)
    innovation = _innovation(moved, sighting)
    is_outlier = innovation.sigmas > settings.gate_sigmas
    if not is_outlier and not _is_suspect(state, moved, sighting, innovation, settings):
        shown = _shown(state.track, _updated(moved, sighting, innovation), sighting, TrackStatus.TRACKING)
        return shown if state.suspect is None else replace(shown, leapt_at_s=sighting.at_s)
    rejected = state.track.rejected + 1
    if rejected > settings.outliers_max:
        return _shown(state.track, _started(sighting), sighting, TrackStatus.TRACKING)
    if is_outlier:
        far = f"{innovation.sigmas:.1f} standard deviations from what was expected, limit {settings.gate_sigmas:.1f}"
    else:
        far = "far from what was expected of a target at rest or a steady speed; the next frame tells"
    reason = f"outlier {rejected} of {settings.outliers_max}: {sighting.distance_m:.2f} m is {far}"
    refused = replace(state, track=replace(state.track, rejected=rejected))
    coasting = _coast(refused, moved, sighting.at_s, settings, reason)
    return coasting if is_outlier else replace(coasting, suspect=sighting)


def _is_suspect(
    state: TrackState, moved: MotionState | None, sighting: Sighting, innovation: Innovation, settings: Tracking
) -> bool:
    """Return whether a target at constant velocity seems to have made a leap that one wrong measurement could feign.

    Near the camera the noise is so small that a manoeuvre allows for far more than the noise does: a wrong measurement
    within that would be believed at once. One frame decides: if the next one is there too, the target did move.
    """
    if not settings.outliers_max or innovation.constant_sigmas <= settings.gate_sigmas:
        return False
    if (
        moved is None
        or moved.constant_share < CONSTANT_VELOCITY_AT_LEAST
        or sighting.at_s - state.leapt_at_s < RESTLESS_S
    ):
        return False
    expected_m = sighting.distance_m - innovation.constant_m
    # A target that really starts goes on the same way. Two errors in a row hardly ever agree.
    return state.suspect is None or (state.suspect.distance_m - expected_m) * innovation.constant_m <= 0


def _innovation(inputs: MotionState | None, sighting: Sighting) -> Innovation:
    if inputs is None:
        return _UNEXPECTED
    return motion.compare(inputs, sighting.distance_m, sighting.noise_m)


def _predicted(state: TrackState, at_s: float, settings: Tracking) -> MotionState | None:
    if state.filter is None:
        return None
    return motion.predict(state.filter, at_s - state.filter_at_s, settings.acceleration_mps2, settings.correlation)


def _started(sighting: Sighting) -> MotionState:
    return motion.start(sighting.distance_m, sighting.noise_m)


def _updated(inputs: MotionState | None, sighting: Sighting, innovation: Innovation) -> MotionState:
    return motion.update(inputs, sighting.noise_m, innovation) if inputs else _started(sighting)


def _coast(state: TrackState, moved: MotionState | None, at_s: float, settings: Tracking, reason: str) -> TrackState:
    """Show what is expected, as long as that may stand in for measurements."""
    if moved is None or state.sighting is None:
        return state
    shown = _shown(state.track, moved, state.sighting, TrackStatus.COASTING, at_s=at_s, reason=reason)
    return _lose_if_late(shown, at_s, settings, reason)


def _shown(
    before: Track,
    inputs: MotionState,
    sighting: Sighting,
    status: TrackStatus,
    *,
    at_s: float | None = None,
    reason: str = "",
) -> TrackState:
    """Put what the filter knows into the track that others see."""
    as_of_s = sighting.at_s if at_s is None else at_s
    together = inputs.estimate()
    noise_m = math.sqrt(together.var_distance_m2)
    track = Track(
        target=before.target,
        status=status,
        distance_m=together.distance_m,
        depth_m=together.distance_m * sighting.depth_share,
        closing_mps=-together.rate_mps,
        sigma_m=math.hypot(noise_m, together.distance_m * sighting.scale_sigma),
        noise_m=noise_m,
        closing_sigma_mps=math.sqrt(together.var_rate_m2ps2),
        bearing_rad=sighting.bearing_rad,
        elevation_rad=sighting.elevation_rad,
        as_of_s=as_of_s,
        measured_at_s=sighting.at_s,
        rejected=0 if status is TrackStatus.TRACKING else before.rejected,
        reason=reason,
        since_s=before.since_s,
        closing_cov_m2ps=-together.cov_m2ps,
    )
    return TrackState(track=track, filter=inputs, filter_at_s=as_of_s, sighting=sighting)
