"""Circles through points of which many do not belong to it, and the circle of edges around a blob that is not round.

A range of colours hardly ever covers a whole ball: one side is in the shade, felt fades towards the limb, a seam or a
finger crosses it. Then the blob only says where to look. All strong edges around it are collected, and the circle with
the most of them on it is where the limb may be.
"""

from __future__ import annotations

from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from stadimeter.core.detection import Indices, Points, Values
from stadimeter.core.frame import Image

# In how many directions the limb is looked for.
RADIALS = 96

# Half the size of the blob is this many steps along a radial.
STEPS_A_HALF = 40

# Edges kept in each: the limb is not always the strongest.
EDGES_PER_RADIAL = 3

# Range of the search for the limb, in half sizes of the blob from its centre.
MIN_REACH, MAX_REACH = 0.35, 2.0

# Edges of fewer levels of 8 bits a pixel are noise.
MIN_STEP = 6.0

# Greatest distance of points from the circle: for pixels, felt and blur; and for the ellipse that a ball looks like
# away from the optical axis.
BAND_PX = 1.5
BAND_SHARE = 0.08


# With a quarter of the points on the circle, 400 triples miss it twice in a thousand times; with a third, never.
TRIES = 400

# With half of the points on the circle, 64 triples miss it twice in ten thousand times.
FEW_TRIES = 64

# Number of circles that are held against all edges.
MAX_CIRCLES_HELD = 128

MIN_EDGES = 6

# The product with these is the sum over the channels, several times as fast as numpy's.
CHANNELS = np.ones(3, np.float32)

# Steps of three sequences that fill a cube evenly: powers of the root of ``x⁴ = x + 1``.
EVENLY = 1 / 1.2207440846057596 ** np.arange(1, 4)


class ImageCircle(Struct, frozen=True, kw_only=True):
    """A circle in pixels."""

    x_px: float
    y_px: float
    radius_px: float


class Edges(NamedTuple):
    """Edges along radials, the strongest of each: a row for each radial."""

    points_px: Points  # where they are, shape ``(n, k, 2)``
    # How steep they are, 1 for those as steep as the steepest in most directions, 0 for none, shape ``(n, k)``.
    strength: Values


def find_edge_circle(image: Image, blob_px: Points, area_px2: float) -> ImageCircle | None:
    """Find the circle of edges around a blob's outline, shape ``(n, 2)``; None if none has the blob inside."""
    # Radials start at 0.35 of the half size, where a blob that is only the lit part of a ball may have its limb, and
    # end at twice it. Half a pixel is added because points are centres of pixels.
    low, high = blob_px.min(axis=0), blob_px.max(axis=0)
    centre, half_px = (low + high) / 2, float((high - low).max()) / 2 + 0.5
    step_px = max(0.5, half_px / STEPS_A_HALF)
    distances = np.arange(MIN_REACH * half_px, MAX_REACH * half_px + 3 * step_px, step_px)
    return find_circle(_find_edges(image, centre, distances), blob_px, area_px2, (max(BAND_PX, step_px), BAND_SHARE))


def find_circle(edges: Edges, around_px: Points, area_px2: float, band: tuple[float, float]) -> ImageCircle | None:
    """Find the circle with strong edges on most radials that is filled by something; None if none is.

    Circles through three edges each are tried. The same edges always give the same circle.

    Args:
        around_px: Points that the circle should enclose, shape ``(m, 2)``.
        area_px2: The area of what should fill it.
        band: How far from a circle its edges may lie: in pixels, and as a share of the radius if that is more.
    """
    points = edges.points_px[edges.strength > 0]
    if len(points) < MIN_EDGES:
        return None
    circles = _circles_through_triples(points, TRIES)
    if not len(circles):
        return None
    # A circle much larger than what fills it is chance; the root keeps a ball of which only the lit part has
    # the colour.
    fill = np.minimum(1.0, area_px2 / (np.pi * circles[:, 2] ** 2))
    worth = _enclosed_share(around_px, circles) * np.sqrt(fill)
    # What a circle encloses is quickly told; only the best by that are held against all edges.
    tried = np.argsort(-worth, kind="stable")[:MAX_CIRCLES_HELD]
    score = worth[tried] * _support(edges, circles[tried], band)
    best = int(np.argmax(score))
    if not score[best] > 0:
        return None
    x, y, radius = (float(value) for value in circles[tried[best]])
    return ImageCircle(x_px=x, y_px=y, radius_px=radius)


def _find_edges(image: Image, centre: Points, distances_px: Points) -> Edges:
    """Return the strongest edges inside the picture along radials, at even distances from the centre."""
    across, down = _directions()
    (x, y), (height, width) = centre.tolist(), image.shape[:2]
    columns = np.rint(x + across * distances_px).clip(0, width - 1)
    rows = np.rint(y + down * distances_px).clip(0, height - 1)
    # Nearest pixels, not interpolated ones: the circle is only where the fine fit starts.
    nearest = (rows * width + columns).astype(np.intp)
    values = image.reshape(-1, 3).take(nearest, axis=0).astype(np.float32)
    # Difference of the mean of two samples after and of two before, for each of the channels: less noise than single
    # differences. The sum over the channels of its square is the squared steepness, in levels per step; divided by 4
    # (two pairs, two steps between their middles) times the step it is per pixel.
    change = values[:, 3:] + values[:, 2:-1] - values[:, 1:-2] - values[:, :-3]
    step_px = float(distances_px[1] - distances_px[0])
    change *= change
    steepness = np.sqrt(change.reshape(-1, 3).dot(CHANNELS)).reshape(change.shape[:2]) / (4 * step_px)
    # Beyond the border its pixels are repeated, which shows no edges.
    places, peak = _peaks(steepness)
    found_px = distances_px[places] + 1.5 * step_px
    # Strength relative to the median of the radials' steepest edges: it depends on the contrast of the scene, not on
    # its light.
    usual = max(float(np.median(steepness.max(axis=1))), MIN_STEP)
    points = np.stack([x + across * found_px, y + down * found_px], axis=-1)
    return Edges(points, np.minimum(1.0, peak / usual))


@cache
def _directions() -> tuple[Values, Values]:
    """Return the directions of the radials, x and y, shape ``(RADIALS, 1)`` each."""
    angles = np.arange(RADIALS)[:, None] * (2 * np.pi / RADIALS)
    return np.cos(angles), np.sin(angles)


def _peaks(steepness: Values) -> tuple[Indices, Values]:
    """Return the highest local maxima of each row: their columns, and how high they are; 0 where there are fewer."""
    middle, before, after = steepness[:, 1:-1], steepness[:, :-2], steepness[:, 2:]
    peak = middle * ((middle >= before) & (middle > after) & (middle > MIN_STEP / 2))
    left, each = peak.copy(), np.arange(len(peak))
    columns = np.empty((len(peak), EDGES_PER_RADIAL), np.intp)
    for rank in range(EDGES_PER_RADIAL):
        columns[:, rank] = left.argmax(axis=1)
        left[each, columns[:, rank]] = -1.0
    return columns + 1, peak[each[:, None], columns]


def find_common_circle(points_px: Points) -> ImageCircle | None:
    """Find the circle within a pixel of which most of the points lie; None if no three of them form one.

    Circles through three points each are tried. The same points always give the same circle.
    """
    circles = _circles_through_triples(points_px, FEW_TRIES)
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


def _support(edges: Edges, circles: Points, band: tuple[float, float]) -> Values:
    """Return for each circle the mean over the radials of the strongest edge on it there."""
    middle = edges.points_px.reshape(-1, 2).mean(axis=0)
    points, centres, radius = edges.points_px.reshape(-1, 2) - middle, circles[:, :2] - middle, circles[:, 2:]
    # |p - c|² - r² = (|p - c| - r)(|p - c| + r) is about 2 r times how far a point is from the circle.
    off = centres @ (-2 * points.T) + (points * points).sum(axis=1)
    off += (centres * centres).sum(axis=1)[:, None] - radius * radius
    on_it = np.abs(off) < 2 * radius * np.maximum(band[0], band[1] * radius)
    # The strongest of a radial, one for each rank: numpy is slow along an axis of three.
    strength = (on_it * edges.strength.ravel()).reshape(len(circles), *edges.strength.shape)
    strongest = strength[..., 0]
    for rank in range(1, strength.shape[-1]):
        strongest = np.maximum(strongest, strength[..., rank])
    return np.asarray(strongest.mean(axis=1), np.float64)


def _enclosed_share(around: Points, circles: Points) -> Values:
    """Return for each circle the share of the points that it encloses, give or take 5 % of its radius."""
    dx = around[:, 0] - circles[:, :1]
    dy = around[:, 1] - circles[:, 1:2]
    limit = 1.05 * circles[:, 2:] + 1.0
    inside = (dx * dx + dy * dy < limit * limit).astype(np.float64)
    return np.asarray(inside.dot(np.full(len(around), 1 / len(around))), np.float64)
