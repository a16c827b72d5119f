"""Circles through points of which many do not belong to it, and the circle of edges around a blob that is not round.

A range of colours hardly ever covers a whole ball: one side is in the shade, felt fades towards the limb, a seam or a
finger crosses it. Then the blob only says where to look. All strong edges around it are collected, and the circle with
the most of them on it is where the limb may be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.core.frame import Image
from stadimeter.detectors.sampling import sample

RADIALS = 96
"""In how many directions the limb is looked for."""

EDGES_PER_RADIAL = 3
"""Edges kept in each: the limb is not always the strongest."""

NEAREST, FURTHEST = 0.35, 2.0
"""Range of the search for the limb, in half sizes of the blob from its centre."""

LEAST_STEP = 6.0
"""Edges of fewer levels of 8 bits a pixel are noise."""

BAND_PX = 1.5
BAND_SHARE = 0.08
"""Greatest distance of points from the circle: for pixels, felt and blur; and for the ellipse that a ball looks like
away from the optical axis."""


@dataclass(frozen=True, slots=True)
class _Edges:
    """Edges that were found along radials."""

    points_px: Points  # where they are, shape ``(n, 2)``
    strength: Weights  # how steep they are, 1 for those as steep as the steepest in most directions, shape ``(n,)``


def edge_circle(image: Image, blob_px: Points, area_px2: float) -> Circle | None:
    """Find the circle of edges around a blob's outline, shape ``(n, 2)``; None if none has the blob inside."""
    low, high = blob_px.min(axis=0), blob_px.max(axis=0)
    centre, half_px = (low + high) / 2, float((high - low).max()) / 2 + 0.5
    step_px = max(0.5, half_px / 40)
    distances = np.arange(NEAREST * half_px, FURTHEST * half_px + 3 * step_px, step_px)
    edges = _edges(image, centre, np.broadcast_to(distances, (RADIALS, len(distances))), EDGES_PER_RADIAL)
    band = (max(BAND_PX, step_px), BAND_SHARE)
    return find_circle(edges.points_px, edges.strength, blob_px, area_px2, band)


def _angles() -> Points:
    return np.arange(RADIALS, dtype=np.float64) * (2 * np.pi / RADIALS)


def _edges(image: Image, centre: Points, distances_px: Points, most: int) -> _Edges:
    """Return the strongest edges inside the picture along radials, whose distances are even, ``(RADIALS, k)``."""
    directions = np.column_stack([np.cos(_angles()), np.sin(_angles())])
    points = centre + directions[:, None, :] * distances_px[:, :, None]
    values = sample(image, points[..., 0], points[..., 1])
    step_px = float(distances_px[0, 1] - distances_px[0, 0])
    change = np.linalg.norm(values[:, 3:] + values[:, 2:-1] - values[:, 1:-2] - values[:, :-3], axis=2) / (4 * step_px)
    rows, columns, shift = _peaks(change, most)
    found = distances_px[rows, columns] + (1.5 + shift) * step_px
    places = centre + directions[rows] * found[:, None]
    height, width = image.shape[:2]
    inside = (places >= 0.5).all(axis=1) & (places[:, 0] <= width - 1.5) & (places[:, 1] <= height - 1.5)
    usual = max(float(np.median(change.max(axis=1))), LEAST_STEP)
    strength = np.minimum(1.0, change[rows, columns] / usual)
    return _Edges(np.asarray(places[inside], np.float64), np.asarray(strength[inside], np.float64))


def _peaks(change: NDArray[np.float32], most: int) -> tuple[NDArray[np.intp], NDArray[np.intp], Points]:
    """Return the highest local maxima of each row: their rows, their columns, and how far beside them the peak is."""
    middle, before, after = change[:, 1:-1], change[:, :-2], change[:, 2:]
    peak = np.where((middle >= before) & (middle > after) & (middle > LEAST_STEP / 2), middle, 0.0)
    order = np.argsort(-peak, axis=1, kind="stable")[:, :most]
    rows = np.repeat(np.arange(len(change)), order.shape[1])
    columns = order.ravel()
    high = peak[rows, columns] > 0
    rows, columns = rows[high], columns[high]
    left, top, right = before[rows, columns], middle[rows, columns], after[rows, columns]
    curvature = left - 2 * top + right
    shift = np.where(curvature < -1e-6, 0.5 * (left - right) / np.minimum(curvature, -1e-6), 0.0)
    return rows, columns + 1, np.asarray(np.clip(shift, -1, 1), np.float64)


Weights = NDArray[np.float64]

TRIES = 400
"""With a quarter of the points on the circle, 400 triples miss it twice in a thousand times; with a third, never."""

FEW_TRIES = 64
"""With half of the points on the circle, 64 triples miss it twice in ten thousand times."""

SECTORS = 72
"""The circle's circumference is counted in sectors of five degrees."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Circle:
    """A circle in pixels."""

    x_px: float
    y_px: float
    radius_px: float


def most_common_circle(points_px: Points, band_px: float = 1.0) -> Circle | None:
    """Find the circle within a band of which most of the points lie; None if no three of them form one.

    Circles through three points each are tried. The same points always give the same circle.
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
    """Find the circle with strong points on most of its circumference that is filled by something; None if none is.

    Circles through three points each are tried. The same points always give the same circle.

    Args:
        strength: How much each counts, 0 to 1, shape ``(n,)``.
        around_px: Points that the circle should enclose, shape ``(m, 2)``.
        area_px2: The area of what should fill it.
        band: How far from a circle its points may lie: in pixels, and as a share of the radius if that is more.
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
