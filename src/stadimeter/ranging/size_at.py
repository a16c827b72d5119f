"""The size of what is seen, if its distance is known: similar triangles the other way round.

What appears P large per unit of depth, at the depth Z, is ``W = P Z`` large. Errors of the focal length and of the
distance change it by the same share, and the edges by the share of what they are off.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import TargetShape
from stadimeter.core.measurement import Measurement
from stadimeter.ranging.measure import SigmaParts

# Standard deviation of each edge of a box that somebody drew by hand.
DRAWN_SIGMA_PX = 1.0


class DrawnBox(NamedTuple):
    """A rectangle in a picture, in pixels; its left top corner, and its size."""

    x_px: float
    y_px: float
    width_px: float
    height_px: float


class SizeAt(Struct, frozen=True, kw_only=True):
    """Width and height of something at a known distance, with their standard deviations."""

    width_m: float
    height_m: float
    width_sigma_m: float
    height_sigma_m: float


def size_at(
    measured: Measurement, parts: SigmaParts, shape: TargetShape, is_upright: bool, at: tuple[float, float]
) -> SizeAt | None:
    """Return the size of a target, whatever size it is taken for; None if it was not measured.

    The distance that is measured is in proportion to the size that it is taken for, at any tilt and anywhere in the
    picture. So the true size is as many times that one as the true distance is that which was measured.

    Args:
        measured: By its size.
        parts: The causes of the standard deviation of that.
        is_upright: Whether it appears higher than wide.
        at: How far its centre truly is, and the standard deviation of that, in metres.
    """
    distance_m = measured.distance_m
    if not distance_m:
        return None
    scale = at[0] / distance_m
    others_m = math.hypot(parts.edges_m, parts.focal_length_m, parts.pose_m)
    share = math.hypot(at[1] / at[0], others_m / distance_m)
    sides = sorted((scale * shape.longest_m, scale * shape.shortest_m), reverse=not is_upright)
    return SizeAt(width_m=sides[0], height_m=sides[1], width_sigma_m=share * sides[0], height_sigma_m=share * sides[1])


def box_size_at(box: DrawnBox, camera: CameraModel, at: tuple[float, float]) -> SizeAt:
    """Return the size of what fills a box, if it faces the camera, square to the optical axis.

    Args:
        camera: The camera model at the picture's resolution.
        at: How far the middle of the box is along the straight line, and the standard deviation of that, in metres.
    """
    middle = box.x_px + box.width_px / 2, box.y_px + box.height_px / 2
    ends = [
        (box.x_px, middle[1]), (box.x_px + box.width_px, middle[1]),
        (middle[0], box.y_px), (middle[0], box.y_px + box.height_px), middle,
    ]  # fmt: skip
    left, right, top, bottom, centre = camera.directions(np.array(ends)).tolist()
    depth_m = at[0] / math.hypot(1.0, *centre)
    width_m, height_m = depth_m * (right[0] - left[0]), depth_m * (bottom[1] - top[1])
    # Both edges err independently, so their difference by √2 times as much.
    common = math.hypot(at[1] / at[0], camera.distance_share(*middle))
    edges_m = math.sqrt(2) * DRAWN_SIGMA_PX * depth_m
    return SizeAt(
        width_m=width_m,
        height_m=height_m,
        width_sigma_m=math.hypot(edges_m / camera.fx_px, common * width_m),
        height_sigma_m=math.hypot(edges_m / camera.fy_px, common * height_m),
    )
