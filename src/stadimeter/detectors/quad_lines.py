"""Lines through the steps along the sides of outlines, and the corners where they meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.detectors.quad_frame import QuadFrame, Values

Real = TypeVar("Real", np.float32, np.float64)

MAD_TO_SIGMA = 1.4826

LIMITS_PX = (0.35, 1.5)
"""Steps further from the line than three times their usual distance do not belong to it; nor than these limits."""

BEND_SHARE = 0.004
"""The side of a real sheet is bent: steps may be so far from its line, as a share of its length."""

ROUNDS = 3
LEAST_SINE = 0.1
"""Neighbouring sides that meet at a smaller angle are not those of a sheet."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class QuadLines:
    """A line for each side, as a difference from where it was expected: offset + slope * (along - middle).

    Attributes:
        middle: Shape ``(c, 4, 1)``.
        offset: Shape ``(c, 4, 1)``.
        slope: Shape ``(c, 4, 1)``.
        used: Which steps lie on the line, shape ``(c, 4, n)``.
        scatter_px: Standard deviation of these steps about it, shape ``(c, 4)``.
    """

    middle: Values
    offset: Values
    slope: Values
    used: NDArray[np.bool_]
    scatter_px: Values

    @property
    def steps(self) -> NDArray[np.int64]:
        """How many steps each line was fitted to, shape ``(c, 4)``."""
        return np.asarray(self.used.sum(axis=2), np.int64)


def fit_lines(frame: QuadFrame, across: Values, worth: Values) -> QuadLines:
    """Fit lines by least squares with Tukey's weights, from the line that most steps agree on.

    Args:
        frame: Where the sides are expected.
        across: Where the steps are, shape ``(c, 4, n)``.
        worth: How much each counts, shape ``(c, 4, n)``; 0 for what is no step.

    Returns:
        The lines.
    """
    middle = (frame.along[..., :1] + frame.along[..., -1:]) / 2
    along, off = frame.along - middle, across - frame.across
    widest = np.maximum(LIMITS_PX[1], BEND_SHARE * frame.length_px)
    offset, slope = _most_agreed(along, off, worth > 0, widest / frame.cosine)
    limit = widest
    distance = (off - offset - slope * along) * frame.cosine
    for _ in range(ROUNDS):
        limit = _limit(distance, (worth > 0) & (np.abs(distance) < limit), widest)
        weight = np.maximum(1 - (distance / limit) ** 2, 0) ** 2 * worth
        offset, slope = _weighted_lines(along, off, weight)
        distance = (off - offset - slope * along) * frame.cosine
    used = (worth > 0) & (np.abs(distance) < limit)
    scatter = np.sqrt((used * distance**2).sum(axis=2) / np.maximum(used.sum(axis=2) - 2, 1))
    return QuadLines(middle=middle, offset=offset, slope=slope, used=used, scatter_px=scatter)


def intersections(frame: QuadFrame, lines: QuadLines) -> Points:
    """Return the corners between neighbouring lines, ``(c, 4, 2)``; NaN where two of them are all but parallel."""
    slope = (frame.slope + lines.slope)[..., 0]
    level = (frame.at_zero + lines.offset - lines.slope * lines.middle)[..., 0]
    # A side across = slope * along + level as a x + b y = level, where along is x for the flat ones.
    flat = frame.flat[..., 0]
    a, b = np.where(flat, -slope, 1.0), np.where(flat, 1.0, -slope)
    before = [3, 0, 1, 2]
    determinant = a[:, before] * b - b[:, before] * a
    length = np.hypot(a, b)
    safe = np.where(np.abs(determinant) > LEAST_SINE * length * length[:, before], determinant, np.nan)
    x = (level[:, before] * b - b[:, before] * level) / safe
    y = (a[:, before] * level - level[:, before] * a) / safe
    return np.stack((x, y), axis=2)


def median(rows: NDArray[Real]) -> NDArray[Real]:
    """Return the (upper) median along the last axis, which stays with length 1; sooner than numpy's for so few."""
    half = rows.shape[-1] // 2
    return np.partition(rows, half, axis=-1)[..., half : half + 1]


def _most_agreed(along: Values, off: Values, found: NDArray[np.bool_], limit: Values) -> tuple[Values, Values]:
    """Return the line through two steps to which most steps are near; of lines through pairs far from each other."""
    count = along.shape[2]
    half, third = count // 2, (count + 2) // 3
    first = np.concatenate((np.arange(count - half), np.arange(0, count - third, 2)))
    second = np.concatenate((np.arange(half, count), np.arange(third, count, 2)))
    apart = along[..., second] - along[..., first]
    slopes = (off[..., second] - off[..., first]) / np.where(apart == 0, np.inf, apart)
    offsets = off[..., first] - slopes * along[..., first]
    slopes = slopes * (np.abs(slopes) < 1)
    near = np.abs(off[..., None, :] - offsets[..., None] - slopes[..., None] * along[..., None, :]) / limit[..., None]
    votes = (np.maximum(1 - near * near, 0) * found[..., None, :]).sum(axis=3)
    best = np.argmax(votes * found[..., first] * found[..., second], axis=2)[..., None]
    return np.take_along_axis(offsets, best, 2), np.take_along_axis(slopes, best, 2)


def _limit(distance: Values, used: NDArray[np.bool_], widest: Values) -> Values:
    """Return how far from its line a step may be: three times the usual distance of those near it."""
    ordered = np.sort(np.where(used, np.abs(distance), np.inf), axis=2)
    half = np.maximum(used.sum(axis=2, keepdims=True) // 2, 0)
    usual = np.take_along_axis(ordered, np.minimum(half, ordered.shape[2] - 1), 2)
    return np.minimum(np.maximum(3 * MAD_TO_SIGMA * usual, LIMITS_PX[0]), widest)


def _weighted_lines(along: Values, off: Values, weight: Values) -> tuple[Values, Values]:
    weighted = weight * along
    total = np.maximum(weight.sum(axis=2, keepdims=True), 1e-9)
    first, second = weighted.sum(axis=2, keepdims=True), (weighted * along).sum(axis=2, keepdims=True)
    height, together = (weight * off).sum(axis=2, keepdims=True), (weighted * off).sum(axis=2, keepdims=True)
    slope = (together - first * height / total) / np.maximum(second - first * first / total, 1e-9)
    return (height - slope * first) / total, slope
