"""Lines through the steps along the sides of a tag, and the corners where they meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.detectors.tag_frame import OfSides, SideFrame

Values = NDArray[np.float64]
Real = TypeVar("Real", np.float32, np.float64)

MAD_TO_SIGMA = 1.4826

LIMITS_PX = (0.35, 1.5)
"""Steps further from the line than three times their usual distance do not belong to it; nor than these limits."""

LEAST_SINE = 0.1
"""Neighbouring sides that meet at a smaller angle are not those of a tag."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TagLines:
    """A line for each side, as a difference from where it was expected: offset + slope * (along - middle).

    Attributes:
        offset: Shape ``(4, 1)``.
        slope: Shape ``(4, 1)``.
        support: The share of the steps along each side that lie on its line.
        scatter_px: Standard deviation of these steps about each line.
        steps: How many these are.
    """

    offset: Values
    slope: Values
    support: OfSides
    scatter_px: OfSides
    steps: tuple[int, ...]


def fit_lines(frame: SideFrame, off: Values, found: NDArray[np.bool_], *, refit: bool) -> TagLines:
    """Fit lines by least squares with Tukey's weights, from a line through medians, which outliers do not move.

    Args:
        frame: Where the sides are expected.
        off: How far across from there the steps are, shape ``(4, n)``.
        found: Which of them are steps, shape ``(4, n)``.
        refit: Whether the line is fitted again; otherwise it is the one through the medians.

    Returns:
        The lines.
    """
    along = frame.from_middle
    half = along.shape[1] // 2
    slope = median((off[:, -half:] - off[:, :half]) / (along[:, -half:] - along[:, :half]))
    rest = off - slope * along
    offset = median(rest)
    distance = (rest - offset) * frame.cosine
    limit = _limit(distance)
    if refit:
        distance /= limit
        weight = np.maximum(1 - distance * distance, 0)
        weight *= weight
        weight *= found
        offset, slope = _weighted_lines(along, off, weight)
        distance = (off - offset - slope * along) * frame.cosine
    used = (np.abs(distance) < limit) & found
    steps = used.sum(axis=1).tolist()
    squares = np.add.reduce(distance * distance * used, axis=1).tolist()
    return TagLines(
        offset=offset,
        slope=slope,
        support=tuple([each / used.shape[1] for each in steps]),
        scatter_px=tuple([(of_side / max(n - 2, 1)) ** 0.5 for of_side, n in zip(squares, steps, strict=True)]),
        steps=tuple(steps),
    )


def intersections(frame: SideFrame, lines: TagLines) -> Points | None:
    """Return the corners between neighbouring lines, shape ``(4, 2)``; None where two of them are all but parallel."""
    changes = np.concatenate((lines.slope, lines.offset - lines.slope * frame.middle), axis=1).tolist()
    # A side across = slope * along + at_zero as a x + b y = c, where along is x for the flat ones.
    sides = []
    for side, (steeper, higher) in zip(frame.sides, changes, strict=True):
        slope, at_zero = side.slope + steeper, side.at_zero + higher
        sides.append((-slope, 1.0, at_zero) if side.flat else (1.0, -slope, at_zero))
    met = []
    for number in range(4):
        (a, b, c), (d, e, f) = sides[number - 1], sides[number]
        determinant = a * e - b * d
        if not abs(determinant) > LEAST_SINE:
            return None
        met.append(((c * e - b * f) / determinant, (a * f - c * d) / determinant))
    return np.array(met)


def median(rows: NDArray[Real]) -> NDArray[Real]:
    """Return the (upper) median of each row, shape ``(n, 1)``; ten times as fast as numpy's for so few."""
    half = rows.shape[1] // 2
    ordered = rows.copy()
    ordered.partition(half, axis=1)
    return ordered[:, half : half + 1]


def _limit(distance: Values) -> Values:
    """Return how far from its line a step may be."""
    usual = MAD_TO_SIGMA * median(np.abs(distance))
    return np.minimum(np.maximum(3 * usual, LIMITS_PX[0]), LIMITS_PX[1])


def _weighted_lines(along: Values, off: Values, weight: Values) -> tuple[Values, Values]:
    """Return offset and slope of the lines that are nearest to the steps, each with its weight."""
    terms = np.empty((5, *weight.shape))
    terms[0] = weight
    np.multiply(weight, along, out=terms[1])
    np.multiply(terms[1], along, out=terms[2])
    np.multiply(weight, off, out=terms[3])
    np.multiply(terms[1], off, out=terms[4])
    lines = []
    for total, first, second, height, together in np.add.reduce(terms, axis=2).T.tolist():
        mean = first / max(total, 1e-9)
        slope = (together - mean * height) / max(second - mean * first, 1e-9)
        lines.append(((height - slope * first) / max(total, 1e-9), slope))
    offset, slopes = np.array(lines).T[:, :, None]
    return offset, slopes
