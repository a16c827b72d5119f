"""Expected sides of a tag, in whole pixels along and across each of them.

Along is x for a side that is more horizontal and y for one that is more vertical; across is the other one. All four
sides are worked on at once: arrays have the sides first. What is one number for each side is kept in plain Python,
which for so few is several times as fast as arrays.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points, Values
from stadimeter.detectors.sides import CORNER_SHARE, SideFrame, SideLine, quad_area, side_frame, side_lines

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
