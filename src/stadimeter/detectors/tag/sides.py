"""The four sides of a tag, to a few hundredths of a pixel.

Brightness is read along columns of pixels where a side is more horizontal and along rows where it is more vertical, so
nothing is interpolated but the last step: where, between two neighbouring pixels, it passes half way between black and
white. In light that is where the edge is, see `stadimeter.detectors.sampling`. A line through these steps is fitted
to each side, and the corners are where the lines meet.

Arrays have the pixels across first, then the four sides, then the steps along a side.
"""

from __future__ import annotations

import math
from functools import cache, lru_cache, partial
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Flags, Indices, Plane, Points, Profiles, Values
from stadimeter.detectors.sampling import Light, median
from stadimeter.detectors.sides import (
    CORNER_SHARE,
    LIMITS_PX,
    MAD_TO_SIGMA,
    SideFrame,
    SideLine,
    corners_of_lines,
    line_sums,
    pixels_across,
    quad_area,
    side_frame,
    side_lines,
    steepest_fall,
)

# Expected sides of a tag, in whole pixels along and across each of them -----------------------------------------------
#
# Along is x for a side that is more horizontal and y for one that is more vertical; across is the other one. All
# four sides are worked on at once: arrays have the sides first. What is one number for each side is kept in plain
# Python, which for so few is several times as fast as arrays.

OfSides = tuple[float, ...]

# Steps along each side, at least: the slope is a median over half as many pairs.
MIN_STEPS = 8

# Least and greatest reach across a side, in pixels to both sides of where it is expected.
REACH_PX = (2, 12)

# A picture must be larger than this in both directions, in pixels, or the greatest reach would leave it.
MIN_SHAPE_PX = 2 * REACH_PX[1] + 1

# Width of an edge from black to white before it has been measured: two or three, and the start may be off by as many.
START_PX = 4.5

# Reach in pixels beyond the end of an edge, where black and white are read.
PLATEAU_PX = 1.5

START: OfSides = (START_PX,) * 4


class Look(Struct, frozen=True, kw_only=True):
    """Parameters of one fit."""

    # How far across a side is looked, in cells: the border of a tag is one wide, and so is its margin.
    reach_cells: float
    max_steps: int  # how many steps along a side are looked at, at most
    refit: bool  # whether the line through the medians is fitted again without what lies far from it


class BentSides(Struct, frozen=True, kw_only=True, eq=False):
    """Distortion of straight sides by a lens."""

    camera: CameraModel  # the lens at the picture's resolution
    left_top_px: Points  # where the part of the picture that is looked at starts

    def middles(self, corners_px: Points) -> Points:
        """Return where the middles of straight sides between these corners appear, shape ``(4, 2)``."""
        # What is straight is so in directions, x and y per unit of depth with the distortion undone; the middle is
        # taken there and seen through the lens again. Coordinates of the part become those of the picture, and back.
        directions = self.camera.directions(corners_px + self.left_top_px)
        return self.camera.project((directions + directions[[1, 2, 3, 0]]) / 2) - self.left_top_px


class TagFrame(NamedTuple):
    """The expected sides."""

    at: SideFrame
    reach: tuple[int, ...]  # how many pixels are looked at in each direction
    max_reach: tuple[int, ...]  # how many could be, as far as cells allow it

    def sees_enough(self, edges_px: OfSides) -> bool:
        """Check whether edges of these widths were looked at as far as they and the cells ask for."""
        sides = zip(edges_px, self.max_reach, self.reach, strict=True)
        return all(min(edge_px + PLATEAU_PX, most) <= reach + 0.5 for edge_px, most, reach in sides)

    def left_px(self, edges_px: OfSides) -> float:
        """Return the number of pixels looked at beyond edges of these widths, on the side with the fewest.

        At its steepest a Gaussian edge rises as if it took √(2π) = 2.5 standard deviations. At that distance from its
        middle it is over: black or white but for 0.6 %.
        """
        return min([reach - edge_px for edge_px, reach in zip(edges_px, self.reach, strict=True)])


def tag_frame(
    corners_px: Points,
    cells: int,
    look: Look,
    shape: tuple[int, ...],
    edges_px: OfSides = START,
    bent: BentSides | None = None,
) -> TagFrame | None:
    """Return where the sides between four corners are; None where they, or the picture, are too small or they lead out.

    Args:
        corners_px: The corners, clockwise on the screen, shape ``(4, 2)``.
        cells: How many cells a side is long.
        edges_px: How many pixels each side takes from black to white.
    """
    points = corners_px.tolist()
    sides = side_lines(points)
    shortest_px = min([side.length_px for side in sides])
    inside_px = _inside_px(points, shape)
    # Steps start CORNER_SHARE of a side from the corners, so these may be outside by half of that. No cell may be
    # smaller than half a pixel.
    if not (shortest_px > cells / 2 and inside_px > -CORNER_SHARE / 2 * shortest_px and min(shape) > MIN_SHAPE_PX):
        return None
    max_reach = _reaches(sides, quad_area(points) / cells, look)
    # As far as the edge takes to end, plus a plateau; but no further than the cells beside it allow.
    reach = tuple([min(math.ceil(e + PLATEAU_PX), most) for e, most in zip(edges_px, max_reach, strict=True)])
    steps = int(min(max(shortest_px * (1 - 2 * CORNER_SHARE), MIN_STEPS), look.max_steps))
    at = side_frame(
        sides,
        steps,
        shape,
        None if bent is None else partial(_bend, bent.middles(corners_px), sides),
        max(reach) if bent is not None or inside_px < max(reach) else None,
    )
    return TagFrame(at, reach, max_reach)


def _inside_px(points: list[list[float]], shape: tuple[int, ...]) -> float:
    """Measure how far inside the picture the corners are; below zero if one of them is outside."""
    x, y = zip(*points, strict=True)
    return float(min(*x, *y, shape[1] - 1 - max(x), shape[0] - 1 - max(y)))


def _reaches(sides: list[SideLine], area_of_cells_px2: float, look: Look) -> tuple[int, ...]:
    """Return the distances that can be looked across: the area over a side is how far away the opposite one lies."""
    # Divided by the number of cells that is a cell's height; the cosine turns it into pixels across.
    cells_px = [area_of_cells_px2 / (side.length_px * side.cosine) for side in sides]
    return tuple([min(max(round(look.reach_cells * cell_px), REACH_PX[0]), REACH_PX[1]) for cell_px in cells_px])


def _bend(middles: Points, sides: list[SideLine], along: Values) -> Values:
    """Return the bend of each side off its straight line, as a parabola through its ends and its middle."""
    rows = [(side.start, side.forward, side.slope, side.at_zero) for side in sides]
    start, forward, slope, at_zero = np.array(rows).T[:, :, None]
    flat = np.array([side.flat for side in sides])
    middle_along, middle_across = np.where(flat, middles.T, middles.T[::-1])[:, :, None]
    share = (along - start) / forward
    # 4 s (1 - s) is 1 in the middle of a side and 0 at its ends.
    return np.asarray((middle_across - at_zero - slope * middle_along) * 4 * share * (1 - share))


# A wide and quick one first where cells are smaller than this, since the start may be off by two pixels.
FIRST_LOOK = Look(reach_cells=1.1, max_steps=16, refit=False)
LARGE_CELL_PX = 4.0

# A narrow one, which sees less of the tag's own cells and of what is beside it.
NEXT_LOOK = Look(reach_cells=0.6, max_steps=48, refit=True)

# Narrow looks at most; the last is taken even if the lines still move.
MAX_NEXT_LOOKS = 4

# A fit that moved a side further than this, and further than by what the reach has left beside the edge, has taken
# black or white from the edge itself, so it is repeated.
MIN_MOVE_PX = 0.2

# Lines that end further from the start belong to something else.
MAX_MOVED_PX = 8.0

# A side whose two levels differ by less is no side: a third of a level of 8 bits in the dark.
MIN_LIGHT = 1e-4

# An edge goes on where the light at the end of the look differs by more than this share of the contrast from that of
# the last two pixels together.
MAX_RISING = 0.03

# The variance of a bend that noise feigns is that of a line's offset times five; twice that is left out.
PARABOLA_VARIANCE, TIMES_NOISE = 5.0, 2.0

# Least difference of the two pixels of a step, as a share of that between black and white.
MIN_RISE = 0.04


class TagSides(Struct, frozen=True, kw_only=True, eq=False):
    """Measured sides of a tag. Side i leads from corner i to corner i + 1."""

    corners_px: Points  # where the lines meet, shape ``(4, 2)``
    # How much more light comes from outside each side than from inside, as a share of the brightest that a picture can
    # hold; negative for a white border on black.
    contrast: OfSides
    edge_px: OfSides  # how many pixels each side takes from black to white at its steepest
    lines: TagLines  # how well the steps fit to the lines


class _SideSteps(NamedTuple):
    """Offsets of the steps across from where they are expected, their heights, contrast and width of the edges."""

    off: Values
    height: Profiles
    contrast: OfSides
    edge_px: OfSides


def measure_sides(
    grey: Plane, corners_px: Points, cells: int, light: Light, bent: BentSides | None = None
) -> TagSides | None:
    """Fit lines to the sides of a tag; None where they form no outline near the given corners.

    Args:
        corners_px: About where the corners are, clockwise on the screen, shape ``(4, 2)``.
        cells: How many cells a side is long.
    """
    looks = (NEXT_LOOK,) * MAX_NEXT_LOOKS
    if quad_area(corners_px.tolist()) < (LARGE_CELL_PX * cells) ** 2:
        looks = (FIRST_LOOK, *looks)
    sides, corners, edges_px = None, corners_px, START
    # Each look starts from the last one's lines and widths, until the lines stay and the edges end within what is
    # looked at: then the corners do not depend on where the outline was found.
    for look in looks:
        frame = tag_frame(corners, cells, look, grey.shape, edges_px, bent)
        sides = None if frame is None else _fit(grey, frame, look, light)
        if frame is None or sides is None or not np.abs(sides.corners_px - corners_px).max() < MAX_MOVED_PX:
            return None
        # Settled where every edge ends within the reach and the lines moved by less than the reach has left beside
        # them.
        moved_px = float(np.abs(sides.corners_px - corners).max())
        seen = frame.sees_enough(sides.edge_px)
        if seen and look is NEXT_LOOK and moved_px < max(frame.left_px(sides.edge_px), MIN_MOVE_PX):
            break
        # An edge that fills what is looked at goes on beyond it, to an unknown distance.
        corners, edges_px = sides.corners_px, sides.edge_px if seen else tuple([2 * each for each in sides.edge_px])
    return sides


def _fit(grey: Plane, frame: TagFrame, look: Look, light: Light) -> TagSides | None:
    steps = _steps(_profiles(grey, frame, light), frame)
    lines = fit_lines(frame.at, steps.off, steps.height > MIN_RISE, refit=look.refit)
    met = corners_of_lines(frame.at, lines.offset, lines.slope)
    if met is None:
        return None
    return TagSides(corners_px=met, contrast=steps.contrast, edge_px=steps.edge_px, lines=lines)


def edge_points(grey: Plane, corners_px: Points, cells: int, light: Light, bent: BentSides | None = None) -> Points:
    """Return where steps are seen along the sides between corners that were measured, shape ``(n, 2)``."""
    frame = tag_frame(corners_px, cells, NEXT_LOOK, grey.shape, START, bent)
    if frame is None:
        return np.empty((0, 2))
    steps = _steps(_profiles(grey, frame, light), frame)
    return frame.at.points(steps.off, grey.shape[1])[steps.height > MIN_RISE]


def _profiles(grey: Plane, frame: TagFrame, light: Light) -> Profiles:
    """Return the light across each side, from the inside to the outside, shape ``(2 * reach + 1, 4, n)``."""
    # Places count the picture row by row; a stride leads one pixel outwards. Light is looked up from the code values.
    places = frame.at.place + frame.at.stride * pixels_across(max(frame.reach))
    return light.take(grey.reshape(-1).take(places))


def _steps(profiles: Profiles, frame: TagFrame) -> _SideSteps:
    """Find where each profile passes half way from black to white; where it does not, the height is `MIN_RISE`."""
    inside, outside, cut_off = _levels(profiles, frame)
    # Light is from 0 to 1. A side that is no side gets an infinite contrast, so that no profile crosses half way.
    contrast = tuple([white - black for black, white in zip(inside, outside, strict=True)])
    half_way = [(black + white) / 2 for black, white in zip(inside, outside, strict=True)]
    no_side = [rise if abs(rise) > MIN_LIGHT else math.inf for rise in contrast]
    middle, whole = np.array((half_way, no_side), np.float32)[:, :, None]
    # Light as a share of the step, 0.5 for black and -0.5 for white; the edge is where it changes its sign, at the
    # place where it rises most. Between its two pixels the light rises in a straight line.
    best, rise, share = steepest_fall((middle - profiles) / whole)
    height = np.maximum(rise, MIN_RISE)
    beyond = best - max(frame.reach) + share / height
    edge_px = [1 / each for each in median(height)[:, 0].tolist()]
    return _SideSteps(
        # Outwards becomes across, and the pixel's middle becomes where the side was expected.
        off=frame.at.outward * beyond - frame.at.off_pixel,
        height=height,
        contrast=contrast,
        edge_px=tuple([max(e, 2 * r) if cut else e for e, r, cut in zip(edge_px, frame.reach, cut_off, strict=True)]),
    )


def _levels(profiles: Profiles, frame: TagFrame) -> tuple[list[float], list[float], list[bool]]:
    """Return the brightness inside and outside each side, and whether its edge goes on beyond what is looked at.

    The edge does where it still rises at either end, and where cells allow to look further.
    """
    # The median over the steps and both pixels of each end: the cells of the tag itself are black and white in turn,
    # its border and margin are not.
    ends = profiles[_ends(frame.reach)]
    level = median(ends.reshape(8, -1))[:, 0].tolist()
    inside, outside = level[:4], level[4:]
    if frame.reach == frame.max_reach:
        return inside, outside, [False] * 4
    # Only where a look reached less far than cells allow is there more of an edge to be seen.
    at_end = median(ends[:, 0])[:, 0].tolist()
    cut_off = []
    for i, (reach, most) in enumerate(zip(frame.reach, frame.max_reach, strict=True)):
        rising = max(abs(at_end[i] - inside[i]), abs(at_end[i + 4] - outside[i]))
        cut_off.append(reach < most and rising > MAX_RISING * abs(outside[i] - inside[i]))
    return inside, outside, cut_off


@lru_cache(maxsize=256)
def _ends(reach: tuple[int, ...]) -> tuple[Indices, Indices]:
    """Return which rows of the profiles show black and white themselves, where the look ends first, by the sides.

    That is where the look ends, and the pixel before, unless so little is looked at that this would be on the edge. The
    rows come first of each side inside, then outside, shape ``(8, 2)`` or ``(8, 1)``.
    """
    widest = max(reach)
    before = np.arange(2 if widest >= 3 else 1)
    of_side = np.array(reach)[:, None]
    return np.concatenate((widest - of_side + before, widest + of_side - before)), np.tile(np.arange(4), 2)[:, None]


class TagLines(Struct, frozen=True, kw_only=True, eq=False):
    """A line for each side, as a difference from where it was expected: offset + slope * (along - middle)."""

    offset: Values  # shape ``(4, 1)``
    slope: Values  # shape ``(4, 1)``
    support: OfSides  # the share of the steps along each side that lie on its line
    scatter_px: OfSides  # standard deviation of these steps about each line
    steps: tuple[int, ...]  # how many these are
    bend_px: float  # by how much the steps follow a bend, the root of the sum of the squares of all sides


def fit_lines(frame: SideFrame, off: Values, found: Flags, *, refit: bool) -> TagLines:
    """Fit lines by least squares with Tukey's weights, from a line through medians, which outliers do not move.

    Where the steps are across, and which are found, has the shape ``(4, n)``. Without `refit` it is the line through
    the medians.
    """
    along = frame.from_middle
    half = along.shape[1] // 2
    # The slope is the median over pairs of steps half a side apart (Theil and Sen, with fixed pairs): up to a quarter
    # of the steps may be outliers, and no iteration is needed.
    slope = median((off[:, -half:] - off[:, :half]) / (along[:, -half:] - along[:, :half]))
    rest = off - slope * along
    offset = median(rest)
    distance = (rest - offset) * frame.cosine
    limit = _limit(distance)
    if refit:
        # Tukey's biweight, (1 - (d / limit)^2)^2, in place; steps that are none have no weight.
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
        bend_px=_bend_px(distance * used, sum(squares), sum(steps)) if refit else 0.0,
    )


def _bend_px(distance: Values, squares_px2: float, steps: int) -> float:
    """Return the root of the sum over the sides of the squares of their bends, beyond what noise feigns.

    A bend is that of the parabola that is nearest to the distances of the steps from the line. Noise feigns five times
    the variance of a line's offset.
    """
    # The least squares fit of the one shape, since it is at right angles to lines. The noise of a side is its mean
    # square over the number of its steps; of four sides together 4 (squares / steps) / (steps / 4).
    parabola = _parabola(distance.shape[1])
    bends = distance @ parabola / (parabola @ parabola)
    of_noise = len(distance) ** 2 * squares_px2 / max(steps, 1) ** 2
    return math.sqrt(max(0.0, float(bends @ bends) - TIMES_NOISE * PARABOLA_VARIANCE * of_noise))


@cache
def _parabola(steps: int) -> Values:
    """Return Legendre's second polynomial along a side: a parabola without a line in it, from 1 to -1/2 and back."""
    return np.asarray(1.5 * np.linspace(-1, 1, steps) ** 2 - 0.5)


def _limit(distance: Values) -> Values:
    """Return the distance a step may be from its line."""
    # Three standard deviations, from the median so that outliers do not widen it, within LIMITS_PX.
    usual = MAD_TO_SIGMA * median(np.abs(distance))
    return np.minimum(np.maximum(3 * usual, LIMITS_PX[0]), LIMITS_PX[1])


def _weighted_lines(along: Values, off: Values, weight: Values) -> tuple[Values, Values]:
    """Return offset and slope of the lines that are nearest to the steps, each with its weight."""
    # The normal equations solved in plain numbers, side by side; 1e-9 keeps a side without steps from dividing by zero.
    lines = []
    for total, first, second, height, together in line_sums(weight, along, off):
        mean = first / max(total, 1e-9)
        slope = (together - mean * height) / max(second - mean * first, 1e-9)
        lines.append(((height - slope * first) / max(total, 1e-9), slope))
    offset, slopes = np.array(lines).T[:, :, None]
    return offset, slopes
