"""The figures of tracks that rules are judged by, and their standard deviations.

A figure is known only while its target is in sight and every number behind it is finite.
"""

from __future__ import annotations

import math
from typing import Literal

from stadimeter.core.measurement import Track, TrackStatus

Quantity = Literal["distance", "depth"]
Direction = Literal["bearing", "elevation"]

# A value, its standard deviation, and the part of that which differs from frame to frame (noise).
Uncertain = tuple[float, float, float]

_TRACKING, _COASTING = TrackStatus.TRACKING, TrackStatus.COASTING
_ROOT_2 = math.sqrt(2)


def quantity_of(track: Track, quantity: Quantity) -> Uncertain | None:
    """Return the distance or the depth of a target, in metres; None while there is no finite figure to act on.

    Where the noise is not known apart, the whole standard deviation is taken for noise.
    """
    status = track.status
    if status is not _TRACKING and status is not _COASTING:
        return None
    figure_m = track.distance_m if quantity == "distance" else track.depth_m
    sigma_m, noise_m = track.sigma_m, track.noise_m
    if figure_m is None or sigma_m is None:
        return None
    if noise_m is None:
        noise_m = sigma_m
    return (figure_m, sigma_m, noise_m) if math.isfinite(figure_m + sigma_m + noise_m) else None


def closing_of(track: Track) -> Uncertain | None:
    """Return the closing speed of a target in m/s, all of whose standard deviation is noise; None if not known."""
    return _finite(track, track.closing_mps, track.closing_sigma_mps)


def direction_of(track: Track, quantity: Direction) -> Uncertain | None:
    """Return a direction in radians, its standard deviation, which is unknown, as 0; None if it is not known."""
    return _finite(track, track.bearing_rad if quantity == "bearing" else track.elevation_rad, 0.0)


def separation_of(first: Track, second: Track) -> Uncertain | None:
    """Return the distance of two targets from each other in metres; None if not known.

    The standard deviations follow from those of the two distances, taken as independent, along the line between the
    targets. Those of the directions are not known, and do not count.
    """
    here, there = _sight(first), _sight(second)
    if here is None or there is None:
        return None
    (ax, ay, az), (here_m, sigma_here_m, noise_here_m) = here
    (bx, by, bz), (there_m, sigma_there_m, noise_there_m) = there
    x, y, z = ax * here_m - bx * there_m, ay * here_m - by * there_m, az * here_m - bz * there_m
    apart_m = math.sqrt(x * x + y * y + z * z)
    if apart_m == 0:
        return 0.0, math.hypot(sigma_here_m, sigma_there_m), math.hypot(noise_here_m, noise_there_m)
    share_here, share_there = (ax * x + ay * y + az * z) / apart_m, (bx * x + by * y + bz * z) / apart_m
    sigma_m = math.hypot(share_here * sigma_here_m, share_there * sigma_there_m)
    return apart_m, sigma_m, math.hypot(share_here * noise_here_m, share_there * noise_there_m)


def probability_between(low: float, high: float, value: float, sigma: float) -> float:
    """Return the probability that a normally distributed value is between two thresholds, which may be infinite."""
    return probability_below(high, value, sigma) - probability_below(low, value, sigma)


def probability_below(threshold: float, value: float, sigma: float) -> float:
    """Return the probability that a normally distributed value is below a threshold, which may be infinite."""
    if math.isinf(threshold):
        return 1.0 if threshold > 0 else 0.0
    if sigma <= 0:
        return 1.0 if value < threshold else 0.0
    return 0.5 * math.erfc((value - threshold) / (sigma * _ROOT_2))


def _finite(track: Track, value: float | None, sigma: float | None) -> Uncertain | None:
    status = track.status
    if (status is not _TRACKING and status is not _COASTING) or value is None or sigma is None:
        return None
    return (value, sigma, sigma) if math.isfinite(value + sigma) else None


def _sight(track: Track) -> tuple[tuple[float, float, float], Uncertain] | None:
    """Return the direction to a target as a vector of length 1 (x right, y down, z forward), and its distance."""
    distance = quantity_of(track, "distance")
    bearing, elevation = direction_of(track, "bearing"), direction_of(track, "elevation")
    if distance is None or bearing is None or elevation is None:
        return None
    level = math.cos(elevation[0])
    towards = (level * math.sin(bearing[0]), -math.sin(elevation[0]), level * math.cos(bearing[0]))
    return towards, distance
