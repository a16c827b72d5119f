"""How far four corners are from being the picture of a rectangle, for many outlines at once and without their poses.

The homography from a rectangle to its picture is ``[w r1, h r2, t]`` up to a factor, with r1 and r2 at right angles and
of the same length (Z. Zhang, "A flexible new technique for camera calibration", 2000, section 2.3). Eight coordinates
less six of the pose leave these two conditions. By how much the corners must move to fulfil them follows from their
derivatives to first order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points

Values = NDArray[np.float64]

COORDINATES = 8
STEP = 1e-4
"""Derivatives are differences over this share of an outline's size."""

_SHIFTS = np.concatenate((np.zeros((1, COORDINATES)), np.eye(COORDINATES))).reshape(-1, 1, 4, 2)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RectangleFit:
    """How well outlines fit a rectangle."""

    # How far the corners appear from where the nearest picture of the rectangle has them: root mean square of
    # the coordinates' moves, per unit of depth, shape ``(c,)``.
    misfit: Values
    # What the square of a misfit is multiplied by to give the share of all outlines that fit at least as well,
    # shape ``(c,)``. Small outlines, and those seen from far, fit nearly anything.
    chance_per_square: Values


def rectangle_fit(directions: Points, aspect: float) -> RectangleFit:
    """Compare outlines with pictures of a rectangle, whose widths may be either two sides.

    The share of outlines that fit as well is the area of the ellipse of such fits in the plane of both conditions, the
    cosine of the angle and the logarithm of the ratio: outlines of any kind are spread over about 1 in each.

    Args:
        directions: Corners of outlines, x and y per unit of depth with the lens's distortion undone, in order around
            each, shape ``(c, 4, 2)``.
        aspect: Width over height of the rectangle.
    """
    size = np.abs(directions - directions.mean(axis=1, keepdims=True)).max(axis=(1, 2))
    step = np.maximum(STEP * size, 1e-12)
    right_angle, ratio = _conditions(directions + _SHIFTS * step[:, None, None])
    slopes = ((right_angle[1:] - right_angle[0]) / step, (ratio[1:] - ratio[0]) / step)
    a, b, c = ((slopes[i] * slopes[j]).sum(axis=0) for i, j in ((0, 0), (0, 1), (1, 1)))
    angle, tried = right_angle[0], (ratio[0] - np.log(aspect), ratio[0] + np.log(aspect))
    with np.errstate(all="ignore"):  # outlines that are no quadrilateral give NaN
        determinant = a * c - b * b
        # The square of the shortest move of all coordinates that takes both conditions to 0, to first order.
        move = np.minimum(*((c * angle**2 - 2 * b * angle * off + a * off**2) / determinant for off in tried))
    square = np.where(np.isfinite(move), np.maximum(move, 0.0), np.inf) / COORDINATES
    area = COORDINATES * math.pi * np.sqrt(np.maximum(np.nan_to_num(determinant), 0.0))
    return RectangleFit(misfit=np.sqrt(square), chance_per_square=area)


def _conditions(corners: Points) -> tuple[Values, Values]:
    """Return the cosine between both sides in space, and the logarithm of their ratio; 0 for a square."""
    x, y = np.moveaxis(corners[..., 0], -1, 0), np.moveaxis(corners[..., 1], -1, 0)
    dx1, dx2, sx = x[1] - x[2], x[3] - x[2], x[0] - x[1] + x[2] - x[3]
    dy1, dy2, sy = y[1] - y[2], y[3] - y[2], y[0] - y[1] + y[2] - y[3]
    with np.errstate(all="ignore"):  # outlines that are no quadrilateral give NaN
        area = dx1 * dy2 - dx2 * dy1
        g, h = (sx * dy2 - dx2 * sy) / area, (dx1 * sy - sx * dy1) / area
        first = (x[1] - x[0] + g * x[1], y[1] - y[0] + g * y[1], g)
        second = (x[3] - x[0] + h * x[3], y[3] - y[0] + h * y[3], h)
        squares = sum(each * each for each in first), sum(each * each for each in second)
        product = sum(one * other for one, other in zip(first, second, strict=True))
        return product / np.sqrt(squares[0] * squares[1]), np.log(squares[0] / squares[1]) / 2
