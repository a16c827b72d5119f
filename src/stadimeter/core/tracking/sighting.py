"""What one frame says of a target, as far as it may be used."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stadimeter.core.bounds import MAX_FIGURE, MAX_TIME_S
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.core.tracking.filter import NOISE_FLOOR_M


@dataclass(frozen=True, slots=True, kw_only=True)
class Sighting:
    """A measurement that may be used: every figure is there and not beyond all sense.

    Attributes:
        at_s: Capture time.
        distance_m: The distance.
        noise_m: The part of the standard deviation that differs from frame to frame, as stated.
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


def sighting_of(measurement: Measurement) -> Sighting | None:
    """Return the figures of a measurement; None if the target was not measured or a figure makes no sense."""
    distance_m, depth_m, sigma_m = measurement.distance_m, measurement.depth_m, measurement.sigma_m
    noise_m, bearing_rad, elevation_rad = measurement.noise_m, measurement.bearing_rad, measurement.elevation_rad
    if measurement.status is not MeasurementStatus.MEASURED:
        return None
    if distance_m is None or depth_m is None or sigma_m is None:
        return None
    if noise_m is None or bearing_rad is None or elevation_rad is None:
        return None
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
    )
