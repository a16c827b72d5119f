"""Where the sides of a tag are expected, in whole pixels along and across each of them.

Along is x for a side that is more horizontal and y for one that is more vertical; across is the other one. All four
sides are worked on at once: arrays have the sides first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.detectors.quad_shape import polygon_area

Values = NDArray[np.float64]

CORNER_SHARE = 0.08
"""Share of a side left out at each end, where the other side blurs in."""

LEAST_STEPS = 8

REACH_PX = (2, 12)
"""How many pixels across a side are looked at on both sides of where it is expected, at least and at most."""

START_PX = 8.0
"""How many pixels an edge takes from black to white, as long as it has not been looked at: the start may be off by
two pixels to either side of an edge that takes four."""

PLATEAU_PX = 2.0
"""So far beyond an edge black and white are themselves."""


START = np.full(4, START_PX)


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """How one fit is made.

    Attributes:
        reach_cells: How far across a side is looked, in cells: the border of a tag is one wide, and so is its margin.
        most_steps: How many steps along a side are looked at, at most.
        refit: Whether the line through the medians is fitted again without what lies far from it.
    """

    reach_cells: float
    most_steps: int
    refit: bool


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BentSides:
    """How a lens bends straight sides.

    Attributes:
        camera: The lens at the picture's resolution.
        left_top_px: Where the part of the picture that is looked at starts.
    """

    camera: CameraModel
    left_top_px: Points

    def middles(self, corners_px: Points) -> Points:
        """Return where the middles of straight sides between these corners appear, shape ``(4, 2)``."""
        directions = self.camera.directions(corners_px + self.left_top_px)
        return self.camera.project((directions + directions[[1, 2, 3, 0]]) / 2) - self.left_top_px


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SideFrame:
    """Where the sides are expected.

    Attributes:
        flat: Which sides are more horizontal, shape ``(4,)``.
        outward: Which way across leads out of the tag, 1 or -1, shape ``(4, 1)``.
        along: Where the steps are looked for: whole pixels, shape ``(4, n)``.
        across: Where the side is expected there, shape ``(4, n)``; bent as the lens bends it.
        pixel: The pixel there, or the nearest one around which so far can be looked, shape ``(4, n)``.
        slope: How the straight line between the corners rises across, shape ``(4, 1)``.
        at_zero: Where it crosses along = 0, shape ``(4, 1)``.
        cosine: What turns a difference across into a distance from the side, shape ``(4, 1)``.
        reach: How many pixels are looked at in each direction, shape ``(4,)``.
        most_reach: How many could be, as far as cells allow it, shape ``(4,)``.
    """

    flat: NDArray[np.bool_]
    outward: NDArray[np.int64]
    along: Values
    across: Values
    pixel: Values
    slope: Values
    at_zero: Values
    cosine: Values
    reach: NDArray[np.int64]
    most_reach: NDArray[np.int64]

    def sees_enough(self, edges_px: Values) -> bool:
        """Say whether edges that take so many pixels were looked at as far as they and the cells ask for."""
        return bool((np.minimum(edges_px / 2 + PLATEAU_PX, self.most_reach) <= self.reach + 0.5).all())


class _Side(NamedTuple):
    """One side in plain numbers: four sides are so few that these are several times as fast as arrays."""

    flat: bool
    length_px: float
    start: float
    forward: float
    slope: float
    at_zero: float
    cosine: float
    outward: int


def side_frame(
    corners_px: Points,
    cells: int,
    look: Look,
    shape: tuple[int, ...],
    edges_px: Values = START,
    bent: BentSides | None = None,
) -> SideFrame | None:
    """Return where the sides between four corners are.

    Args:
        corners_px: The corners, clockwise on the screen, shape ``(4, 2)``.
        cells: How many cells a side is long.
        look: How far across and in how many places a side is looked at.
        shape: Height and width of the picture.
        edges_px: How many pixels each side takes from black to white, shape ``(4,)``.
        bent: How the lens bends sides; None if it does not.

    Returns:
        The sides; None where they, or the picture, are too small to be looked at.
    """
    points = corners_px.tolist()
    sides = [_side(points[i], points[i - 3]) for i in range(4)]
    shortest = min(side.length_px for side in sides)
    if not (shortest > cells / 2 and min(shape) > 2 * REACH_PX[1] + 1):
        return None
    steps = int(min(max(shortest * (1 - 2 * CORNER_SHARE), LEAST_STEPS), look.most_steps))
    columns = np.array([(side.start, side.forward, side.slope, side.at_zero, side.cosine) for side in sides])
    start, forward, slope, at_zero, cosine = columns.T[:, :, None]
    flat = np.array([side.flat for side in sides])
    last_along, last_across = np.where(flat, ((shape[1],), (shape[0],)), ((shape[0],), (shape[1],)))[:, :, None] - 1
    along = np.minimum(np.maximum(np.rint(start + _shares(steps) * forward), 0), last_along)
    across = at_zero + slope * along
    if bent is not None:
        across = across + _bend(bent.middles(corners_px), flat, slope, at_zero, (along - start) / forward)
    most_reach = np.array(_reaches(sides, polygon_area(corners_px) / cells, look))
    reach = np.minimum(np.ceil(edges_px / 2 + PLATEAU_PX), most_reach).astype(np.int64)
    widest = int(reach.max())
    return SideFrame(
        flat=flat,
        outward=np.array([[side.outward] for side in sides]),
        along=along,
        across=across,
        pixel=np.minimum(np.maximum(np.rint(across), widest), last_across - widest),
        slope=slope,
        at_zero=at_zero,
        cosine=cosine,
        reach=reach,
        most_reach=most_reach,
    )


def _side(start: list[float], end: list[float]) -> _Side:
    x, y = end[0] - start[0], end[1] - start[1]
    flat = abs(x) >= abs(y)
    forward, sideways = (x, y) if flat else (y, x)
    first, level = (start[0], start[1]) if flat else (start[1], start[0])
    length_px = math.hypot(x, y)
    slope = sideways / forward if forward else 0.0
    return _Side(
        flat=flat,
        length_px=length_px,
        start=first,
        forward=forward,
        slope=slope,
        at_zero=level - slope * first,
        cosine=abs(forward) / length_px if length_px else 1.0,
        outward=-1 if (forward > 0) == flat else 1,
    )


def _reaches(sides: list[_Side], area_of_cells_px2: float, look: Look) -> list[int]:
    """Return how far can be looked across: the area over a side is how far away the opposite one lies."""
    cells_px = [area_of_cells_px2 / (side.length_px * side.cosine) for side in sides]
    return [min(max(round(look.reach_cells * cell_px), REACH_PX[0]), REACH_PX[1]) for cell_px in cells_px]


@cache
def _shares(steps: int) -> Values:
    return np.linspace(CORNER_SHARE, 1 - CORNER_SHARE, steps)


def _bend(middles: Points, flat: NDArray[np.bool_], slope: Values, at_zero: Values, share: Values) -> Values:
    """Return how far off its straight line each side is bent, as a parabola through its ends and its middle."""
    along, across = np.where(flat, middles.T, middles.T[::-1])[:, :, None]
    return np.asarray((across - at_zero - slope * along) * 4 * share * (1 - share))
