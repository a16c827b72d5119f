"""The shape of an outline of four corners: a picture of a rectangle, or not."""

from __future__ import annotations

import math

import numpy as np

from stadimeter.core.detection import Points


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
    first, second, third, fourth = (math.dist(corners[i], corners[(i + 1) % 4]) for i in range(4))
    return first, second, third, fourth


def width_and_height(corners: Points) -> tuple[float, float]:
    """Return the mean length of the pair of opposite sides that is more horizontal, and of the other pair."""
    sides = side_lengths(corners)
    first, second = (sides[0] + sides[2]) / 2, (sides[1] + sides[3]) / 2
    across = np.abs(corners[1] - corners[0]) + np.abs(corners[3] - corners[2])
    down = np.abs(corners[2] - corners[1]) + np.abs(corners[0] - corners[3])
    first_is_width = across[0] * down[1] >= across[1] * down[0]
    return (first, second) if first_is_width else (second, first)


def is_convex(corners: Points) -> bool:
    """Say whether the outline turns the same way at every corner."""
    edges = np.roll(corners, -1, axis=0) - corners
    after = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0]
    return bool((turns > 0).all() or (turns < 0).all())


def corner_angles_rad(corners: Points) -> tuple[float, ...]:
    """Return the angles at the corners."""
    angles = []
    for i in range(4):
        back, forward = corners[i - 1] - corners[i], corners[(i + 1) % 4] - corners[i]
        cosine = float(back @ forward) / max(float(np.hypot(*back) * np.hypot(*forward)), 1e-9)
        angles.append(math.acos(max(-1.0, min(1.0, cosine))))
    return tuple(angles)


def diagonals_meet(corners: Points) -> tuple[float, float]:
    """Return where the diagonals of a convex outline meet: the rectangle's centre, from whatever side it is seen."""
    a, b, c, d = corners
    first, second = c - a, d - b
    cross = first[0] * second[1] - first[1] * second[0]
    share = ((b - a)[0] * second[1] - (b - a)[1] * second[0]) / cross
    centre = a + share * first
    return float(centre[0]), float(centre[1])


def grown(corners: Points, by_px: float) -> Points:
    """Move the sides of outlines outwards.

    Args:
        corners: Convex outlines, clockwise on the screen, shape ``(k, 4, 2)``.
        by_px: How far.

    Returns:
        The corners where the moved sides meet.
    """
    after = np.roll(corners, -1, axis=1) - corners
    along = after / np.maximum(np.linalg.norm(after, axis=2, keepdims=True), 1e-9)
    back = -np.roll(along, 1, axis=1)
    sine = np.abs(back[:, :, 0] * along[:, :, 1] - back[:, :, 1] * along[:, :, 0])
    return np.asarray(corners - (along + back) * (by_px / np.maximum(sine, 0.2))[:, :, None])
