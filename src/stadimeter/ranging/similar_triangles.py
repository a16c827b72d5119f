"""Similar triangles, the whole of pinhole ranging in one formula, and what to expect of a camera and a target by them.

An object of width W at the distance D from a pinhole, square to the optical axis, appears P pixels wide at a focal
length of F pixels, with ``P / F = W / D``: the triangle before the pinhole and the one behind it are similar. A
textbook rule (R. Szeliski, Computer Vision: Algorithms and Applications, 2nd edition, section 2.1.4). D is the depth:
the distance along the optical axis.

How large the target will appear follows from geometry. How sure the distance will be follows from how well its size is
measured in pixels, and that is said by its shape (`stadimeter.core.detection.TargetShape.size_sigma_px`): the best to
hope for, in a sharp, evenly lit picture.
"""

from __future__ import annotations

import math

from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Reading, TargetShape


def distance_m(focal_px: float, size_m: float, apparent_px: float) -> float:
    """Return the distance D = W · F / P, as a depth, of an object as large as W that appears as large as P.

    Raises:
        ValueError: A value is not a finite number above zero.
    """
    for name, value in (("focal_px", focal_px), ("size_m", size_m), ("apparent_px", apparent_px)):
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} = {value} is not a finite number above zero")
    return size_m * focal_px / apparent_px


def size_noise_share(detection: Detection, camera: CameraModel, apparent: float) -> float:
    """Return the standard deviation of an apparent size, given per unit of depth, as a share of it."""
    # σ in pixels over the focal length (geometric mean of both axes) is per unit of depth, like the apparent size.
    return detection.size_sigma_px / math.sqrt(camera.fx_px * camera.fy_px) / apparent


def read_by_one_length(detection: Detection, camera: CameraModel, size_m: float, apparent: float) -> Reading:
    """Return where a target is by one length, as if that were square to the optical axis and its centre in its middle.

    Its apparent length is per unit of depth.
    """
    depth_m = distance_m(1.0, size_m, apparent)
    x, y = camera.direction(*detection.centre_px)
    return Reading(
        position_m=(x * depth_m, y * depth_m, depth_m), noise_share=size_noise_share(detection, camera, apparent)
    )


# Smaller targets are hardly distinguished from clutter, whatever kind they are.
RELIABLE_PX = 12.0

_MIN_M2 = 1e-12


class Expectation(Struct, frozen=True, kw_only=True):
    """Expected appearance and uncertainty at a distance."""

    distance_m: float
    # How large the target will appear: a ball's diameter, a flat target's shorter side as it faces the camera.
    size_px: float
    sigma_m: float  # the standard deviation of one measurement of the distance
    noise_m: float  # the part of it that differs from frame to frame; an error of the focal length does not

    @property
    def is_reliable(self) -> bool:
        """True if the target is large enough to be found at all times."""
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
    """Return the farthest a target may be to appear no smaller than a size, through a camera of that resolution."""
    flat_m = math.sqrt(camera.fx_px * camera.fy_px) * shape.shortest_m / size_px
    return math.hypot(flat_m, shape.limb_radius_m)
