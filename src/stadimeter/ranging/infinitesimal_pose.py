"""The two poses that the picture of a rectangle may have, in closed form.

T. Collins and A. Bartoli, "Infinitesimal plane-based pose estimation", International Journal of Computer Vision 109,
2014: the homography from the plane to the picture, and its derivatives at the plane's middle, tell the plane's turn but
for a mirror image about the line of sight. OpenCV has it as ``SOLVEPNP_IPPE``, but loses a pose where something is seen
exactly from the front. Here nothing is divided by what then becomes zero. For four corners plain numbers are faster
than arrays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

Vector = tuple[float, float, float]
Seen = Sequence[Sequence[float]]


class RectanglePose(NamedTuple):
    """A pose of a rectangle.

    Attributes:
        right: Its x axis, towards its right, in the camera frame: x right, y down, z forward.
        up: Its y axis, towards its top.
        position_m: Its centre.
        misfit: How far the corners appear from where the pose has them, root mean square of their coordinates, per unit
            of depth.
    """

    right: Vector
    up: Vector
    position_m: Vector
    misfit: float


class _Middle(NamedTuple):
    """Where the middle of a rectangle appears, and how that changes per metre to its right and towards its top."""

    x: float
    y: float
    x_right: float
    x_up: float
    y_right: float
    y_up: float


def rectangle_poses(half_width_m: float, half_height_m: float, seen: Seen) -> list[RectanglePose]:
    """Return the poses that explain best where the corners of a rectangle appear, the better one first.

    Args:
        half_width_m: Half its width.
        half_height_m: Half its height.
        seen: Where its corners appear, x and y per unit of depth, from its own top left one on clockwise as it is seen
            from the front.

    Returns:
        Two poses, which are the same for something seen from the front; fewer where that would have it behind the
        camera, none where the corners are not those of a plane.
    """
    middle = _middle(half_width_m, half_height_m, seen)
    if middle is None:
        return []
    poses = [_placed(right, up, half_width_m, half_height_m, seen) for right, up in _turns(middle)]
    return sorted([pose for pose in poses if pose is not None], key=lambda pose: pose.misfit)


def misfit(
    right: Sequence[float], up: Sequence[float], position_m: Sequence[float], corners_m: Seen, seen: Seen
) -> float:
    """Return how far corners appear from where a pose has them.

    Args:
        right: The plane's x axis in the camera frame.
        up: Its y axis.
        position_m: Its origin.
        corners_m: The corners in the plane, x and y first.
        seen: Where they appear, x and y per unit of depth.

    Returns:
        Root mean square of the coordinates, per unit of depth; infinite for a corner that is not in front of the
        camera.
    """
    total = 0.0
    for (a, b, *_), (x, y) in zip(corners_m, seen, strict=True):
        depth = a * right[2] + b * up[2] + position_m[2]
        if not depth > 0:
            return math.inf
        total += (x - (a * right[0] + b * up[0] + position_m[0]) / depth) ** 2
        total += (y - (a * right[1] + b * up[1] + position_m[1]) / depth) ** 2
    return math.sqrt(total / (2 * len(seen)))


def _middle(half_width_m: float, half_height_m: float, seen: Seen) -> _Middle | None:
    """Return the homography's value and derivatives in the middle.

    It is P. Heckbert's for a unit square with u to the right and v down ("Fundamentals of texture mapping and image
    warping", 1989).
    """
    (x0, y0), (x1, y1), (x2, y2), (x3, y3) = seen
    x12, x32, y12, y32 = x1 - x2, x3 - x2, y1 - y2, y3 - y2
    x_sum, y_sum = x0 - x1 + x2 - x3, y0 - y1 + y2 - y3
    determinant = x12 * y32 - x32 * y12
    if not determinant:
        return None
    g, h = (x_sum * y32 - x32 * y_sum) / determinant, (x12 * y_sum - x_sum * y12) / determinant
    depth = 1 + (g + h) / 2
    if not depth > 0:
        return None
    x_u, x_v, y_u, y_v = x1 - x0 + g * x1, x3 - x0 + h * x3, y1 - y0 + g * y1, y3 - y0 + h * y3
    x, y = (x0 + (x_u + x_v) / 2) / depth, (y0 + (y_u + y_v) / 2) / depth
    across, down = 2 * half_width_m * depth, -2 * half_height_m * depth
    return _Middle(x, y, (x_u - g * x) / across, (x_v - h * x) / down, (y_u - g * y) / across, (y_v - h * y) / down)


def _turns(middle: _Middle) -> list[tuple[Vector, Vector]]:
    """Return the two pairs of axes of a plane that looks so in its middle (section 5 of the paper)."""
    x, y = middle.x, middle.y
    # The rotation that takes the optical axis into the line of sight; its last row and column are (-x, -y, 1) cosine.
    cosine = 1 / math.sqrt(1 + x * x + y * y)
    share = cosine * cosine / (1 + cosine)
    xx, xy, yy = 1 - share * x * x, -share * x * y, 1 - share * y * y
    # How a small shift in the turned plane moves what is seen, and the plane's own shifts behind it.
    a, b, d = xx + x * x * cosine, xy + x * y * cosine, yy + y * y * cosine
    m00, m10 = (d * middle.x_right - b * middle.y_right), (a * middle.y_right - b * middle.x_right)
    m01, m11 = (d * middle.x_up - b * middle.y_up), (a * middle.y_up - b * middle.x_up)
    # But for a factor these are part of a rotation matrix, whose largest singular value is 1.
    t00, t01, t11 = m00 * m00 + m01 * m01, m00 * m10 + m01 * m11, m10 * m10 + m11 * m11
    largest = math.sqrt((t00 + t11 + math.hypot(t00 - t11, 2 * t01)) / 2)
    if not largest > 0:
        return []
    m00, m01, m10, m11 = m00 / largest, m01 / largest, m10 / largest, m11 / largest
    right_z = math.sqrt(max(0.0, 1 - m00 * m00 - m10 * m10))
    up_z = math.copysign(math.sqrt(max(0.0, 1 - m01 * m01 - m11 * m11)), -(m00 * m01 + m10 * m11))
    turns = []
    for sign in (1.0, -1.0):
        axes = []
        for p, q, r in ((m00, m10, sign * right_z), (m01, m11, sign * up_z)):
            axes.append(
                (xx * p + xy * q + x * cosine * r, xy * p + yy * q + y * cosine * r, cosine * (r - x * p - y * q))
            )
        turns.append((axes[0], axes[1]))
    return turns


def _placed(right: Vector, up: Vector, half_width_m: float, half_height_m: float, seen: Seen) -> RectanglePose | None:
    """Return the pose with the position that explains the corners best: linear least squares (ibid., section 5.4)."""
    w, h = half_width_m, half_height_m
    corners = ((-w, h), (w, h), (w, -h), (-w, -h))
    sum_x = sum_y = squares = first = second = third = 0.0
    for (a, b), (x, y) in zip(corners, seen, strict=True):
        depth = a * right[2] + b * up[2]
        off_x = x * depth - a * right[0] - b * up[0]
        off_y = y * depth - a * right[1] - b * up[1]
        sum_x += x
        sum_y += y
        squares += x * x + y * y
        first += off_x
        second += off_y
        third += x * off_x + y * off_y
    spread = squares - (sum_x * sum_x + sum_y * sum_y) / 4
    if not spread > 0:
        return None
    z_m = ((sum_x * first + sum_y * second) / 4 - third) / spread
    position_m = ((first + sum_x * z_m) / 4, (second + sum_y * z_m) / 4, z_m)
    missed = misfit(right, up, position_m, corners, seen)
    return RectanglePose(right, up, position_m, missed) if math.isfinite(missed) else None
