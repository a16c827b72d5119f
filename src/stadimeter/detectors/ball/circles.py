"""Circles through points of which many do not belong to it."""

from __future__ import annotations

from functools import cache, lru_cache

import numpy as np
from msgspec import Struct

from stadimeter.core.detection import Indices, Points

# With half of the points on the circle, 64 triples miss it twice in ten thousand times.
TRIES = 64

# Steps of three sequences that fill a cube evenly: powers of the root of ``x⁴ = x + 1``.
EVENLY = 1 / 1.2207440846057596 ** np.arange(1, 4)


class ImageCircle(Struct, frozen=True, kw_only=True):
    """A circle in pixels."""

    x_px: float
    y_px: float
    radius_px: float


def find_common_circle(points_px: Points) -> ImageCircle | None:
    """Find the circle within a pixel of which most of the points lie; None if no three of them form one.

    Circles through three points each are tried. The same points always give the same circle.
    """
    circles = _circles_through_triples(points_px, TRIES)
    if not len(circles):
        return None
    across, down = points_px[:, 0] - circles[:, :1], points_px[:, 1] - circles[:, 1:2]
    # Each point votes with 1 - d², none beyond a pixel (RANSAC with a truncated square as its score, MSAC: P.
    # Torr and A. Zisserman, "MLESAC", 2000).
    apart = np.sqrt(across * across + down * down) - circles[:, 2:]
    score = np.maximum(1 - apart * apart, 0.0).sum(axis=1)
    x, y, radius = (float(value) for value in circles[int(np.argmax(score))])
    return ImageCircle(x_px=x, y_px=y, radius_px=radius)


def _circles_through_triples(points: Points, tries: int) -> Points:
    """Return the circles through triples of points as x, y, radius, shape ``(m, 3)``."""
    all_x, all_y = np.ascontiguousarray(points.T)
    picks = _picks(tries, len(points))
    (x, bx, cx), (y, by, cy) = all_x.take(picks), all_y.take(picks)
    # Circumcentre of the triangle in coordinates from its first corner. Twice its signed area is the determinant;
    # nearly zero for three points on a line, which form no circle.
    bx, cx, by, cy = bx - x, cx - x, by - y, cy - y
    twice_area = 2 * (bx * cy - by * cx)
    apart = np.abs(twice_area) > 1e-6
    twice_area = np.where(apart, twice_area, 1.0)
    b2, c2 = bx * bx + by * by, cx * cx + cy * cy
    to_x = (cy * b2 - by * c2) / twice_area
    to_y = (bx * c2 - cx * b2) / twice_area
    radius = np.sqrt(to_x * to_x + to_y * to_y)
    # Circles wider than the cloud of points are nearly straight lines through a few of them.
    size = max(float(all_x.max() - all_x.min()), float(all_y.max() - all_y.min()))
    circles = np.array([x + to_x, y + to_y, radius])
    return np.ascontiguousarray(circles.compress(apart & (radius > 1.0) & (radius < size), axis=1).T)


@lru_cache(maxsize=256)
def _picks(tries: int, points: int) -> Indices:
    """Return the indices of the points that each triple takes, shape ``(3, tries)``."""
    return np.ascontiguousarray((_spread(tries) * points).astype(np.intp).T)


@cache
def _spread(tries: int) -> Points:
    """Return triples of numbers from 0 to 1 that fill the cube evenly, shape ``(tries, 3)``.

    The additive recurrence of M. Roberts (2018); numpy's generators take 10 ms to load.
    """
    return np.outer(np.arange(1, tries + 1), EVENLY) % 1.0
