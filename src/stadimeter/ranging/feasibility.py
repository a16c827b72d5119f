"""What to expect of a camera and a target at a distance, before anything is bought or mounted.

How large the target will appear follows from geometry. How sure the distance will be follows from how well its size is
measured in pixels: a sharp, evenly lit picture is assumed, so these are the best standard deviations to hope for. Their
constants are those of `stadimeter`'s detectors on rendered pictures with known truth: a floor, and for balls and tags a
part that grows as their outline gets shorter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.target import BallSize, DiscSize, SheetSize, TagSize, TargetSize

RELIABLE_PX = 12.0
"""Smaller targets are hardly told from clutter, whatever kind they are."""

_BALL_FLOOR_PX = 0.05
_SMALL_BALL_PX2 = 0.85
_FLAT_FLOOR_PX = 0.015
_SMALL_TAG_PX2 = 1.35


@dataclass(frozen=True, slots=True, kw_only=True)
class Expectation:
    """What to expect at a distance.

    Attributes:
        distance_m: The distance.
        size_px: How large the target will appear: a ball's diameter, a flat target's shorter side as it faces the
            camera.
        sigma_m: The standard deviation of one measurement of the distance.
        noise_m: The part of it that differs from frame to frame; an error of the focal length does not.
    """

    distance_m: float
    size_px: float
    sigma_m: float
    noise_m: float

    @property
    def is_reliable(self) -> bool:
        """Whether the target is large enough to be found at all times."""
        return self.size_px >= RELIABLE_PX


def expect(size: TargetSize, camera: CameraModel, distance_m: float) -> Expectation:
    """Return what to expect of a target at a distance, in the middle of the picture.

    Args:
        size: The target's size.
        camera: The camera model at the resolution that will be used.
        distance_m: The distance of its centre.

    Returns:
        How large it will appear and how sure its distance will be.

    Raises:
        ValueError: The distance is not a finite number above zero.
    """
    if not (math.isfinite(distance_m) and distance_m > 0):
        raise ValueError(f"distance_m = {distance_m} is not a finite number above zero")
    focal_px = math.sqrt(camera.fx_px * camera.fy_px)
    size_px = focal_px * _tangent_size(size, distance_m)
    noise_m = _size_sigma_px(size, size_px) / size_px * distance_m
    sigma_m = math.hypot(noise_m, camera.focal_relative_sigma * distance_m)
    return Expectation(distance_m=distance_m, size_px=size_px, sigma_m=sigma_m, noise_m=noise_m)


def farthest_m(size: TargetSize, camera: CameraModel, size_px: float = RELIABLE_PX) -> float:
    """Return how far away a target may be to appear no smaller than a size.

    Args:
        size: The target's size.
        camera: The camera model at the resolution that will be used.
        size_px: How large it should appear.

    Returns:
        The distance in metres.
    """
    flat_m = math.sqrt(camera.fx_px * camera.fy_px) * _shortest_m(size) / size_px
    return math.hypot(flat_m, size.diameter_m / 2) if isinstance(size, BallSize) else flat_m


def _tangent_size(size: TargetSize, distance_m: float) -> float:
    """Return how large the target appears per unit of focal length: a ball's outline is that of the cone around it."""
    if isinstance(size, BallSize):
        radius_m = size.diameter_m / 2
        return 2 * radius_m / math.sqrt(max(distance_m**2 - radius_m**2, 1e-12))
    return _shortest_m(size) / distance_m


def _shortest_m(size: TargetSize) -> float:
    match size:
        case BallSize() | DiscSize():
            return size.diameter_m
        case SheetSize():
            return min(size.width_m, size.height_m)
        case TagSize():
            return size.side_m


def _size_sigma_px(size: TargetSize, size_px: float) -> float:
    match size:
        case BallSize():
            return math.hypot(_BALL_FLOOR_PX, _SMALL_BALL_PX2 / (size_px / 2))
        case TagSize():
            return math.hypot(_FLAT_FLOOR_PX, _SMALL_TAG_PX2 / size_px)
        case SheetSize() | DiscSize():
            return _FLAT_FLOOR_PX
