"""The circle of edges around a blob that is not round: a first guess where the blob itself gives none.

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
from stadimeter.detectors.circle_fit import Circle, Weights, find_circle
from stadimeter.detectors.sampling import sample

RADIALS = 96
"""In how many directions the limb is looked for."""

EDGES_PER_RADIAL = 3
"""How many edges are kept in each: the limb is not always the strongest."""

NEAREST, FURTHEST = 0.35, 2.0
"""Where the limb is looked for, in half sizes of the blob, from its middle."""

LEAST_STEP = 6.0
"""Edges of fewer levels of 8 bits a pixel are noise."""

BAND_PX = 1.5
BAND_SHARE = 0.08
"""How far from the circle its points may lie: for pixels, felt and blur; and for the ellipse that a ball looks like
away from the optical axis."""


@dataclass(frozen=True, slots=True)
class _Edges:
    """Edges that were found along radials.

    Attributes:
        points_px: Where they are, shape ``(n, 2)``.
        strength: How steep they are, 1 for those as steep as the steepest in most directions, shape ``(n,)``.
    """

    points_px: Points
    strength: Weights


def edge_circle(image: Image, blob_px: Points, area_px2: float) -> Circle | None:
    """Find the circle of edges around a blob.

    Args:
        image: The picture, three channels.
        blob_px: Points along the outline of the blob, shape ``(n, 2)``.
        area_px2: The blob's area.

    Returns:
        The circle, or None if there is none of edges that has the blob inside.
    """
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
    """Return the strongest edges along radials, those inside the picture.

    The distances are evenly spaced along each radial, shape ``(RADIALS, k)``.
    """
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
