"""The shape of an outline of four corners: a picture of a rectangle, or not."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class QuadShapes:
    """The shapes of many outlines.

    Attributes:
        sides_px: The lengths of their sides, shape ``(c, 4)``; side i leads from corner i to corner i + 1.
        area_px2: Their areas, shape ``(c,)``.
        shorter_px: Of both pairs of opposite sides, the mean length of the shorter one, shape ``(c,)``.
        aspect: The mean of the longer pair over that of the shorter one, shape ``(c,)``.
        side_ratio: How many times as long as the opposite side a side is at most, shape ``(c,)``.
        sharpest_rad: The sharpest angle at a corner, shape ``(c,)``.
    """

    sides_px: Values
    area_px2: Values
    shorter_px: Values
    aspect: Values
    side_ratio: Values
    sharpest_rad: Values


def quad_shapes(corners: Points) -> QuadShapes:
    """Return the shapes of outlines.

    Args:
        corners: Their corners in order around each, shape ``(c, 4, 2)``.
    """
    sides = corners[:, [1, 2, 3, 0]] - corners
    sides_px = np.maximum(np.hypot(sides[..., 0], sides[..., 1]), 1e-9)
    back = -sides[:, [3, 0, 1, 2]] / sides_px[:, [3, 0, 1, 2], None]
    cosines = (back * sides / sides_px[..., None]).sum(axis=2)
    first, second = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    pairs, opposite = (sides_px[:, :2] + sides_px[:, 2:]) / 2, sides_px[:, :2] / sides_px[:, 2:]
    shorter = pairs.min(axis=1, initial=np.inf)
    return QuadShapes(
        sides_px=sides_px,
        area_px2=np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2,
        shorter_px=shorter,
        aspect=pairs.max(axis=1, initial=0.0) / shorter,
        side_ratio=np.maximum(opposite, 1 / opposite).max(axis=1, initial=1.0),
        sharpest_rad=np.arccos(np.clip(cosines.max(axis=1, initial=-1.0), -1.0, 1.0)),
    )


def longest_sides_px(corners: Points) -> Values:
    """Return the length of the longest side of each outline, shape ``(c,)``, from corners of shape ``(c, 4, 2)``."""
    sides = corners[:, [1, 2, 3, 0]] - corners
    longest: Values = np.hypot(sides[..., 0], sides[..., 1]).max(axis=1, initial=0.0)
    return longest


def polygon_area(corners: Points) -> float:
    """Return the area of a polygon by the shoelace formula.

    Args:
        corners: Its corners in order, shape ``(n, 2)``.

    Returns:
        The area in the square of their unit, never negative.
    """
    x, y = corners[:, 0], corners[:, 1]
    return 0.5 * abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))


def side_lengths(corners: Points) -> tuple[float, float, float, float]:
    """Return the lengths of the sides; side i leads from corner i to corner i + 1."""
    a, b, c, d = corners.tolist()
    return math.dist(a, b), math.dist(b, c), math.dist(c, d), math.dist(d, a)


def width_and_height(corners: Points) -> tuple[float, float]:
    """Return the mean length of the pair of opposite sides that is more horizontal, and of the other pair."""
    sides = side_lengths(corners)
    first, second = (sides[0] + sides[2]) / 2, (sides[1] + sides[3]) / 2
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = corners.tolist()
    across_x, across_y = abs(bx - ax) + abs(dx - cx), abs(by - ay) + abs(dy - cy)
    down_x, down_y = abs(cx - bx) + abs(ax - dx), abs(cy - by) + abs(ay - dy)
    first_is_width = across_x * down_y >= across_y * down_x
    return (first, second) if first_is_width else (second, first)


def diagonals_meet(corners: Points) -> tuple[float, float]:
    """Return where the diagonals of a convex outline meet: the rectangle's centre, from whatever side it is seen."""
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = corners.tolist()
    share = ((bx - ax) * (dy - by) - (by - ay) * (dx - bx)) / ((cx - ax) * (dy - by) - (cy - ay) * (dx - bx))
    return ax + share * (cx - ax), ay + share * (cy - ay)


def grown(corners: Points, by_px: float | Values) -> Points:
    """Move the sides of outlines outwards.

    Args:
        corners: Convex outlines, clockwise on the screen, shape ``(k, 4, 2)``.
        by_px: How far; one figure, or one for each outline.
    """
    after = np.roll(corners, -1, axis=1) - corners
    along = after / np.maximum(np.linalg.norm(after, axis=2, keepdims=True), 1e-9)
    back = -np.roll(along, 1, axis=1)
    sine = np.abs(back[:, :, 0] * along[:, :, 1] - back[:, :, 1] * along[:, :, 0])
    moves_px = np.reshape(by_px, (-1, 1)) / np.maximum(sine, 0.2)
    return np.asarray(corners - (along + back) * moves_px[:, :, None])
