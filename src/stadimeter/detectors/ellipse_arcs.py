"""Ellipses of which only a part is seen: something hides the rest, or looks like it, or the picture ends there.

Ellipses through pieces of an outline are tried, and the one that most of the outline lies on is taken.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.detectors.ellipse_search import LEAST_ASPECT, Outline, distinct, most_off_px, root_mean_square
from stadimeter.detectors.ellipse_shape import Ellipse, ellipse_through

LEAST_SIZE_PX = 16.0
"""The pieces of smaller outlines are too short to tell an ellipse from."""

LEAST_LEFT = 0.55
"""How much of an outline must be left."""

POINTS = 96
PIECE_POINTS = (24, 48)
PIECES = 8
"""So many points of an outline are taken, and at so many places among them pieces of these lengths begin."""

TIMES_OFF = 1.5
"""Points that are off by less than so many times what a whole outline may be are on the ellipse."""

ON_PIECE_PX = 2.0
"""Points that are off by less are on the ellipse through a piece."""

FITS = 3
BORDER_PX = 2

_STARTS = np.concatenate([np.arange(0, POINTS, POINTS // PIECES) for _ in PIECE_POINTS])
_ENDS = _STARTS + np.repeat(PIECE_POINTS, PIECES)

Conics = NDArray[np.float64]


def find_partly_hidden(outlines: Iterable[Outline], shape: tuple[int, int]) -> list[Outline]:
    """Find ellipses of which a part is hidden, or cut off by the border of the picture.

    Args:
        outlines: What is not elliptical as a whole.
        shape: Height and width of the picture.

    Returns:
        The ellipses that most of an outline lies on, the largest first.
    """
    found = (_most_of(each, shape) for each in outlines if each.size_px > LEAST_SIZE_PX)
    return distinct([each for each in found if each is not None])


def _most_of(outline: Outline, shape: tuple[int, int]) -> Outline | None:
    """Return the ellipse that most of an outline lies on; the border of the picture is no part of it."""
    contour = outline.shape.contour
    points = contour[np.arange(POINTS) * len(contour) // POINTS, 0].astype(np.float64)
    inner = ((points >= BORDER_PX) & (points < np.array(shape[::-1]) - BORDER_PX)).all(axis=1)
    ellipse = ellipse_through(points[_on_best_piece(points, inner)])
    for _ in range(FITS):
        ellipse = None if ellipse is None else ellipse_through(points[inner & _is_on(ellipse, points)])
    if ellipse is None:
        return None
    larger, smaller, _ = ellipse.axes()
    on_it = inner & _is_on(ellipse, points)
    # Steps from pixel to pixel are longer across a diagonal: there are 0.9 pixels on each pixel of length.
    length_px = np.count_nonzero(on_it) * len(contour) / POINTS
    is_left = length_px > 0.9 * LEAST_LEFT * ellipse.perimeter_px()
    if not (is_left and LEAST_SIZE_PX < 2 * larger < 2 * max(shape) and smaller > LEAST_ASPECT * larger):
        return None
    return outline._replace(
        ellipse=ellipse, size_px=2 * larger, off_px=root_mean_square(ellipse.distances_px(points[on_it]))
    )


def _on_best_piece(points: Points, inner: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which points are on that ellipse through a piece of them that most are on."""
    middle = points.mean(axis=0)
    size_px = max(math.sqrt(float(np.mean((points - middle) ** 2))), 1.0)
    x, y = ((points - middle) / size_px).T
    rows = np.stack((x * x, x * y, y * y, x, y), axis=1)
    a, b, c, d, e = (each[:, None] for each in _conics(rows * inner[:, None]).T)
    off = a * x * x + b * x * y + c * y * y + d * x + e * y - 1
    # How far off a point is in space, to first order (P. Sampson, 1982).
    steepness = np.hypot(2 * a * x + b * y + d, b * x + 2 * c * y + e)
    is_on = inner & _is_ellipse(a, b, c, d, e) & (np.abs(off) < ON_PIECE_PX / size_px * np.maximum(steepness, 1e-9))
    return np.asarray(is_on[int(np.argmax(is_on.sum(axis=1)))])


def _is_ellipse(a: Conics, b: Conics, c: Conics, d: Conics, e: Conics) -> NDArray[np.bool_]:
    """Say which conics are ellipses with points on them; the middle of the outline need not be inside."""
    area = 4 * a * c - b * b
    safe = np.where(area > 0, area, 1.0)
    x, y = (b * e - 2 * c * d) / safe, (b * d - 2 * a * e) / safe
    return np.asarray((area > 0) & (((d * x + e * y) / 2 - 1) * a < 0), np.bool_)


def _conics(rows: NDArray[np.float64]) -> Conics:
    """Return the conic through each piece, ``a x² + b x y + c y² + d x + e y = 1``, shape ``(pieces, 5)``."""
    twice = np.concatenate((rows, rows))
    squares = np.concatenate((np.zeros((1, 5, 5)), np.cumsum(twice[:, :, None] * twice[:, None, :], axis=0)))
    sums = np.concatenate((np.zeros((1, 5)), np.cumsum(twice, axis=0)))
    normal = squares[_ENDS] - squares[_STARTS] + 1e-9 * np.eye(5)
    return np.asarray(np.linalg.solve(normal, (sums[_ENDS] - sums[_STARTS])[:, :, None])[:, :, 0])


def _is_on(ellipse: Ellipse, points: Points) -> NDArray[np.bool_]:
    return np.asarray(np.abs(ellipse.distances_px(points)) < TIMES_OFF * most_off_px(ellipse), np.bool_)
