"""The four sides of one outline that is known to a few pixels, quickly.

The edges are those of `stadimeter.detectors.sheet.edges`, measured in the same way: half way, in light, between the
colours on both sides of each step. What differs is the way there: one look far across finds each side as the line
through medians; a second, narrow one measures it. For a single outline the sides are described by plain numbers, and
only what is read of the picture is in arrays: the pixels across first, then the sides, then the steps.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from stadimeter.core.detection import Indices, Plane, Points, Profiles, Values
from stadimeter.detectors.sampling import Light, in_light, median
from stadimeter.detectors.sheet.edges import (
    CLEAR_PX,
    MAX_STEPS,
    MIN_DROP,
    PLATEAU_PX,
    REACHES_PX,
    SMOOTH,
    QuadEdges,
    SheetPicture,
    corner_sigmas_px,
    joined,
    settle_edges,
)
from stadimeter.detectors.sheet.lines import BEND_SHARE, REACH_SHARE, bend
from stadimeter.detectors.sides import (
    CORNER_SHARE,
    LIMITS_PX,
    MAD_TO_SIGMA,
    SideFrame,
    corners_between,
    line_sums,
    pixels_across,
    quad_area,
    side_frame,
    side_lines,
    steepest_fall,
)

OfSides = list[float]

# Steps along each side, at least.
MIN_STEPS = 12

# Inside and outside are one where their difference in light (0 to 1), projected on their difference in levels (0 to
# 255), is less. In the dark part of sRGB one level in all three channels comes to 0.9e-3.
MIN_LIGHT = 1e-3

# Along a shorter side steps would be in the same pixels.
MIN_EXTENT_PX = 4.0

# Less than this across leaves no room for both levels beside an edge.
MIN_REACH_PX = 3

# Width in pixels from inside to outside that an edge is taken to have before it is measured.
USUAL_EDGE_PX = 2.6

# How far from where they were measured closely sides may be, a standard deviation.
SETTLED_OFF_PX = 0.5

# Sides are looked for within one standard deviation first, and within this many of them only if they are not there: the
# further across a look reaches, the more of what is beside the sheet it takes for its level.
FAR_SIGMAS = 3.0

# Sides are there where this share of each lies on its line.
SUPPORTED = 0.7

# A look is enough where it reaches the level beside the edge, but for this; otherwise it is repeated this many times.
NARROW_LOOKS = 3
SLACK_PX = 0.4

# Beside the edge a profile is level to this share of the contrast; less calm sides are looked at once more, narrowly,
# so that what is beside them does not count.
CALM = 0.12


class OutlineSides(Struct, frozen=True, kw_only=True, eq=False):
    """Measured sides of one outline; each field as in `QuadEdges`, which has them for many."""

    corners_px: Points
    contrast: Values
    colour_contrast: Values
    support: Values
    scatter_px: Values
    steps: Indices
    edge_px: Values
    codes_inside: Plane  # the two outermost pixels inside each step, ``(2, 4, n, 3)``
    reach_px: float  # how far across was looked
    rough: float  # how far beside the edges profiles usually are from level, as a share of the contrast

    @property
    def corner_sigma_px(self) -> float:
        """Standard deviation of the coordinates of the corners."""
        return float(corner_sigmas_px(self.scatter_px, self.steps, self.edge_px))

    def as_edges(self) -> QuadEdges:
        """Return them as candidates' sides, of one candidate."""
        codes = self.codes_inside.astype(np.float32).mean(axis=0).transpose(0, 2, 1)
        inside = median(codes)
        uneven = median(np.abs(codes - inside).max(axis=1))
        return QuadEdges(
            **{
                name: getattr(self, name)[None]
                for name in QuadEdges.__struct_fields__
                if name in self.__struct_fields__
            },
            inside=inside[None, :, :, 0].astype(np.float64),
            unevenness=uneven[None, :, 0].astype(np.float64),
        )


class _Look(NamedTuple):
    """The view along the sides of an outline."""

    at: SideFrame
    max_off_px: Values  # how far from its line a step may be at most, shape ``(4, 1)``
    reach: int
    codes: Plane  # the pixels across, from the inside to the outside, ``(2 reach + 1, 4, n, 3)``


def measure_outline(picture: SheetPicture, corners_px: Points, sigma_px: float) -> OutlineSides | None:
    """Measure the sides of an outline; None where it has none near by, or they reach the border of the picture.

    Args:
        corners_px: About where the corners are, clockwise on the screen, shape ``(4, 2)``.
        sigma_px: How far from there the true sides may be, a standard deviation.
    """
    sides = None
    for off_px in (sigma_px, FAR_SIGMAS * sigma_px):
        # The reach holds the error of the start, half the edge, and a plateau to read the level on.
        sides = _measure_within(picture, corners_px, off_px + USUAL_EDGE_PX / 2 + PLATEAU_PX)
        if sides is not None and sides.support.min() >= SUPPORTED:
            break
    if sides is None:
        return None
    expected_px = corners_px
    for _ in range(NARROW_LOOKS):
        # The reach needed is that of the widest of the four edges now measured. The last look was enough if it saw the
        # plateau on both sides although it was off by `off_px`, and what is beside the edges is level, or it was narrow
        # already. Otherwise the next look starts from the lines just found.
        needed_px = min(max(float(sides.edge_px.max()) / 2 + PLATEAU_PX, REACHES_PX[0]), REACHES_PX[1])
        off_px = float(np.abs(sides.corners_px - expected_px).max())
        if sides.reach_px >= off_px + needed_px - SLACK_PX and (sides.rough <= CALM or sides.reach_px < needed_px + 1):
            return sides
        expected_px = sides.corners_px
        sides = _measure_within(picture, expected_px, needed_px)
        if sides is None:
            return None
    return sides


def measure_each(picture: SheetPicture, outlines_px: Points, sigma_px: float) -> list[QuadEdges | None]:
    """Measure the sides of a few outlines, ``(c, 4, 2)``, one by one; None for one that is not seen whole at once."""
    every = (measure_outline(picture, corners_px, sigma_px) for corners_px in outlines_px)
    return [None if sides is None or sides.support.min() < SUPPORTED else sides.as_edges() for sides in every]


def settle_each(picture: SheetPicture, edges: QuadEdges) -> QuadEdges:
    """Measure the sides of candidates that were measured closely, until they stay."""
    # What this engine does not see whole, such as a sheet that is partly hidden, goes to that for many candidates.
    each = measure_each(picture, edges.corners_px, SETTLED_OFF_PX)
    missing = [number for number, sides in enumerate(each) if sides is None]
    if missing:
        settled = settle_edges(picture, edges[missing])
        for place, number in enumerate(missing):
            each[number] = settled[[place]]
    return joined([sides for sides in each if sides is not None])


def _read(picture: SheetPicture, corners_px: Points, reach_px: float) -> _Look | None:
    """Read the picture across the sides; None for no outline, or one that leaves no room across, or to the border."""
    image, lens = picture.image, picture.lens
    height, width = image.shape[:2]
    corners = corners_px.tolist()
    sides = side_lines(corners)
    extents = [abs(side.forward) for side in sides]
    if not all(extent > MIN_EXTENT_PX for extent in extents):  # NaN is no outline either
        return None
    reach = _reach(corners, extents, reach_px, height, width)
    if reach < MIN_REACH_PX:
        return None
    # One step a pixel along the longest side; more would read the same pixels twice.
    steps = int(min(max((1 - 2 * CORNER_SHARE) * max(extents), MIN_STEPS), MAX_STEPS))
    bent = None
    if lens is not None:
        flat = np.array([[side.flat for side in sides]])

        def bent(along: Values) -> Values:
            return np.asarray(bend(corners_px[None], flat, along[None], lens)[0])

    at = side_frame(sides, steps, width, bent)
    # The picture as one row of pixels, so that a place is one index.
    codes = image.reshape(-1, image.shape[2]).take(at.place + at.stride * pixels_across(reach), axis=0)
    max_off_px = np.array([[max(LIMITS_PX[1], BEND_SHARE * side.length_px)] for side in sides])
    return _Look(at, max_off_px, reach, codes)


def _reach(corners: list[list[float]], extents: OfSides, reach_px: float, height: int, width: int) -> int:
    """Return the farthest that can be looked across: not beyond the border, and not near the opposite side."""
    x, y = zip(*corners, strict=True)
    room_px = min(*x, *y, width - 1 - max(x), height - 1 - max(y)) - 1
    if not room_px > 0:
        return 0
    return int(min(math.ceil(reach_px), REACH_SHARE * quad_area(corners) / max(extents), room_px))


@cache
def _rows(reach: int) -> Profiles:
    return np.arange(2 * reach + 1, dtype=np.float32)[:, None, None]


def _measure_within(picture: SheetPicture, corners_px: Points, reach_px: float) -> OutlineSides | None:
    """Find the edge in each place, and fit a line to each side."""
    look = _read(picture, corners_px, reach_px)
    if look is None:
        return None
    contrasts, off, worth, drop, rough = _steps(look, picture.light)
    line = _fit_lines(look, off, worth)
    corners = _intersections(look.at, line.offset, line.slope)
    if corners is None:
        return None
    return OutlineSides(
        corners_px=corners,
        contrast=contrasts.sum(axis=1) / 3,
        colour_contrast=np.abs(contrasts).max(axis=1),
        support=line.steps / look.codes.shape[2],
        scatter_px=line.scatter_px,
        steps=line.steps,
        # The share falls from 0.5 to -0.5 across an edge; at its steepest by `drop` a pixel, so it is 1 / drop wide.
        edge_px=1 / np.maximum(median(drop), MIN_DROP)[:, 0].astype(np.float64),
        codes_inside=look.codes[:2],
        reach_px=look.reach,
        rough=rough,
    )


def edge_points(picture: SheetPicture, corners_px: Points) -> Points:
    """Return where steps are seen along the sides between corners that were measured, shape ``(n, 2)``."""
    look = _read(picture, corners_px, REACHES_PX[0])
    if look is None:
        return np.empty((0, 2))
    _, off, worth, _, _ = _steps(look, picture.light)
    return look.at.points(off, picture.image.shape[1])[worth > 0]


def _steps(look: _Look, light: Light) -> tuple[Profiles, Values, Profiles, Profiles, float]:
    """Return contrasts; of each place how far off the edge is, how much that counts and how steep it is; and roughness.

    A step is a mixture of the two colours beside it, in light. So half way between them is half way along any direction
    in which they differ: here the one in which both sides of a side of the outline differ on the whole.
    """
    codes = look.codes
    # The outermost pixels tell how the colours differ on the whole, in levels: a mean over the steps of each side.
    difference = np.subtract(codes[0], codes[-1], dtype=np.float32)
    contrasts = np.add.reduce(difference, axis=1) / np.float32(codes.shape[2])
    # Light of three channels becomes one number a pixel: its projection on the direction from outside to inside.
    lights = (in_light(codes, light) @ contrasts[:, :, None])[..., 0]
    inside, outside = lights[0] + lights[1], lights[-2] + lights[-1]
    contrast = inside - outside
    # `inside` and `outside` are sums of two pixels each. The share is 0.5 inside, -0.5 outside, 0 half way.
    share = lights - (inside + outside) / 4
    share *= 2 / np.where(np.abs(contrast) > MIN_LIGHT, contrast, np.inf).astype(np.float32)
    # Between the two pixels the light falls in a straight line, so the crossing is at share / drop from the first.
    best, drop, share_there = steepest_fall(share)
    beyond = best.astype(np.float32) + share_there / np.maximum(drop, MIN_DROP)
    # Roughness: further than CLEAR_PX from the crossing the share should be 0.5 or -0.5; the largest difference counts.
    # In place, since these arrays are the largest.
    apart = np.abs(_rows(look.reach) - beyond)
    np.abs(share, out=share)
    share -= np.float32(0.5)
    np.abs(share, out=share)
    share *= apart > CLEAR_PX
    rough = share.max(axis=0)
    usual = median(rough)
    rough /= np.maximum(usual, SMOOTH)
    # A step is worth less where its contrast is below the usual one of its side, or its profile rougher than usual
    # (Cauchy's weight). Along a side that is rough throughout, roughness tells nothing, hence the division by `usual`.
    worth = np.minimum(contrast / np.maximum(median(contrast), MIN_LIGHT), 1) / (1 + rough * rough)
    worth *= (drop > MIN_DROP) & (contrast > 0)
    return contrasts, look.at.outward * (beyond - look.reach) - look.at.off_pixel, worth, drop, float(usual.max())


class _Lines(NamedTuple):
    """A line for each side, as a difference from where it was expected: offset + slope * from_middle."""

    offset: OfSides
    slope: OfSides
    scatter_px: Values
    steps: Indices  # how many steps lie on it


def _fit_lines(look: _Look, off: Values, worth: Profiles) -> _Lines:
    """Fit lines by least squares with Tukey's weights, from lines through medians, which outliers do not move."""
    along, cosine = look.at.from_middle, look.at.cosine
    # The slope is the median over pairs of steps half a side apart (Theil and Sen, with fixed pairs), so up to a
    # quarter of the steps may be outliers, and no iteration is needed.
    half = off.shape[1] // 2
    slope = median((off[:, -half:] - off[:, :half]) / (along[:, -half:] - along[:, :half]))
    rest = off - slope * along
    distance = np.abs(rest - median(rest)) * cosine
    limit = np.minimum(np.maximum(3 * MAD_TO_SIGMA * median(distance), LIMITS_PX[0]), look.max_off_px)
    distance /= limit
    # One round of Tukey's biweight, (1 - (d / limit)^2)^2.
    weight = np.maximum(1 - distance * distance, 0)
    weight *= weight
    weight *= worth
    lines = np.array([_line(sums) for sums in line_sums(weight, along, off)])
    distance = off - lines[:, 1:] * along
    distance -= lines[:, :1]
    distance *= cosine
    offset, slope = lines.T.tolist()
    used = (np.abs(distance) < limit) & (worth > 0)
    steps = np.add.reduce(used, axis=1)
    scatter_px = np.sqrt(np.add.reduce(distance * distance * used, axis=1) / np.maximum(steps - 2, 1))
    return _Lines(offset, slope, scatter_px, steps)


def _line(sums: OfSides) -> tuple[float, float]:
    # The normal equations solved by hand. A side without a step has total 0, and 1e-9 makes its line the expected one.
    total, first, second, height, together = sums
    total = max(total, 1e-9)
    slope = (together - first * height / total) / max(second - first * first / total, 1e-9)
    return (height - slope * first) / total, slope


def _intersections(frame: SideFrame, offset: OfSides, slope: OfSides) -> Points | None:
    """Return the corners between neighbouring lines, ``(4, 2)``; None where two of them are all but parallel."""
    # A side across = slope * along + level as a x + b y = c, where along is x for the flat ones.
    lines = []
    for side, off, steeper, middle in zip(frame.sides, offset, slope, frame.middle.ravel().tolist(), strict=True):
        steep, level = side.slope + steeper, side.at_zero + off - steeper * middle
        lines.append((-steep, 1.0, level) if side.flat else (1.0, -steep, level))
    return corners_between(lines)
