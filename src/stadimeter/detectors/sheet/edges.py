"""The four sides and corners of outlines at sub-pixel accuracy: to a few hundredths of a pixel.

Light is read along columns of pixels where a side is more horizontal and along rows where it is more vertical, so
nothing is interpolated but the last step: where, between two neighbouring pixels, it passes half way from what is
inside to what is outside. In light that is where the edge is, see `stadimeter.detectors.sampling`. A line through
these steps is fitted to each side, and the corners are where the lines meet.

One look far across finds each side as the line through medians, or, where that has too few steps, as the one that most
steps agree on; a second, narrow one measures it, from where the first ended: so it does not depend on how an outline
was found, and another version of OpenCV, which may round a contour differently, gives the same corners. Sides are
described by plain numbers, and only what is read of the picture is in arrays: the pixels across first, then the sides,
then the steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Flags, Indices, Plane, Points, Profiles, Values
from stadimeter.core.frame import Image
from stadimeter.detectors.sampling import Light, in_light, light_table, median
from stadimeter.detectors.sides import (
    CORNER_SHARE,
    LIMITS_PX,
    MAD_TO_SIGMA,
    SideFrame,
    corners_of_lines,
    line_sums,
    pixels_across,
    quad_area,
    side_frame,
    side_lines,
    steepest_fall,
)

OfSides = list[float]

# Steps along each side, at least and at most.
MIN_STEPS, MAX_STEPS = 12, 64

# Distance in pixels beyond an edge at which both sides have their own level: of a step that is spread by a Gaussian of
# 0.7 px, as in the rendered scenes, 0.8 % is left there.
PLATEAU_PX = 1.7

# Least and greatest reach across a side that is roughly known.
REACHES_PX = (3.0, 16.0)

# Greatest reach across a side, as a share of the distance to the opposite one: looks of opposite sides must not meet.
# And the least, in pixels: an edge of one pixel, and one beside it.
REACH_SHARE = 0.3
MIN_REACH_PX = 2

# Along a shorter side steps would be in the same pixels.
MIN_EXTENT_PX = 2.5

# Corners may lie outside of the picture by this share of the shortest side.
MAX_OUTSIDE = 0.4

# Inside and outside are one where their difference in light (0 to 1), projected on their difference in levels (0 to
# 255), is less. In the dark part of sRGB one level in all three channels comes to 0.9e-3.
MIN_LIGHT = 1e-3

# Least difference of the two pixels of a step, as a share of that between inside and outside.
MIN_DROP = 0.06

# Further from an edge than this a profile should be level, to this share of the way from inside to outside; a step is
# worth less the further it is from that, unless all along the side are.
CLEAR_PX = 1.5
SMOOTH = 0.04

# Width in pixels from inside to outside that an edge is taken to have before it is measured.
USUAL_EDGE_PX = 2.6

# How far from where they were measured sides may be, a standard deviation.
SETTLED_OFF_PX = 0.5

# Sides are looked for within one standard deviation first, and within this many of them only if they are not there: the
# further across a look reaches, the more of what is beside the sheet it takes for its level.
FAR_SIGMAS = 3.0

# Sides are there where this share of each lies on its line, and none of which it is less is looked at more closely.
SUPPORTED, WORTH_A_LOOK = 0.7, 0.15

# A look is enough where it reaches the level beside the edge, but for this; otherwise it is repeated this many times.
NARROW_LOOKS = 3
SLACK_PX = 0.4

# Beside the edge a profile is level to this share of the contrast; less calm sides are looked at once more, narrowly,
# so that what is beside them does not count.
CALM = 0.12

# The side of a real sheet is bent: steps may be this far from its line, as a share of its length.
BEND_SHARE = 0.004

# Rounds of Tukey's weights, from the line of the vote.
ROUNDS = 3

# Points between two corners at which the bend of a side by the lens is computed.
CURVE_POINTS = 33

# The standard deviation of a corner's coordinates is `hypot(2 s / sqrt(n), 0.012, 0.02 (e - 2.5))` pixels, for sides of
# n steps that scatter by s and take e pixels from inside to outside. A line through n points is twice as unsure at its
# ends as in its middle. The last term is for what is beside a blurred edge and mixes into it.
SIGMA_FACTOR = 2.0
SIGMA_FLOOR_PX = 0.012
SIGMA_BLUR = 0.02
SHARP_EDGE_PX = 2.5

# Candidates whose corners are all nearer to each other are one.
SAME_PX = 1.0


class SheetPicture(NamedTuple):
    """A picture in which sides are measured."""

    image: Image
    light: Light
    lens: CameraModel | None  # the lens, if it bends what is straight

    @classmethod
    def of(cls, image: Image, lens: CameraModel | None) -> SheetPicture:
        """Return a picture that was taken through a lens, or one that is not known."""
        light = light_table("srgb" if lens is None else lens.tone_curve)
        return cls(image, light, lens if lens is not None and lens.distortion else None)


class OutlineSides(Struct, frozen=True, kw_only=True, eq=False):
    """Measured sides of one outline. Side i leads from corner i to corner i + 1."""

    corners_px: Points  # where the lines meet, shape ``(4, 2)``
    contrast: Values  # how much brighter the inside of each side is, in levels of 8 bits, shape ``(4,)``
    colour_contrast: Values  # how much the inside differs in the channel that differs most, shape ``(4,)``
    support: Values  # the share of each side where there is a step on the line, shape ``(4,)``
    scatter_px: Values  # standard deviation of the steps about each line, shape ``(4,)``
    steps: Indices  # how many steps each line was fitted to, shape ``(4,)``
    edge_px: Values  # how many pixels each side takes from inside to outside at its steepest, shape ``(4,)``
    codes_inside: Plane  # the two outermost pixels inside each step, ``(2, 4, n, 3)``
    reach_px: float  # how far across was looked, on the side with the least
    rough: float  # how far beside the edges profiles usually are from level, as a share of the contrast

    @property
    def corner_sigma_px(self) -> float:
        """Standard deviation of the coordinates of the corners."""
        # Variances in px^2: of the lines through the steps, and of blur, both as a mean over the four sides; and the
        # floor.
        of_steps = SIGMA_FACTOR**2 * self.scatter_px**2 / np.maximum(self.steps, 1)
        of_blur = (SIGMA_BLUR * np.maximum(self.edge_px - SHARP_EDGE_PX, 0.0)) ** 2
        return math.sqrt(float(np.add.reduce(of_steps + of_blur)) / 4 + SIGMA_FLOOR_PX**2)

    def inside(self) -> tuple[Values, Values]:
        """Return the colour inside each side, in levels, ``(4, 3)``, and by how many it usually differs along it."""
        codes = self.codes_inside.astype(np.float32).mean(axis=0).transpose(0, 2, 1)
        inside = median(codes)
        uneven = median(np.abs(codes - inside).max(axis=1))
        return inside[:, :, 0].astype(np.float64), uneven[:, 0].astype(np.float64)


class QuadEdges(Struct, frozen=True, kw_only=True, eq=False):
    """Measured sides of candidates; fields as in `OutlineSides`, with the candidates first."""

    corners_px: Points
    contrast: Values
    colour_contrast: Values
    support: Values
    scatter_px: Values
    corner_sigmas_px: Values  # standard deviation of the coordinates of their corners, shape ``(c,)``
    inside: Values  # the colour inside each side, in levels, shape ``(c, 4, 3)``
    unevenness: Values  # by how many levels the inside along each side usually differs from that colour, ``(c, 4)``

    @classmethod
    def of(cls, every: Sequence[OutlineSides]) -> QuadEdges | None:
        """Return outlines together, without those that are the same as one before; None for none."""
        distinct: list[OutlineSides] = []
        for sides in every:
            if all(np.abs(sides.corners_px - other.corners_px).max() >= SAME_PX for other in distinct):
                distinct.append(sides)
        if not distinct:
            return None
        inside, unevenness = zip(*[sides.inside() for sides in distinct], strict=True)
        names = ("corners_px", "contrast", "colour_contrast", "support", "scatter_px")
        return cls(
            **{name: np.stack([getattr(sides, name) for sides in distinct]) for name in names},
            corner_sigmas_px=np.array([sides.corner_sigma_px for sides in distinct]),
            inside=np.stack(inside),
            unevenness=np.stack(unevenness),
        )


class _Look(NamedTuple):
    """The view along the sides of an outline."""

    at: SideFrame
    max_off_px: Values  # how far from its line a step may be at most, shape ``(4, 1)``
    reaches: list[int]  # how far across each side was looked
    codes: Plane  # the pixels across, from the inside to the outside, ``(2 reach + 1, 4, n, 3)``; see `_read`


def refine_corners(picture: SheetPicture, corners_px: Points, sigma_px: float) -> OutlineSides | None:
    """Refine the corners of an outline to sub-pixel accuracy, by lines along its edges; None where it has none.

    Args:
        corners_px: About where the corners are, clockwise on the screen, shape ``(4, 2)``.
        sigma_px: How far from there the true sides may be, a standard deviation.
    """
    sides, expected_px = None, corners_px
    for off_px in (sigma_px, FAR_SIGMAS * sigma_px):
        # The reach holds the error of the start, half the edge, and a plateau to read the level on.
        seen = _measure_within(picture, corners_px, off_px + USUAL_EDGE_PX / 2 + PLATEAU_PX)
        if seen is not None and (sides is None or seen.support.sum() > sides.support.sum()):
            sides = seen
        if sides is not None and sides.support.min() >= SUPPORTED:
            break
    if sides is None or sides.support.min() < WORTH_A_LOOK:
        return sides
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


def refine_each(picture: SheetPicture, outlines_px: Points, sigma_px: float) -> QuadEdges | None:
    """Refine outlines, ``(c, 4, 2)``; leave out those that have none, and what is there twice."""
    every = [refine_corners(picture, corners_px, sigma_px) for corners_px in outlines_px]
    if len(every) > 1:
        every = [_settled(picture, sides) for sides in every]
    return QuadEdges.of([sides for sides in every if sides is not None])


def _settled(picture: SheetPicture, sides: OutlineSides | None) -> OutlineSides | None:
    # Where there is more than one outline there is something beside them: the last look is narrow.
    if sides is None or sides.support.min() < SUPPORTED:
        return sides
    return refine_corners(picture, sides.corners_px, SETTLED_OFF_PX) or sides


def measure_cut_off(picture: SheetPicture, corners_px: Points, reach_px: float, free: Flags) -> OutlineSides | None:
    """Measure the sides of an outline that the border cuts; those that are `free`, ``(4,)``, stay where they are."""
    return _measure_within(picture, corners_px, reach_px, free)


def _read(picture: SheetPicture, corners_px: Points, reach_px: float) -> _Look | None:
    """Read the picture across the sides; None for no outline, or one that leads out of the picture."""
    image, lens = picture.image, picture.lens
    shape = image.shape[:2]
    corners = corners_px.tolist()
    sides = side_lines(corners)
    extents = [abs(side.forward) for side in sides]
    if not all(extent > MIN_EXTENT_PX for extent in extents):  # NaN is no outline either
        return None
    # The area over the extent of a side is how many pixels across the opposite one lies; no further than near that.
    area = REACH_SHARE * quad_area(corners)
    reaches = [max(int(min(math.ceil(reach_px), area / extent)), MIN_REACH_PX) for extent in extents]
    reach = max(reaches)
    x, y = zip(*corners, strict=True)
    room_px = min(*x, *y, shape[1] - 1 - max(x), shape[0] - 1 - max(y))
    if not (room_px > -MAX_OUTSIDE * min(extents) and min(shape) > 2 * reach):
        return None
    # One step a pixel along the longest side; more would read the same pixels twice.
    steps = int(min(max((1 - 2 * CORNER_SHARE) * max(extents), MIN_STEPS), MAX_STEPS))
    bent = None if lens is None else partial(_bend, corners_px, np.array([[side.flat] for side in sides]), lens)
    at = side_frame(sides, steps, shape, bent, reach if room_px < reach + 1 or bent is not None else None)
    across = pixels_across(reach)
    if reach > min(reaches):
        # Beyond a side's own reach its last pixel is repeated, so that all profiles have one shape.
        of_side = np.array(reaches)[:, None]
        across = np.minimum(np.maximum(across, -of_side), of_side)
    # The picture as one row of pixels, so that a place is one index.
    codes = image.reshape(-1, image.shape[2]).take(at.place + at.stride * across, axis=0)
    max_off_px = np.array([[max(LIMITS_PX[1], BEND_SHARE * side.length_px)] for side in sides])
    return _Look(at, max_off_px, reaches, codes)


def _bend(corners_px: Points, flat: Flags, lens: CameraModel, along: Values) -> Values:
    """Return the distance of each side from the straight line between its corners: it is straight before the lens."""
    # A straight side is straight in directions (x and y per unit of depth, distortion undone), so points on it are
    # found there and projected back: CURVE_POINTS of them, and between them the bend is interpolated.
    ends = lens.directions(corners_px)[:, None]
    straight = ends + (ends[[1, 2, 3, 0]] - ends) * np.linspace(0, 1, CURVE_POINTS)[:, None]
    x, y = np.moveaxis(lens.project(straight.reshape(-1, 2)).reshape(4, CURVE_POINTS, 2), 2, 0)
    seen_along, seen_across = np.where(flat, x, y), np.where(flat, y, x)
    first, last = seen_across[:, :1], seen_across[:, -1:]
    run = seen_along[:, -1:] - seen_along[:, :1]
    # `part` and `wanted` count along from 0 at the first corner to 1 at the next, on which the interpolation runs
    # upwards. Far outside the picture the lens has no inverse; a side from there is taken to be straight.
    part = (seen_along - seen_along[:, :1]) / run
    off = np.nan_to_num(seen_across - first - (last - first) * part)
    wanted = (along - seen_along[:, :1]) / run
    bent = np.array([np.interp(wanted[side], part[side], off[side]) for side in range(4)])
    return np.asarray(np.nan_to_num(bent, nan=0.0, posinf=0.0, neginf=0.0))


@cache
def _rows(reach: int) -> Profiles:
    return np.arange(2 * reach + 1, dtype=np.float32)[:, None, None]


def _measure_within(
    picture: SheetPicture, corners_px: Points, reach_px: float, free: Flags | None = None
) -> OutlineSides | None:
    """Find the edge in each place, and fit a line to each side but the free ones."""
    look = _read(picture, corners_px, reach_px)
    if look is None:
        return None
    contrasts, off, worth, drop, rough = _steps(look, picture.light)
    line = _fit_lines(look, off, worth)
    if free is not None:
        line.offset[free], line.slope[free] = 0.0, 0.0
    corners = corners_of_lines(look.at, line.offset, line.slope)
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
        reach_px=min(look.reaches),
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
    apart = np.abs(_rows(max(look.reaches)) - beyond)
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
    off = look.at.outward * (beyond - max(look.reaches)) - look.at.off_pixel
    return contrasts, off, worth, drop, float(usual.max())


class _Lines(NamedTuple):
    """A line for each side, as a difference from where it was expected: offset + slope * from_middle."""

    offset: Values  # shape ``(4, 1)``
    slope: Values  # shape ``(4, 1)``
    scatter_px: Values  # standard deviation of the steps about each line, shape ``(4,)``
    steps: Indices  # how many lie on it, shape ``(4,)``


def _fit_lines(look: _Look, off: Values, worth: Profiles) -> _Lines:
    """Fit lines by least squares with Tukey's weights, from lines that outliers do not move."""
    start = _lines_of_medians(look.at.from_middle, off)
    lines = _refined(look, off, worth, start, 1)
    hidden = lines.steps < SUPPORTED * off.shape[1]
    if hidden.any():
        # Steps of a finger or of what lies behind are no noise but another edge.
        for by_median, by_vote in zip(start, _lines_by_vote(look, off, worth > 0, hidden), strict=True):
            by_median[hidden] = by_vote
        lines = _refined(look, off, worth, start, ROUNDS)
    return lines


def _refined(look: _Look, off: Values, worth: Profiles, start: tuple[Values, Values], rounds: int) -> _Lines:
    along, cosine, found = look.at.from_middle, look.at.cosine, worth > 0
    offset, slope = start
    # Distances are square to the side, not across. The limit starts as wide as it may be, and shrinks with the scatter.
    limit = look.max_off_px
    distance = (off - offset - slope * along) * cosine
    for _ in range(rounds):
        # Three times the usual distance of the steps near the line; the others are sorted to the end.
        near_px = np.abs(distance)
        near = found & (near_px < limit)
        ordered = np.where(near, near_px, np.inf)
        ordered.sort(axis=1)
        half = np.minimum(np.add.reduce(near, axis=1) // 2, off.shape[1] - 1)
        limit = 3 * MAD_TO_SIGMA * ordered[_SIDES, half[:, None]]
        limit = np.minimum(np.maximum(limit, LIMITS_PX[0]), look.max_off_px)
        # Tukey's biweight, (1 - (d / limit)^2)^2.
        distance /= limit
        weight = np.maximum(1 - distance * distance, 0)
        weight *= weight
        weight *= worth
        offset, slope = np.array([_line(sums) for sums in line_sums(weight, along, off)]).T[:, :, None]
        distance = (off - offset - slope * along) * cosine
    used = (np.abs(distance) < limit) & found
    steps = np.add.reduce(used, axis=1)
    scatter_px = np.sqrt(np.add.reduce(distance * distance * used, axis=1) / np.maximum(steps - 2, 1))
    return _Lines(offset, slope, scatter_px, steps)


_SIDES = np.arange(4)[:, None]


def _lines_of_medians(along: Values, off: Values) -> tuple[Values, Values]:
    # The slope is the median over pairs of steps half a side apart (Theil and Sen, with fixed pairs), so up to a
    # quarter of the steps may be outliers, and no iteration is needed.
    half = off.shape[1] // 2
    slope = median((off[:, -half:] - off[:, :half]) / (along[:, -half:] - along[:, :half]))
    return median(off - slope * along), slope


def _lines_by_vote(look: _Look, off: Values, found: Flags, which: Flags) -> tuple[Values, Values]:
    """Return the line of some sides through two steps to which most steps are near (as in RANSAC, over fixed pairs)."""
    along, limit = look.at.from_middle[which], (look.max_off_px / look.at.cosine)[which, :, None]
    off, found = off[which], found[which]
    first, second = _pairs(off.shape[1])
    start, off_start = along[:, first], off[:, first]
    apart = along[:, second] - start
    # Steps at one place, where the border cuts, lead nowhere.
    slopes = (off[:, second] - off_start) / np.where(apart == 0, np.inf, apart)
    # Differences of slope above 1 would turn a side from flat to steep: such a pair stands for another edge. Each step
    # then votes for each line with 1 - (distance / limit)^2, so near ones count most.
    slopes *= np.abs(slopes) < 1
    offsets = off_start - slopes * start
    near = (off[:, None] - offsets[..., None] - slopes[..., None] * along[:, None]) / limit
    votes = (np.maximum(1 - near * near, 0) @ found[..., None].astype(np.float64))[..., 0]
    # A line counts only if both of the steps that it leads through were found.
    best = (votes * found[:, first] * found[:, second]).argmax(axis=1)[:, None]
    return np.take_along_axis(offsets, best, axis=1), np.take_along_axis(slopes, best, axis=1)


@cache
def _pairs(steps: int) -> tuple[Indices, Indices]:
    """Return pairs of steps half a side apart, and a third apart.

    A line through near ones would be unsure, and with only one distance an occluder of half a side would spoil every
    pair.
    """
    half, third = steps // 2, (steps + 2) // 3
    first = np.concatenate((np.arange(steps - half), np.arange(0, steps - third, 2)))
    second = np.concatenate((np.arange(half, steps), np.arange(third, steps, 2)))
    return first, second


def _line(sums: OfSides) -> tuple[float, float]:
    # The normal equations solved by hand. A side without a step has total 0, and 1e-9 makes its line the expected one.
    total, first, second, height, together = sums
    total = max(total, 1e-9)
    slope = (together - first * height / total) / max(second - first * first / total, 1e-9)
    return (height - slope * first) / total, slope
