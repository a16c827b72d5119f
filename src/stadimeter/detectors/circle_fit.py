"""A circle through points of which many do not belong to it: seams, fingers, the texture of what is behind a ball."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points

Weights = NDArray[np.float64]

TRIES = 400
"""With a quarter of the points on the circle, 400 triples miss it twice in a thousand times; with a third, never."""

FEW_TRIES = 64
"""With half of the points on the circle, 64 triples miss it twice in ten thousand times."""

SECTORS = 72
"""The circle's circumference is counted in sectors of five degrees."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Circle:
    """A circle in pixels.

    Attributes:
        x_px: Horizontal coordinate of its centre.
        y_px: Vertical coordinate of its centre.
        radius_px: Its radius.
    """

    x_px: float
    y_px: float
    radius_px: float


def most_common_circle(points_px: Points, band_px: float = 1.0) -> Circle | None:
    """Find the circle that most of the points lie on.

    Circles through three points each are tried. The same points always give the same circle.

    Args:
        points_px: The points, shape ``(n, 2)``.
        band_px: How far from a circle its points may lie.

    Returns:
        The circle, or None if no three points form one.
    """
    circles = _circles_through_triples(points_px, FEW_TRIES)
    if not len(circles):
        return None
    apart = np.hypot(points_px[None, :, 0] - circles[:, :1], points_px[None, :, 1] - circles[:, 1:2]) - circles[:, 2:]
    score = np.maximum(1 - (apart / band_px) ** 2, 0.0).sum(axis=1)
    x, y, radius = (float(value) for value in circles[int(np.argmax(score))])
    return Circle(x_px=x, y_px=y, radius_px=radius)


def find_circle(
    points_px: Points, strength: Weights, around_px: Points, area_px2: float, band: tuple[float, float]
) -> Circle | None:
    """Find the circle that has strong points on most of its circumference and is filled by something.

    Circles through three points each are tried. The same points always give the same circle.

    Args:
        points_px: The points, shape ``(n, 2)``.
        strength: How much each counts, 0 to 1, shape ``(n,)``.
        around_px: Points that the circle should enclose, shape ``(m, 2)``.
        area_px2: The area of what should fill it.
        band: How far from a circle its points may lie: in pixels, and as a share of the radius if that is more.

    Returns:
        The circle, or None if no three points form one.
    """
    if len(points_px) < 6:
        return None
    circles = _circles_through_triples(points_px, TRIES)
    if not len(circles):
        return None
    fill = np.minimum(1.0, area_px2 / (np.pi * circles[:, 2] ** 2))
    score = _coverages(points_px, strength, circles, band) * _enclosed(around_px, circles) * np.sqrt(fill)
    x, y, radius = (float(value) for value in circles[int(np.argmax(score))])
    return Circle(x_px=x, y_px=y, radius_px=radius)


def _circles_through_triples(points: Points, tries: int) -> Points:
    """Return the circles through random triples of points as x, y, radius, shape ``(m, 3)``."""
    picks = np.random.default_rng(0).integers(0, len(points), (tries, 3))
    a, b, c = points[picks[:, 0]], points[picks[:, 1]], points[picks[:, 2]]
    ab, ac = b - a, c - a
    twice_area = 2 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    apart = np.abs(twice_area) > 1e-6
    ab, ac, a, twice_area = ab[apart], ac[apart], a[apart], twice_area[apart]
    ab2, ac2 = (ab**2).sum(axis=1), (ac**2).sum(axis=1)
    x = (ac[:, 1] * ab2 - ab[:, 1] * ac2) / twice_area
    y = (ab[:, 0] * ac2 - ac[:, 0] * ab2) / twice_area
    radius = np.hypot(x, y)
    size = float(np.ptp(points, axis=0).max())
    circles = np.column_stack([a[:, 0] + x, a[:, 1] + y, radius])
    return np.asarray(circles[(radius > 1.0) & (radius < size)])


def _coverages(points: Points, strength: Weights, circles: Points, band: tuple[float, float]) -> Weights:
    """Return for each circle the mean over its sectors of the strongest point on it there."""
    dx = points[None, :, 0] - circles[:, None, 0]
    dy = points[None, :, 1] - circles[:, None, 1]
    radius = circles[:, None, 2]
    near = np.abs(np.hypot(dx, dy) - radius) < np.maximum(band[0], band[1] * radius)
    row, point = np.nonzero(near)
    sector = _sectors(dx[row, point], dy[row, point])
    strongest = np.zeros((len(circles), SECTORS))
    np.maximum.at(strongest, (row, sector), strength[point])
    return np.asarray(strongest.mean(axis=1), np.float64)


def _sectors(dx: Points, dy: Points) -> NDArray[np.intp]:
    return ((np.arctan2(dy, dx) / (2 * np.pi) + 0.5) * SECTORS).astype(np.intp) % SECTORS


def _enclosed(around: Points, circles: Points) -> Weights:
    """Return for each circle the share of the points that it encloses, give or take 5 % of its radius."""
    dx = around[None, :, 0] - circles[:, None, 0]
    dy = around[None, :, 1] - circles[:, None, 1]
    return np.asarray((np.hypot(dx, dy) < 1.05 * circles[:, None, 2] + 1.0).mean(axis=1), np.float64)
