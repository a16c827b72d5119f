"""Sides of outlines: where they are expected, in whole pixels along and across, and lines fitted to their steps.

Along is x for a side that is more horizontal and y for one that is more vertical; across is the other one. Many
outlines are worked on at once: arrays have the outlines first, then their four sides, then the steps along a side.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Flags, Indices, Points, Values
from stadimeter.detectors.sampling import Real
from stadimeter.detectors.sides import LIMITS_PX, MAD_TO_SIGMA, MIN_SINE, areas, step_shares

# Greatest reach across a side, as a share of the distance to the opposite one: looks of opposite sides must not meet.
REACH_SHARE = 0.3

# Least reach, in pixels: an edge of one pixel, and one beside it.
MIN_REACH_PX = 2

# Points between two corners at which the bend of a side by the lens is computed.
CURVE_POINTS = 33


class QuadFrame(Struct, frozen=True, kw_only=True, eq=False):
    """Expected sides. Arrays are of shape ``(c, 4, n)``, or ``(c, 4, 1)`` where nothing else is said."""

    flat: Flags  # which sides are more horizontal
    outward: Indices  # which way across leads out of the outline, 1 or -1
    along: Values  # where the steps are looked for: whole pixels, with n steps
    across: Values  # where the side is expected there, with n steps; bent as the lens bends it
    pixel: Values  # the pixel there, or the nearest one with room for the reach around it, with n steps
    slope: Values  # how the straight line between the corners rises across
    at_zero: Values  # where it crosses along = 0
    cosine: Values  # what turns a difference across into a distance from the side
    length_px: Values  # how long the side is
    reach: Indices  # how many pixels are looked at in each direction


def quad_frame(
    corners_px: Points, steps: int, reach_px: Values, shape: tuple[int, ...], lens: CameraModel | None = None
) -> QuadFrame:
    """Return where the sides between corners, ``(c, 4, 2)``, are; small outlines are looked across less far."""
    # The arrays of `stadimeter.detectors.sides.SideLine`, for many outlines at once.
    vector = corners_px[:, [1, 2, 3, 0]] - corners_px
    size = np.abs(vector)
    flat = size[..., 0] >= size[..., 1]
    forward, sideways = _along_first(vector, flat)
    start, level = _along_first(corners_px, flat)
    forward = np.where(forward == 0, 1e-9, forward)
    slope = sideways / forward
    at_zero = level - slope * start
    length_px = np.hypot(forward, sideways)
    cosine = np.abs(forward) / length_px
    height, width = shape[:2]
    last_along, last_across = (np.where(flat, *ends)[..., None] - 1 for ends in ((width, height), (height, width)))
    # Whole pixels along, kept inside the picture: a side that the border cuts runs along it.
    along = np.minimum(np.maximum(np.rint(start[..., None] + step_shares(steps) * forward[..., None]), 0), last_along)
    across = at_zero[..., None] + slope[..., None] * along
    if lens is not None and lens.distortion:
        # Far outside the picture the lens has no inverse; a side from there is taken to be straight.
        across = across + np.nan_to_num(bend(corners_px, flat, along, lens), nan=0.0, posinf=0.0, neginf=0.0)
    # The area over the length of a side is how far the opposite one lies from it; the cosine turns that into pixels
    # across.
    most = REACH_SHARE * (areas(corners_px)[:, None] / length_px) / cosine
    reach = np.maximum(np.minimum(np.ceil(reach_px), most), MIN_REACH_PX).astype(np.int64)
    reach = np.minimum(reach, max((min(height, width) - 1) // 2, 0))
    widest = reach[..., None]
    return QuadFrame(
        flat=flat[..., None],
        outward=np.where((forward > 0) == flat, -1, 1)[..., None],
        along=along,
        across=across,
        pixel=np.minimum(np.maximum(np.rint(across), widest), last_across - widest),
        slope=slope[..., None],
        at_zero=at_zero[..., None],
        cosine=cosine[..., None],
        length_px=length_px[..., None],
        reach=widest,
    )


def _along_first(pairs: Points, flat: Flags) -> tuple[Values, Values]:
    x, y = pairs[..., 0], pairs[..., 1]
    return np.where(flat, x, y), np.where(flat, y, x)


def bend(corners: Points, flat: Flags, along: Values, lens: CameraModel) -> Values:
    """Return the distance of each side from the straight line between its corners: it is straight before the lens."""
    # A straight side is straight in directions (x and y per unit of depth, distortion undone), so points on it are
    # found there and projected back: CURVE_POINTS of them, and between them the bend is interpolated.
    count = len(corners)
    ends = lens.directions(corners.reshape(-1, 2)).reshape(count, 4, 1, 2)
    shares = np.linspace(0, 1, CURVE_POINTS)[:, None]
    straight = ends + (ends[:, [1, 2, 3, 0]] - ends) * shares
    seen = lens.project(straight.reshape(-1, 2)).reshape(count, 4, CURVE_POINTS, 2)
    seen_along, seen_across = _along_first(seen, flat[..., None])
    first, last = seen_across[..., :1], seen_across[..., -1:]
    run = seen_along[..., -1:] - seen_along[..., :1]
    # `part` and `wanted` count along from 0 at the first corner to 1 at the next, on which the interpolation runs
    # upwards.
    part = (seen_along - seen_along[..., :1]) / run
    off = np.nan_to_num(seen_across - first - (last - first) * part)
    wanted = (along - seen_along[..., :1]) / run
    bent = [np.interp(wanted[i, side], part[i, side], off[i, side]) for i in range(count) for side in range(4)]
    return np.array(bent).reshape(along.shape)


# The side of a real sheet is bent: steps may be this far from its line, as a share of its length.
BEND_SHARE = 0.004

# Rounds of Tukey's weights, from the line of the vote.
ROUNDS = 3


class QuadLines(Struct, frozen=True, kw_only=True, eq=False):
    """A line for each side, as a difference from where it was expected: offset + slope * (along - middle)."""

    middle: Values  # shape ``(c, 4, 1)``
    offset: Values  # shape ``(c, 4, 1)``
    slope: Values  # shape ``(c, 4, 1)``
    used: Flags  # which steps lie on the line, shape ``(c, 4, n)``
    scatter_px: Values  # standard deviation of these steps about it, shape ``(c, 4)``
    steps: Indices  # how many these are, shape ``(c, 4)``


def fit_lines(frame: QuadFrame, across: Values, worth: Values) -> QuadLines:
    """Fit lines by least squares with Tukey's weights, from the line that most steps agree on.

    Places and weights of the steps have the shape ``(c, 4, n)``; the weight is 0 for what is no step.
    """
    middle = (frame.along[..., :1] + frame.along[..., -1:]) / 2
    along, off, found = frame.along - middle, across - frame.across, worth > 0
    widest = np.maximum(LIMITS_PX[1], BEND_SHARE * frame.length_px)
    # Steps of a finger or of what lies behind are no noise but another edge. Least squares would settle between both,
    # so the start is a vote (as in RANSAC, but over fixed pairs: the same picture gives the same line).
    offset, slope = line_by_vote(along, off, found, widest / frame.cosine)
    # Distances are square to the side, not across. The limit starts as wide as it may be, and shrinks with the scatter
    # from round to round.
    limit = widest
    distance = (off - offset - slope * along) * frame.cosine
    # Of each step 1, x, x^2, y and x y: the weighted sums of these are all that a line's normal equations need, and a
    # matrix product adds them up for all sides at once.
    terms = np.stack((np.ones_like(along), along, along * along, off, along * off), axis=3)
    for _ in range(ROUNDS):
        limit = _limit(np.abs(distance), found, limit, widest)
        weight = np.maximum(1 - (distance / limit) ** 2, 0) ** 2 * worth
        offset, slope = _weighted_lines(terms, weight)
        distance = (off - offset - slope * along) * frame.cosine
    used = found & (np.abs(distance) < limit)
    steps = np.add.reduce(used, axis=2)
    scatter = np.sqrt(np.add.reduce(used * distance**2, axis=2) / np.maximum(steps - 2, 1))
    return QuadLines(middle=middle, offset=offset, slope=slope, used=used, scatter_px=scatter, steps=steps)


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
    # Cramer's rule. Lines that meet at a smaller angle than MIN_SINE give NaN, which later tests refuse.
    safe = np.where(np.abs(determinant) > MIN_SINE * length * length[:, before], determinant, np.nan)
    x = (level[:, before] * b - b[:, before] * level) / safe
    y = (a[:, before] * level - level[:, before] * a) / safe
    return np.stack((x, y), axis=2)


def line_by_vote(along: Values, off: Values, found: Flags, limit: Values) -> tuple[Values, Values]:
    """Return the line through two steps to which most steps are near; of lines through pairs far from each other."""
    # Pairs of steps half a side apart, and a third apart: a line through near ones would be unsure, and with only one
    # distance an occluder of half a side would spoil every pair.
    count = along.shape[2]
    half, third = count // 2, (count + 2) // 3
    first = np.concatenate((np.arange(count - half), np.arange(0, count - third, 2)))
    second = np.concatenate((np.arange(half, count), np.arange(third, count, 2)))
    start, off_start = along.take(first, axis=2), off.take(first, axis=2)
    apart = along.take(second, axis=2) - start
    slopes = (off.take(second, axis=2) - off_start) / np.where(apart == 0, np.inf, apart)
    offsets = off_start - slopes * start
    # Differences of slope above 1 would turn a side from flat to steep: such a pair stands for another edge. Each step
    # then votes for each line with 1 - (distance / limit)^2, so near ones count most.
    slopes = slopes * (np.abs(slopes) < 1)
    near = np.abs(off[..., None, :] - offsets[..., None] - slopes[..., None] * along[..., None, :]) / limit[..., None]
    votes = (np.maximum(1 - near * near, 0) @ found[..., None].astype(np.float64))[..., 0]
    # A line counts only if both of the steps that it leads through were found.
    best = (votes * found.take(first, axis=2) * found.take(second, axis=2)).argmax(axis=2)[..., None]
    return picked(offsets, best), picked(slopes, best)


def picked(values: NDArray[Real], places: Indices) -> NDArray[Real]:
    """Return one of the values along the last axis each, in a quarter of the time of `np.take_along_axis`."""
    return values.reshape(-1).take(places + np.arange(0, values.size, values.shape[-1]).reshape(places.shape))


def _limit(off_px: Values, found: Flags, limit: Values, widest: Values) -> Values:
    """Return the distance a step may be from its line: three times the usual distance of those near it."""
    # The median of the used ones only: the others are sorted to the end as infinity.
    used = found & (off_px < limit)
    ordered = np.sort(np.where(used, off_px, np.inf), axis=2)
    usual = picked(ordered, np.minimum(np.add.reduce(used, axis=2, keepdims=True) // 2, ordered.shape[2] - 1))
    return np.minimum(np.maximum(3 * MAD_TO_SIGMA * usual, LIMITS_PX[0]), widest)


def _weighted_lines(terms: Values, weight: Values) -> tuple[Values, Values]:
    """Return the lines that fit best, from 1, along, along², off and along · off of each step, ``(c, 4, n, 5)``."""
    sums = weight[:, :, None] @ terms
    total, first, second, height, together = (sums[..., which] for which in range(5))
    total = np.maximum(total, 1e-9)
    slope = (together - first * height / total) / np.maximum(second - first * first / total, 1e-9)
    return (height - slope * first) / total, slope
