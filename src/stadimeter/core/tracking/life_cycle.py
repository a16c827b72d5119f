"""The life of a target: searching, tracking, coasting, lost.

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
from stadimeter.core.tracking import filter as kalman
from stadimeter.core.tracking.filter import FilterState


@dataclass(frozen=True, slots=True, kw_only=True)
class Sighting:
    """A measurement that may be used: every figure is there and finite.

    Attributes:
        at_s: Capture time.
        distance_m: The distance.
        variance_m2: The variance that the filter uses, correlation from frame to frame allowed for.
        scale_sigma: The part of the standard deviation that no filter can reduce, as a share of the distance.
        depth_share: Depth divided by distance.
        bearing_rad: The bearing.
        elevation_rad: The elevation.
    """

    at_s: float
    distance_m: float
    variance_m2: float
    scale_sigma: float
    depth_share: float
    bearing_rad: float
    elevation_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackState:
    """All that is remembered of a target from one cycle to the next.

    Attributes:
        track: What the rest of the program sees.
        filter: The filter; None before the first sighting.
        filter_at_s: The capture time that the filter's figures are for.
        sighting: The last sighting that was accepted.
        confirmations: How many frames in a row a target that does not count yet was seen in.
    """

    track: Track
    filter: FilterState | None = None
    filter_at_s: float = -math.inf
    sighting: Sighting | None = None
    confirmations: int = 0


def new_track(target: str) -> TrackState:
    """Return the state of a target that was never seen.

    Args:
        target: The target's name.

    Returns:
        The state.
    """
    return TrackState(track=Track(target=target))


def step(state: TrackState, measurement: Measurement | None, now_s: float, settings: Tracking) -> TrackState:
    """Take in what one cycle knows of the target.

    Args:
        state: What was known before.
        measurement: What the new frame says of the target; None in a cycle without a new frame.
        now_s: The run's monotonic clock, for noticing that nothing comes.
        settings: How to track.

    Returns:
        What is known now.
    """
    if measurement is None:
        return _lose_if_late(state, now_s, settings, "no new frame")
    if measurement.captured_at_s <= state.filter_at_s:
        return state  # a repeated or late frame tells nothing new
    sighting = sighting_of(measurement, settings)
    if sighting is None:
        return _miss(state, measurement, settings)
    if state.track.is_valid:
        return _follow(state, sighting, settings)
    return _consider(state, sighting, settings)


def sighting_of(measurement: Measurement, settings: Tracking) -> Sighting | None:
    """Return the measurement if it may be used.

    Args:
        measurement: What a frame says of the target.
        settings: How to track.

    Returns:
        The figures, or None if the target was not measured or a figure is not finite.
    """
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
        variance_m2=kalman.variance_of(noise_m, settings.correlation),
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
    return replace(state, track=replace(track, status=TrackStatus.LOST, reason=reason), confirmations=0)


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
    agrees = state.confirmations > 0 and _surprise(moved, sighting) <= settings.gate_sigmas
    seen = _updated(moved, sighting) if agrees else _started(sighting)
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
    surprise = _surprise(moved, sighting)
    if surprise <= settings.gate_sigmas:
        return _shown(state.track, _updated(moved, sighting), sighting, TrackStatus.TRACKING)
    rejected = state.track.rejected + 1
    if rejected > settings.outliers_max:
        return _shown(state.track, _started(sighting), sighting, TrackStatus.TRACKING)
    reason = (
        f"outlier {rejected} of {settings.outliers_max}: {sighting.distance_m:.2f} m is {surprise:.1f} standard "
        f"deviations from what was expected, limit {settings.gate_sigmas:.1f}"
    )
    return _coast(replace(state, track=replace(state.track, rejected=rejected)), moved, sighting.at_s, settings, reason)


def _surprise(known: FilterState | None, sighting: Sighting) -> float:
    if known is None:
        return math.inf
    return kalman.surprise_sigmas(known, sighting.distance_m, sighting.variance_m2)


def _predicted(state: TrackState, at_s: float, settings: Tracking) -> FilterState | None:
    if state.filter is None:
        return None
    return kalman.predict(state.filter, at_s - state.filter_at_s, settings.acceleration_mps2)


def _started(sighting: Sighting) -> FilterState:
    return kalman.start(sighting.distance_m, sighting.variance_m2)


def _updated(known: FilterState | None, sighting: Sighting) -> FilterState:
    return kalman.update(known, sighting.distance_m, sighting.variance_m2) if known else _started(sighting)


def _coast(state: TrackState, moved: FilterState | None, at_s: float, settings: Tracking, reason: str) -> TrackState:
    """Show what is expected, as long as that may stand in for measurements."""
    if moved is None or state.sighting is None:
        return state
    shown = _shown(state.track, moved, state.sighting, TrackStatus.COASTING, at_s=at_s, reason=reason)
    return _lose_if_late(shown, at_s, settings, reason)


def _shown(
    before: Track,
    known: FilterState,
    sighting: Sighting,
    status: TrackStatus,
    *,
    at_s: float | None = None,
    reason: str = "",
) -> TrackState:
    """Put what the filter knows into the track that others see."""
    as_of_s = sighting.at_s if at_s is None else at_s
    track = Track(
        target=before.target,
        status=status,
        distance_m=known.distance_m,
        depth_m=known.distance_m * sighting.depth_share,
        closing_mps=-known.rate_mps,
        sigma_m=math.hypot(math.sqrt(known.var_distance_m2), known.distance_m * sighting.scale_sigma),
        closing_sigma_mps=math.sqrt(known.var_rate_m2ps2),
        bearing_rad=sighting.bearing_rad,
        elevation_rad=sighting.elevation_rad,
        as_of_s=as_of_s,
        measured_at_s=sighting.at_s,
        rejected=0 if status is TrackStatus.TRACKING else before.rejected,
        reason=reason,
    )
    return TrackState(track=track, filter=known, filter_at_s=as_of_s, sighting=sighting)
