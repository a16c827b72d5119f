"""Outlines of four corners: their shapes, their sides as lines, and what the edge engines of sheet and tag share.

There are two engines, `stadimeter.detectors.sheet.edges` and `stadimeter.detectors.tag.sides`. Both measure one outline
at a time, with plain numbers for what is one number a side: in arrays of many outlines tags took 6 to 7 times as long.

Pixel coordinates have (0, 0) at the centre of the top left pixel, x to the right and y down. Corners come clockwise on
the screen, and side i leads from corner i to corner i + 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from stadimeter.core.detection import Indices, Points, Profiles, Values

# Share of a side left out at each end, where the other side blurs in and corners are bent, torn or rounded.
CORNER_SHARE = 0.08

# Standard deviation of a normal distribution in units of its median absolute deviation.
MAD_TO_SIGMA = 1.4826

# Steps further from the line of a side than three standard deviations are outliers; least and greatest such limit.
LIMITS_PX = (0.35, 1.5)

# Neighbouring sides that meet at a smaller angle are not those of a sheet or tag.
MIN_SINE = 0.1


class SideLine(NamedTuple):
    """The straight line from one corner to the next: across = at_zero + slope * along, in pixels.

    Along is x for a side that is more horizontal and y for one that is more vertical; across is the other coordinate.
    """

    # With the longer coordinate as along, |slope| <= 1: steps are read along whole pixels and nothing is interpolated.
    flat: bool  # whether it is more horizontal
    start: float  # along, of its first corner
    forward: float  # how far it leads along, below zero for backwards
    slope: float
    at_zero: float
    cosine: float  # turns a difference across into a distance from the side
    length_px: float
    outward: int  # which way across leads out of the outline, 1 or -1

    def strides(self, width_px: int) -> tuple[int, int]:
        """Return the number of places to the next pixel along and to the next one across, counted row by row."""
        return (1, width_px) if self.flat else (width_px, 1)


class SideFrame(NamedTuple):
    """The expected sides of one outline, and the pixels in which their steps are looked for."""

    sides: list[SideLine]
    middle: Values  # where along is the middle of the steps of each side, shape ``(4, 1)``
    from_middle: Values  # where the steps are looked for, whole pixels along less the middle, shape ``(4, n)``
    # The pixel in which the side is expected there, counted row by row, or the nearest one that may be, ``(4, n)``.
    place: Indices
    off_pixel: Values  # how much further across than this pixel the side is, ``(4, n)``; bent as the lens bends it
    stride: Indices  # how many places further on the next pixel outwards is, shape ``(4, 1)``
    outward: Values  # which way across leads out of the outline, 1 or -1, shape ``(4, 1)``
    cosine: Values  # what turns a difference across into a distance from the side, shape ``(4, 1)``

    def points(self, off_px: Values, width_px: int) -> Points:
        """Return the points so far across from where the sides are expected, shape ``(4, n, 2)``."""
        row, column = np.divmod(self.place, width_px)
        across_px, flat = off_px + self.off_pixel, np.array([[side.flat] for side in self.sides])
        return np.stack((column + across_px * ~flat, row + across_px * flat), axis=-1)


def side_frame(
    sides: list[SideLine],
    steps: int,
    shape: tuple[int, ...],
    bend: Callable[[Values], Values] | None = None,
    reach: int | None = None,
) -> SideFrame:
    """Return where steps are looked for along sides, in a picture of this height and width.

    Args:
        bend: How far across the lens bends the sides at places along them; None for not at all.
        reach: Moves pixels in from the border that have less room across than this; None where all have.
    """
    rows = [(s.start, s.forward, s.slope, s.at_zero, s.cosine, s.outward, *s.strides(shape[1])) for s in sides]
    start, forward, slope, at_zero, cosine, outward, next_along, next_across = np.array(rows).T[:, :, None]
    along = np.rint(start + step_shares(steps) * forward)
    if reach is not None:
        # Across is y for flat sides, so they may go down to the last row, and the others to the last column.
        last = np.array([shape[:2] if side.flat else shape[1::-1] for side in sides]) - 1
        along = np.minimum(np.maximum(along, 0), last[:, 1:])
    across = along * slope + at_zero
    if bend is not None:
        across += bend(along)
    # A profile is read around the nearest pixel; the rest, at most half a pixel, is added to what is found in it.
    pixel = np.rint(across)
    if reach is not None:
        pixel = np.minimum(np.maximum(pixel, reach), last[:, :1] - reach)
    middle = (along[:, :1] + along[:, -1:]) / 2
    return SideFrame(
        sides=sides,
        middle=middle,
        from_middle=along - middle,
        place=(pixel * next_across + along * next_along).astype(np.intp),
        off_pixel=across - pixel,
        stride=(next_across * outward).astype(np.intp),
        outward=outward,
        cosine=cosine,
    )


def side_lines(corners: list[list[float]]) -> list[SideLine]:
    """Return the lines between neighbouring corners, x and y each."""
    return [_side_line(corners[number], corners[number - 3]) for number in range(4)]


def _side_line(start: list[float], end: list[float]) -> SideLine:
    x, y = end[0] - start[0], end[1] - start[1]
    flat = abs(x) >= abs(y)
    forward, sideways = (x, y) if flat else (y, x)
    first, level = start if flat else (start[1], start[0])
    length_px = math.hypot(x, y)
    slope = sideways / forward if forward else 0.0
    cosine = abs(forward) / length_px if length_px else 1.0
    # Clockwise on the screen, the top side leads to the right and has its outside above it, at smaller y; the right
    # side leads down and has its outside at larger x.
    outward = -1 if (forward > 0) == flat else 1
    return SideLine(flat, first, forward, slope, level - slope * first, cosine, length_px, outward)


@cache
def step_shares(steps: int) -> Values:
    """Return where along a side its steps are looked for, as shares of its length."""
    return np.linspace(CORNER_SHARE, 1 - CORNER_SHARE, steps)


@cache
def pixels_across(reach: int) -> Indices:
    """Return the number of pixels outwards of each row of a profile across a side, shape ``(2 * reach + 1, 1, 1)``."""
    return np.arange(-reach, reach + 1)[:, None, None]


def steepest_fall(share: Profiles) -> tuple[Indices, Profiles, Profiles]:
    """Return where profiles fall most from above 0 to below it: the pixel before, by how much, and the share there.

    Profiles run along the first axis: half a step is 0.5 inside of the outline and -0.5 outside.
    """
    is_in = share >= 0
    drops = share[:-1] - share[1:]
    drops *= is_in[:-1] > is_in[1:]
    best = drops.argmax(axis=0)
    # `take` wants flat indices: row times row length plus column.
    place = best * best.size + _columns(*best.shape)
    return best, drops.take(place), share.take(place)


@cache
def _columns(sides: int, steps: int) -> Indices:
    return np.arange(sides * steps).reshape(sides, steps)


def line_sums(weight: Values, along: Values, off: Values) -> list[list[float]]:
    """Return for each side the sums of w, w x, w x², w y and w x y over its steps.

    They are all that the normal equations of a line ``y = offset + slope * x`` need.
    """
    terms = np.empty((5, *off.shape))
    terms[0] = weight
    np.multiply(weight, along, out=terms[1])
    np.multiply(terms[1], along, out=terms[2])
    np.multiply(terms[:2], off, out=terms[3:])
    sums: list[list[float]] = np.add.reduce(terms, axis=2).T.tolist()
    return sums


def corners_of_lines(frame: SideFrame, offset: Values, slope: Values) -> Points | None:
    """Return the corners between neighbouring lines, ``(4, 2)``; None where two of them are all but parallel.

    Args:
        frame: The sides as they were expected.
        offset: Of each fitted line, its difference from the expected one at its middle, shape ``(4, 1)``.
        slope: The difference of its slope, shape ``(4, 1)``.
    """
    changes = np.concatenate((slope, offset - slope * frame.middle), axis=1).tolist()
    # A side across = slope * along + level as a x + b y = c, where along is x for the flat ones.
    lines = []
    for side, (steeper, higher) in zip(frame.sides, changes, strict=True):
        steep, level = side.slope + steeper, side.at_zero + higher
        lines.append((-steep, 1.0, level) if side.flat else (1.0, -steep, level))
    met = []
    for number in range(4):
        (a, b, c), (d, e, f) = lines[number - 1], lines[number]
        # The determinant is the sine of their angle times the lengths of both normals.
        determinant = a * e - b * d
        if not abs(determinant) > MIN_SINE * math.hypot(a, b) * math.hypot(d, e):
            return None
        met.append(((c * e - b * f) / determinant, (a * f - c * d) / determinant))
    return np.array(met)


class QuadShapes(Struct, frozen=True, kw_only=True, eq=False):
    """The shapes of many outlines."""

    sides_px: Values  # the lengths of their sides, shape ``(c, 4)``; side i leads from corner i to corner i + 1
    shorter_px: Values  # of both pairs of opposite sides, the mean length of the shorter one, shape ``(c,)``
    aspect: Values  # the mean of the longer pair over that of the shorter one, shape ``(c,)``
    side_ratio: Values  # how many times as long as the opposite side a side is at most, shape ``(c,)``
    sharpest_rad: Values  # the sharpest angle at a corner, shape ``(c,)``


def quad_shapes(corners: Points) -> QuadShapes:
    """Return the shapes of outlines whose corners come in order, shape ``(c, 4, 2)``."""
    # `back` leads from a corner along the side before it: with the next side it encloses the angle at that corner.
    sides = corners[:, [1, 2, 3, 0]] - corners
    sides_px = np.maximum(np.hypot(sides[..., 0], sides[..., 1]), 1e-9)
    back = -sides[:, [3, 0, 1, 2]] / sides_px[:, [3, 0, 1, 2], None]
    cosines = (back * sides / sides_px[..., None]).sum(axis=2)
    pairs, opposite = (sides_px[:, :2] + sides_px[:, 2:]) / 2, sides_px[:, :2] / sides_px[:, 2:]
    shorter = pairs.min(axis=1, initial=np.inf)
    return QuadShapes(
        sides_px=sides_px,
        shorter_px=shorter,
        aspect=pairs.max(axis=1, initial=0.0) / shorter,
        side_ratio=np.maximum(opposite, 1 / opposite).max(axis=1, initial=1.0),
        sharpest_rad=np.arccos(np.clip(cosines.max(axis=1, initial=-1.0), -1.0, 1.0)),
    )


def longest_sides_px(corners: Points) -> Values:
    """Return the length of the longest side of each outline, shape ``(c,)``, from corners of shape ``(c, 4, 2)``."""
    sides = corners[:, [1, 2, 3, 0]] - corners
    longest: Values = np.hypot(sides[..., 0], sides[..., 1]).max(axis=1, initial=0.0)
    return longest


def areas(corners: Points) -> Values:
    """Return the area of each outline, shape ``(c,)``: half the cross product of its diagonals."""
    first, second = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    return np.asarray(np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2)


def quad_area(corners: Sequence[Sequence[float]]) -> float:
    """Return the area between four corners: half the cross product of the diagonals."""
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = corners
    return abs((cx - ax) * (dy - by) - (cy - ay) * (dx - bx)) / 2


def side_lengths(corners: Points) -> tuple[float, float, float, float]:
    """Return the lengths of the sides; side i leads from corner i to corner i + 1."""
    a, b, c, d = corners.tolist()
    return math.dist(a, b), math.dist(b, c), math.dist(c, d), math.dist(d, a)


def width_and_height(corners: Points) -> tuple[float, float]:
    """Return the mean length of the pair of opposite sides that is more horizontal, and of the other pair."""
    sides = side_lengths(corners)
    first, second = (sides[0] + sides[2]) / 2, (sides[1] + sides[3]) / 2
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = corners.tolist()
    # Which pair is the width: the one that leads more to the right for each pixel that it leads down.
    across_x, across_y = abs(bx - ax) + abs(dx - cx), abs(by - ay) + abs(dy - cy)
    down_x, down_y = abs(cx - bx) + abs(ax - dx), abs(cy - by) + abs(ay - dy)
    first_is_width = across_x * down_y >= across_y * down_x
    return (first, second) if first_is_width else (second, first)


def diagonals_meet(corners: Points) -> tuple[float, float]:
    """Return where the diagonals of a convex outline meet: the rectangle's centre, from whatever side it is seen."""
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = corners.tolist()
    # a + share (c - a) lies on the line through b and d. Straight lines stay straight in perspective, so it is the
    # centre.
    share = ((bx - ax) * (dy - by) - (by - ay) * (dx - bx)) / ((cx - ax) * (dy - by) - (cy - ay) * (dx - bx))
    return ax + share * (cx - ax), ay + share * (cy - ay)


def grown(corners: Points, by_px: float) -> Points:
    """Move the sides of a convex outline, clockwise on the screen, shape ``(4, 2)``, outwards."""
    # Both sides at a corner move out by by_px, so the corner moves along each by by_px / sine of their angle; the sine
    # is held above 0.2 (12 degrees), or a spike would run away.
    after = corners[[1, 2, 3, 0]] - corners
    along = after / np.maximum(np.hypot(after[:, 0], after[:, 1]), 1e-9)[:, None]
    back = -along[[3, 0, 1, 2]]
    sine = np.abs(back[:, 0] * along[:, 1] - back[:, 1] * along[:, 0])
    return np.asarray(corners - (along + back) * (by_px / np.maximum(sine, 0.2))[:, None])
