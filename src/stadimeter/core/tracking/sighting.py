"""Sightings, the usable measurements of a target, and tentative tracks made of some in a row.

A new target is tentative, and so is what contradicts a target that is tracked: if its frames agree, the target is
there. A first sighting gives no speed; the second agrees with it if the target may have moved as targets mostly
do. Two that contradict each other may be errors, or a fast target: then a third on the line through both decides. This
is two-point differencing: Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", Wiley
2001, section 5.5.3.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from stadimeter.core.bounds import MAX_FIGURE, MAX_TIME_S
from stadimeter.core.measurement import Measurement, MeasurementStatus, Sighting
from stadimeter.core.tracking import motion
from stadimeter.core.tracking.filter import NOISE_FLOOR_M
from stadimeter.core.tracking.motion import MotionState
from stadimeter.core.tracking.settings import Tracking

# Two sightings that are further apart than a target of this speed could come are not of one target.
MAX_SPEED_MPS = 40.0

# The frames that agree when a third is on the line through two.
ON_A_LINE = 3

# What is perhaps the target must be the same thing in ten frames in a row before it counts: a third of a second of
# most cameras. What stands still for as long and looks like the target is taken for it.
PERHAPS_FRAMES = 10


def sighting_of(measurement: Measurement) -> Sighting | None:
    """Return the figures of a measurement; None if the target was not measured or a figure makes no sense."""
    distance_m, depth_m, sigma_m = measurement.distance_m, measurement.depth_m, measurement.sigma_m
    noise_m, bearing_rad, elevation_rad = measurement.noise_m, measurement.bearing_rad, measurement.elevation_rad
    if measurement.status not in (MeasurementStatus.MEASURED, MeasurementStatus.PERHAPS):
        return None
    if distance_m is None or depth_m is None or sigma_m is None:
        return None
    if noise_m is None or bearing_rad is None or elevation_rad is None:
        return None
    # One comparison for six figures: a sum with NaN or infinity in it is not below the bound either.
    figures = abs(distance_m) + abs(depth_m) + abs(sigma_m) + abs(noise_m) + abs(bearing_rad) + abs(elevation_rad)
    if not (figures <= MAX_FIGURE and abs(measurement.captured_at_s) <= MAX_TIME_S) or distance_m <= 0:
        return None
    return Sighting(
        at_s=measurement.captured_at_s,
        distance_m=distance_m,
        noise_m=max(noise_m, NOISE_FLOOR_M),
        scale_sigma=math.sqrt(max(0.0, sigma_m**2 - noise_m**2)) / distance_m,
        depth_share=depth_m / distance_m,
        bearing_rad=bearing_rad,
        elevation_rad=elevation_rad,
        size_share=measurement.size_share,
        remark=measurement.reason,
        is_perhaps=measurement.status is MeasurementStatus.PERHAPS,
    )


class TentativeTrack(NamedTuple):
    """A target that is not confirmed yet.

    Attributes:
        sighting: The newest sighting.
        noise_m: The standard deviation of its noise.
        frames: How many frames in a row agree with each other.
        sure: In how many of them it was measured and not only perhaps.
        motion: How it moves if it moves as targets mostly do.
        fast: How it moves if it is as fast as its last two sightings say; None if they agree anyway.
    """

    sighting: Sighting
    noise_m: float
    frames: int
    sure: int
    motion: MotionState
    fast: MotionState | None = None

    def is_confirmed(self, frames: int) -> bool:
        """Return whether it counts; a target that is surely seen takes this number of frames."""
        return self.sure >= frames or self.frames >= max(frames, PERHAPS_FRAMES)


def extend_tentative(
    before: TentativeTrack | None, sighting: Sighting, noise_m: float, settings: Tracking
) -> TentativeTrack:
    """Return the candidate after another sighting.

    Args:
        before: What was seen in the frames before; None for nothing.
        noise_m: Standard deviation of the sighting's noise, above zero.
        settings: How to track.
    """
    at_rest, sure = motion.start(sighting.distance_m, noise_m), int(not sighting.is_perhaps)
    if before is None:
        return TentativeTrack(sighting, noise_m, 1, sure, at_rest)
    agreeing = _take_if_agreeing(before.motion, before, sighting, noise_m, settings)
    if agreeing:
        return TentativeTrack(sighting, noise_m, before.frames + 1, before.sure + sure, agreeing)
    on_line = before.fast and _take_if_agreeing(before.fast, before, sighting, noise_m, settings)
    if on_line:
        return TentativeTrack(sighting, noise_m, ON_A_LINE, ON_A_LINE if sure and before.sure else 0, on_line)
    return TentativeTrack(sighting, noise_m, 1, sure, at_rest, _start_fast(before, sighting, noise_m))


def _take_if_agreeing(
    state: MotionState, before: TentativeTrack, sighting: Sighting, noise_m: float, settings: Tracking
) -> MotionState | None:
    """Return the motion with a sighting taken in; None if the sighting contradicts it."""
    step_s = sighting.at_s - before.sighting.at_s
    moved = motion.predict(state, step_s, settings.acceleration_mps2, settings.autocorrelation)
    innovation = motion.compare(moved, sighting.distance_m, noise_m)
    return motion.update(moved, noise_m, innovation) if innovation.sigmas <= settings.gate_sigmas else None


def _start_fast(before: TentativeTrack, sighting: Sighting, noise_m: float) -> MotionState | None:
    step_s = sighting.at_s - before.sighting.at_s
    # Metres per second from two sightings; 40 m/s is a limit of sense, not of a model.
    rate_mps = (sighting.distance_m - before.sighting.distance_m) / step_s
    if abs(rate_mps) > MAX_SPEED_MPS:
        return None
    return motion.start_moving(sighting.distance_m, noise_m, rate_mps, before.noise_m, step_s)
