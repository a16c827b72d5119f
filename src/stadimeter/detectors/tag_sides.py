"""The four sides of a tag, to a few hundredths of a pixel.

Brightness is read along columns of pixels where a side is more horizontal and along rows where it is more vertical, so
nothing is interpolated but the last step: where, between two neighbouring pixels, it passes half way between black and
white. In light that is where the edge is, see `stadimeter.detectors.linear_light`. A line through these steps is fitted
to each side, and the corners are where the lines meet.

Arrays have the four sides first, then the steps along a side, then the pixels across.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.detectors.linear_light import Light
from stadimeter.detectors.quad_shape import polygon_area
from stadimeter.detectors.tag_frame import START, BentSides, Look, SideFrame, side_frame
from stadimeter.detectors.tag_lines import fit_lines, intersections, median

Plane = NDArray[np.uint8]
Values = NDArray[np.float64]
Profiles = NDArray[np.float32]

SIDES = np.arange(4)[:, None]

FIRST_LOOK = Look(reach_cells=1.1, most_steps=16, refit=False)
LARGE_CELL_PX = 5.8
"""A wide and quick one first where cells are smaller than this, since the start may be off by two pixels."""

NEXT_LOOK = Look(reach_cells=0.6, most_steps=48, refit=True)
"""A narrow one, which sees less of the tag's own cells and of what is beside it."""

MOST_NEXT_LOOKS = 4

LEVEL_PX = 1.0
LEAST_MOVE_PX = 0.2
"""A fit that moved a side further than by what the reach has left beside the edge, without the pixel for the level, has
taken black or white from the edge itself, so it is repeated."""

MOST_MOVED_PX = 8.0
"""Lines that end further from the start belong to something else."""

LEAST_LIGHT = 1e-4
"""A side whose two levels differ by less is no side: a third of a level of 8 bits in the dark."""

LEAST_RISE = 0.04
"""How much of the way from black to white two neighbouring pixels must differ by to be the step."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TagSides:
    """What the sides of a tag look like. Side i leads from corner i to corner i + 1.

    Attributes:
        corners_px: Where the lines meet, shape ``(4, 2)``.
        contrast: How much more light comes from outside each side than from inside, as a share of the brightest that
            a picture can hold, shape ``(4,)``; negative for a white border on black.
        support: The share of the steps along each side that lie on its line, shape ``(4,)``.
        scatter_px: Standard deviation of the steps about each line, shape ``(4,)``.
        steps: How many steps each line was fitted to, shape ``(4,)``.
        edge_px: How many pixels each side takes from black to white at its steepest, shape ``(4,)``.
    """

    corners_px: Points
    contrast: Values
    support: Values
    scatter_px: Values
    steps: NDArray[np.int64]
    edge_px: Values


class _Steps(NamedTuple):
    """Where the steps are across, how high, and how much light lies between black and white on each side."""

    across: Values
    rise: Values
    contrast: Values


def measure_sides(
    grey: Plane, corners_px: Points, cells: int, light: Light, bent: BentSides | None = None
) -> TagSides | None:
    """Fit lines to the sides of a tag.

    Args:
        grey: The picture, shape ``(height, width)``.
        corners_px: About where the corners are, clockwise on the screen, shape ``(4, 2)``.
        cells: How many cells a side is long.
        light: What each code value stands for.
        bent: How the lens bends straight sides; None if it does not.

    Returns:
        The sides; None where they form no outline near the given corners.
    """
    looks = (NEXT_LOOK,) * MOST_NEXT_LOOKS
    if polygon_area(corners_px) < (LARGE_CELL_PX * cells) ** 2:
        looks = (FIRST_LOOK, *looks)
    sides, corners, edges_px = None, corners_px, START
    for look in looks:
        frame = side_frame(corners, cells, look, grey.shape, edges_px, bent)
        sides = None if frame is None else _fit(grey, frame, look, light)
        if frame is None or sides is None or not np.abs(sides.corners_px - corners_px).max() < MOST_MOVED_PX:
            return None
        moved_px = float(np.abs(sides.corners_px - corners).max())
        left_px = float((frame.reach - sides.edge_px / 2).min()) - LEVEL_PX
        if look is NEXT_LOOK and moved_px < max(left_px, LEAST_MOVE_PX) and frame.sees_enough(sides.edge_px):
            break
        corners, edges_px = sides.corners_px, sides.edge_px
    return sides


def _fit(grey: Plane, frame: SideFrame, look: Look, light: Light) -> TagSides | None:
    steps = _steps(_profiles(grey, frame, light), frame)
    lines = fit_lines(frame, steps.across, steps.rise > LEAST_RISE, refit=look.refit)
    met = intersections(frame, lines)
    if met is None:
        return None
    return TagSides(
        corners_px=met,
        contrast=steps.contrast,
        support=lines.support,
        scatter_px=lines.scatter_px,
        steps=lines.steps,
        edge_px=1 / median(steps.rise)[:, 0],
    )


def _profiles(grey: Plane, frame: SideFrame, light: Light) -> Profiles:
    """Return the light across each side, from the inside to the outside, shape ``(4, n, 2 * reach + 1)``."""
    reach = int(frame.reach.max())
    width = grey.shape[1]
    apart = np.where(frame.flat[:, None], width, 1)
    middle = (frame.pixel * apart + frame.along * (width + 1 - apart)).astype(np.int64)
    places = middle[:, :, None] + (apart * frame.outward)[:, :, None] * np.arange(-reach, reach + 1)
    return np.asarray(light[grey.reshape(-1)[places]])


def _steps(profiles: Profiles, frame: SideFrame) -> _Steps:
    """Find where each profile passes half way from black to white; where it does not, the rise is `LEAST_RISE`."""
    reach = int(frame.reach.max())
    pixels = np.arange(2) if reach >= 3 else np.zeros(1, np.int64)
    inside = _levels(profiles, (reach - frame.reach)[:, None] + pixels)
    outside = _levels(profiles, (reach + frame.reach)[:, None] - pixels)
    contrast = outside - inside
    safe = np.where(np.abs(contrast) > LEAST_LIGHT, contrast, np.inf)
    share = (profiles - ((inside + outside) / 2)[:, :, None]) / safe[:, :, None]
    before, after = share[:, :, :-1], share[:, :, 1:]
    rise = (after - before) * ((before <= 0) & (after > 0))
    best = np.argmax(rise, axis=2)
    place = (SIDES, np.arange(best.shape[1]), best)
    height = np.maximum(rise[place], LEAST_RISE).astype(np.float64)
    beyond = best - reach - before[place] / height
    across = frame.pixel + frame.outward * beyond
    return _Steps(across=across, rise=height, contrast=contrast[:, 0].astype(np.float64))


def _levels(profiles: Profiles, ends: NDArray[np.int64]) -> Profiles:
    """Return how bright it is at one end of the profiles of each side, shape ``(4, 1)``."""
    return median(profiles[SIDES, :, ends].reshape(4, -1))
