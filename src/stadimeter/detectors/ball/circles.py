"""Circles through points of which many do not belong to it, and the circle of edges around a blob that is not round.

A range of colours hardly ever covers a whole ball: one side is in the shade, felt fades towards the limb, a seam or a
finger crosses it. Then the blob only says where to look. All strong edges around it are collected, and the circle with
the most of them on it is where the limb may be.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.core.frame import Image

Values = NDArray[np.float64]
Weights = NDArray[np.float64]
Indices = NDArray[np.intp]

RADIALS = 96
"""In how many directions the limb is looked for."""

STEPS_A_HALF = 40
"""Half the size of the blob is this many steps along a radial."""

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


TRIES = 400
"""With a quarter of the points on the circle, 400 triples miss it twice in a thousand times; with a third, never."""

FEW_TRIES = 64
"""With half of the points on the circle, 64 triples miss it twice in ten thousand times."""

MOST_HELD = 128
"""Number of circles that are held against all edges."""

LEAST_EDGES = 6

EVENLY = 1 / 1.2207440846057596 ** np.arange(1, 4)
"""Steps of three sequences that fill a cube evenly: powers of the root of ``x⁴ = x + 1``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Circle:
    """A circle in pixels."""

    x_px: float
    y_px: float
    radius_px: float


class Edges(NamedTuple):
    """Edges along radials, the strongest of each: a row for each radial."""

    points_px: Points  # where they are, shape ``(n, k, 2)``
    # How steep they are, 1 for those as steep as the steepest in most directions, 0 for none, shape ``(n, k)``.
    strength: Weights


def edge_circle(image: Image, blob_px: Points, area_px2: float) -> Circle | None:
    """Find the circle of edges around a blob's outline, shape ``(n, 2)``; None if none has the blob inside."""
    low, high = blob_px.min(axis=0), blob_px.max(axis=0)
    centre, half_px = (low + high) / 2, float((high - low).max()) / 2 + 0.5
    step_px = max(0.5, half_px / STEPS_A_HALF)
    distances = np.arange(NEAREST * half_px, FURTHEST * half_px + 3 * step_px, step_px)
    return find_circle(_edges(image, centre, distances), blob_px, area_px2, (max(BAND_PX, step_px), BAND_SHARE))


def find_circle(edges: Edges, around_px: Points, area_px2: float, band: tuple[float, float]) -> Circle | None:
    """Find the circle with strong edges on most radials that is filled by something; None if none is.

    Circles through three edges each are tried. The same edges always give the same circle.

    Args:
        around_px: Points that the circle should enclose, shape ``(m, 2)``.
        area_px2: The area of what should fill it.
        band: How far from a circle its edges may lie: in pixels, and as a share of the radius if that is more.
    """
    points = edges.points_px[edges.strength > 0]
    if len(points) < LEAST_EDGES:
        return None
    circles = _circles_through_triples(points, TRIES)
    if not len(circles):
        return None
    fill = np.minimum(1.0, area_px2 / (np.pi * circles[:, 2] ** 2))
    worth = _enclosed(around_px, circles) * np.sqrt(fill)
    # What a circle encloses is quickly told; only the best by that are held against all edges.
    tried = np.argsort(-worth, kind="stable")[:MOST_HELD]
    score = worth[tried] * _support(edges, circles[tried], band)
    best = int(np.argmax(score))
    if not score[best] > 0:
        return None
    x, y, radius = (float(value) for value in circles[tried[best]])
    return Circle(x_px=x, y_px=y, radius_px=radius)


def _edges(image: Image, centre: Points, distances_px: Points) -> Edges:
    """Return the strongest edges inside the picture along radials, at even distances from the centre."""
    angles = np.arange(RADIALS) * (2 * np.pi / RADIALS)
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    points = centre + directions[:, None, :] * distances_px[:, None]
    last = np.array((image.shape[1], image.shape[0])) - 1
    nearest = np.rint(points).clip(0, last).astype(np.intp)
    values = image.reshape(-1, 3).take(nearest[..., 1] * image.shape[1] + nearest[..., 0], axis=0).astype(np.float32)
    change = values[:, 3:] + values[:, 2:-1] - values[:, 1:-2] - values[:, :-3]
    step_px = float(distances_px[1] - distances_px[0])
    steepness = np.sqrt((change * change).sum(axis=2)) / (4 * step_px)
    # Beyond the border its pixels are repeated, which shows no edges.
    columns, peak = _peaks(steepness)
    found_px = distances_px[columns] + 1.5 * step_px
    usual = max(float(np.median(steepness.max(axis=1))), LEAST_STEP)
    return Edges(centre + directions[:, None, :] * found_px[:, :, None], np.minimum(1.0, peak / usual))


def _peaks(steepness: Values) -> tuple[Indices, Values]:
    """Return the highest local maxima of each row: their columns, and how high they are; 0 where there are fewer."""
    middle, before, after = steepness[:, 1:-1], steepness[:, :-2], steepness[:, 2:]
    peak = np.where((middle >= before) & (middle > after) & (middle > LEAST_STEP / 2), middle, 0)
    columns = np.argsort(-peak, axis=1, kind="stable")[:, :EDGES_PER_RADIAL]
    return columns + 1, np.take_along_axis(peak, columns, axis=1)


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


def _circles_through_triples(points: Points, tries: int) -> Points:
    """Return the circles through triples of points as x, y, radius, shape ``(m, 3)``."""
    picks = (_spread(tries) * len(points)).astype(np.intp)
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


@cache
def _spread(tries: int) -> Points:
    """Return triples of numbers from 0 to 1 that fill the cube evenly, shape ``(tries, 3)``.

    The additive recurrence of M. Roberts (2018); numpy's generators take 10 ms to load.
    """
    return np.outer(np.arange(1, tries + 1), EVENLY) % 1.0


def _support(edges: Edges, circles: Points, band: tuple[float, float]) -> Values:
    """Return for each circle the mean over the radials of the strongest edge on it there."""
    middle = edges.points_px.reshape(-1, 2).mean(axis=0)
    points, centres, radius = edges.points_px.reshape(-1, 2) - middle, circles[:, :2] - middle, circles[:, 2:]
    # |p - c|² - r² = (|p - c| - r)(|p - c| + r) is about 2 r times how far a point is from the circle.
    off = centres @ (-2 * points.T) + (points * points).sum(axis=1)
    off += (centres * centres).sum(axis=1)[:, None] - radius * radius
    on_it = np.abs(off) < 2 * radius * np.maximum(band[0], band[1] * radius)
    strongest = (on_it.reshape(len(circles), *edges.strength.shape) * edges.strength).max(axis=2)
    return np.asarray(strongest.mean(axis=1), np.float64)


def _enclosed(around: Points, circles: Points) -> Weights:
    """Return for each circle the share of the points that it encloses, give or take 5 % of its radius."""
    dx = around[None, :, 0] - circles[:, None, 0]
    dy = around[None, :, 1] - circles[:, None, 1]
    return np.asarray((np.hypot(dx, dy) < 1.05 * circles[:, None, 2] + 1.0).mean(axis=1), np.float64)
