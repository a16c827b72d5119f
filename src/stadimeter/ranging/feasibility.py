"""Expectations of a camera and a target at a distance, before anything is bought or mounted.

How large the target will appear follows from geometry. How sure the distance will be follows from how well its size is
measured in pixels, and that is said by its shape (`stadimeter.core.target.TargetShape.size_sigma_px`): the best to hope
for, in a sharp, evenly lit picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.target import TargetShape

# Smaller targets are hardly distinguished from clutter, whatever kind they are.
RELIABLE_PX = 12.0

_MIN_M2 = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True)
class Expectation:
    """Expected appearance and uncertainty at a distance."""

    distance_m: float
    # How large the target will appear: a ball's diameter, a flat target's shorter side as it faces the camera.
    size_px: float
    sigma_m: float  # the standard deviation of one measurement of the distance
    noise_m: float  # the part of it that differs from frame to frame; an error of the focal length does not

    @property
    def is_reliable(self) -> bool:
        """Whether the target is large enough to be found at all times."""
        return self.size_px >= RELIABLE_PX


def expect(shape: TargetShape, camera: CameraModel, distance_m: float) -> Expectation:
    """Return the expected size and uncertainty of a target at a distance, at the centre of the picture.

    Raises:
        ValueError: The distance is not a finite number above zero.
    """
    if not (math.isfinite(distance_m) and distance_m > 0):
        raise ValueError(f"distance_m = {distance_m} is not a finite number above zero")
    focal_px = math.sqrt(camera.fx_px * camera.fy_px)
    # A sphere's limb lies nearer than its centre: half the outline is r / √(D² - r²) per unit of focal length. For flat
    # targets the limb radius is 0.
    square_m2 = distance_m * distance_m - shape.limb_radius_m * shape.limb_radius_m
    size_px = focal_px * (shape.shortest_m / math.sqrt(max(square_m2, _MIN_M2)))
    # D = W F / P, so σ_D / D = σ_P / P: with P = W F / D it grows with the square of the distance.
    noise_m = shape.size_sigma_px(size_px) / size_px * distance_m
    sigma_m = math.hypot(noise_m, camera.focal_relative_sigma * distance_m)
    return Expectation(distance_m=distance_m, size_px=size_px, sigma_m=sigma_m, noise_m=noise_m)


def farthest_m(shape: TargetShape, camera: CameraModel, size_px: float = RELIABLE_PX) -> float:
    """Return how far away a target may be to appear no smaller than a size, through a camera of that resolution."""
    flat_m = math.sqrt(camera.fx_px * camera.fy_px) * shape.shortest_m / size_px
    return math.hypot(flat_m, shape.limb_radius_m)
