"""The four sides of candidates, to a few hundredths of a pixel.

Light is read along columns of pixels where a side is more horizontal and along rows where it is more vertical, so
nothing is interpolated but the last step: where, between two neighbouring pixels, it passes half way from what is
inside to what is outside. In light that is where the edge is, see `stadimeter.detectors.sampling`. Half way is
meant in all three channels at once, along the straight line between both colours, and for each step anew, since what
is behind a sheet is of many colours. A line through these steps is fitted to each side, and the corners are where the
lines meet.

The lines are fitted again from where the last fit ended until they stay, so they do not depend on how a candidate was
found: another version of OpenCV, which may round a contour differently, gives the same corners.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Flags, Indices, Plane, Points, Profiles, Values
from stadimeter.core.frame import Image
from stadimeter.detectors.sampling import Light, in_light, light_table, median
from stadimeter.detectors.sheet.lines import (
    QuadFrame,
    fit_lines,
    intersections,
    picked,
    quad_frame,
)
from stadimeter.detectors.sides import CORNER_SHARE

# Steps along each side: at the first look, the second, and at most and at least while lines settle.
FIRST_STEPS = 16
NEXT_STEPS = 24
MAX_STEPS = 64
MIN_STEPS = 8

# Distance in pixels beyond an edge at which both sides have their own level: of a step that is spread by a Gaussian of
# 0.7 px, as in the rendered scenes, 0.8 % is left there.
PLATEAU_PX = 1.7

# Least and greatest reach across a side that is roughly known.
REACHES_PX = (3.0, 16.0)

# Least difference of the two pixels of a step, as a share of that between inside and outside.
MIN_DROP = 0.06

# Further from an edge than this a profile should be level, to this share of the way from inside to outside; a step is
# worth less the further it is from that, unless all along the side are.
CLEAR_PX = 1.5
SMOOTH = 0.04

# A step whose two sides differ by less, in levels of 8 bits, is none.
MIN_LEVELS = 5.0

# Lines that moved by less stay where they are.
SETTLED_PX = 0.01

# Looks while lines settle, at most.
LOOKS = 6

# The standard deviation of a corner's coordinates is `hypot(2 s / sqrt(n), 0.012, 0.02 (e - 2.5))` pixels, for sides of
# n steps that scatter by s and take e pixels from inside to outside. A line through n points is twice as unsure at its
# ends as in its middle. The last term is for what is beside a blurred edge and mixes into it.
SIGMA_FACTOR = 2.0
SIGMA_FLOOR_PX = 0.012
SIGMA_BLUR = 0.02
SHARP_EDGE_PX = 2.5

# Candidates whose corners are all nearer to each other are one.
SAME_PX = 1.0


class QuadEdges(Struct, frozen=True, kw_only=True, eq=False):
    """Measured sides of candidates. Side i leads from corner i to corner i + 1."""

    corners_px: Points  # where the lines meet, shape ``(c, 4, 2)``; NaN where they do not
    contrast: Values  # how much brighter the inside of each side is, in levels of 8 bits, shape ``(c, 4)``
    colour_contrast: Values  # how much the inside differs in the channel that differs most, shape ``(c, 4)``
    support: Values  # the share of each side where there is a step on the line, of the sign that most have, ``(c, 4)``
    scatter_px: Values  # standard deviation of the steps about each line, shape ``(c, 4)``
    steps: Indices  # how many steps each line was fitted to, shape ``(c, 4)``
    edge_px: Values  # how many pixels each side takes from inside to outside at its steepest, shape ``(c, 4)``
    inside: Values  # the colour inside each side, in levels, shape ``(c, 4, 3)``
    unevenness: Values  # by how many levels the inside along each side usually differs from that colour, ``(c, 4)``

    @property
    def corner_sigmas_px(self) -> Values:
        """Standard deviation of the coordinates of their corners, shape ``(c,)``."""
        return corner_sigmas_px(self.scatter_px, self.steps, self.edge_px)

    def __len__(self) -> int:
        """Return the number of candidates."""
        return len(self.corners_px)

    def __getitem__(self, which: object) -> QuadEdges:
        """Return some of the candidates, as numpy would choose them."""
        return QuadEdges(**{name: getattr(self, name)[which] for name in self.__struct_fields__})


def corner_sigmas_px(scatter_px: Values, steps: Indices, edge_px: Values) -> Values:
    """Return the standard deviation of the coordinates of corners between four sides; the last axis is of the sides."""
    # Variances in px^2: of the lines through the steps, and of blur, both as a mean over the four sides; and the floor.
    of_steps = SIGMA_FACTOR**2 * scatter_px**2 / np.maximum(steps, 1)
    of_blur = (SIGMA_BLUR * np.maximum(edge_px - SHARP_EDGE_PX, 0.0)) ** 2
    return np.asarray(np.sqrt(np.add.reduce(of_steps + of_blur, axis=-1) / 4 + SIGMA_FLOOR_PX**2))


def joined(every: Sequence[QuadEdges]) -> QuadEdges:
    """Return candidates together."""
    if len(every) == 1:
        return every[0]
    return QuadEdges(
        **{name: np.concatenate([getattr(each, name) for each in every]) for name in QuadEdges.__struct_fields__}
    )


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


def measure_edges(picture: SheetPicture, corners_px: Points, reach_px: float, free: Flags | None = None) -> QuadEdges:
    """Fit lines to the sides of candidates once, quickly, in few places and far across.

    Args:
        corners_px: About where the corners are, clockwise on the screen, shape ``(c, 4, 2)``.
        reach_px: How far from there the true sides may be.
        free: Which sides are none but where the border cuts, shape ``(c, 4)``; they stay as they are.
    """
    reaches = np.full(corners_px.shape[:2], reach_px + PLATEAU_PX)
    frame = quad_frame(corners_px, FIRST_STEPS, reaches, picture.image.shape, picture.lens)
    return _fit(picture, frame, free)


def measure_edges_closer(picture: SheetPicture, edges: QuadEdges) -> QuadEdges:
    """Fit lines to the sides of candidates once more, in few places but narrowly."""
    return _fit(picture, _narrow_frame(picture, edges, NEXT_STEPS), None)


def settle_edges(picture: SheetPicture, edges: QuadEdges) -> QuadEdges:
    """Fit lines to the sides of candidates in many places, narrowly, until they stay."""
    moving = np.arange(len(edges))
    for _ in range(LOOKS):
        before = edges.corners_px[moving]
        again = _fit(picture, _narrow_frame(picture, edges[moving], MAX_STEPS), None)
        edges = again if len(moving) == len(edges) else _replaced(edges, moving, again)
        moved = np.abs(again.corners_px - before).max(axis=(1, 2))
        moving = moving[moved > SETTLED_PX]
        if not len(moving):
            break
    return edges


def _replaced(edges: QuadEdges, which: Indices, again: QuadEdges) -> QuadEdges:
    """Return the sides of candidates with those of some measured again."""
    for name in QuadEdges.__struct_fields__:
        getattr(edges, name)[which] = getattr(again, name)
    return edges


def distinct_edges(edges: QuadEdges) -> QuadEdges:
    """Return the candidates whose sides meet, without those that settled on the same sides as one before."""
    if not np.isfinite(edges.corners_px).all():
        edges = edges[np.isfinite(edges.corners_px).all(axis=(1, 2))]
    if len(edges) < 2:
        return edges
    # A table of all with all, of which the lower triangle compares each with those before it.
    apart = np.abs(edges.corners_px[:, None] - edges.corners_px).max(axis=(2, 3), initial=0.0)
    return edges[~np.tril(apart < SAME_PX, -1).any(axis=1)]


def _narrow_frame(picture: SheetPicture, edges: QuadEdges, max_steps: int) -> QuadFrame:
    corners = np.nan_to_num(edges.corners_px)
    # One step a pixel along the longest side of all candidates; shorter sides then read some pixels twice.
    longest = np.abs(corners[:, [1, 2, 3, 0]] - corners).max(initial=0.0)
    steps = int(min(max((1 - 2 * CORNER_SHARE) * longest, MIN_STEPS), max_steps))
    reaches = np.clip(edges.edge_px / 2 + PLATEAU_PX, *REACHES_PX)
    return quad_frame(corners, steps, reaches, picture.image.shape, picture.lens)


def _fit(picture: SheetPicture, frame: QuadFrame, free: Flags | None) -> QuadEdges:
    # Levels are the means of two pixels at either end of each profile, beyond the blur. The step is where the light,
    # projected on the line from the one colour to the other, passes half way; how much it counts follows from its
    # contrast and from how level the profile is on both sides.
    reach, light = int(frame.reach.max(initial=0)), picture.light
    codes, levels = _profiles(picture.image, frame, reach)
    inside_codes, outside_codes = _means(levels.astype(np.float32))
    difference = inside_codes - outside_codes
    # How far colours differ is the largest of the three channels, in levels: red paper on green may be as bright.
    most = np.maximum.reduce(np.abs(difference), axis=3)
    usual = median(most)
    across, drop, rough = _steps(in_light(codes, light), *_means(in_light(levels, light)), frame, reach)
    worth = np.minimum(most / np.maximum(usual, 1.0), 1.0) / (1 + (rough / np.maximum(median(rough), SMOOTH)) ** 2)
    worth = worth * ((drop > MIN_DROP) & (most > MIN_LEVELS))
    lines = fit_lines(frame, across, worth.astype(np.float64))
    # Where the border cuts there is no edge to fit; the line stays where the side was expected.
    if free is not None:
        lines.offset[free], lines.slope[free] = 0.0, 0.0
    # A step supports the outline only if it is brighter, or darker, as most steps of all four sides are.
    brighter = np.add.reduce(difference, axis=3)
    sign = np.where(median(brighter.reshape(len(brighter), -1)) >= 0, 1.0, -1.0)[:, :, None]
    inside = median(inside_codes.swapaxes(2, 3)).swapaxes(2, 3)
    return QuadEdges(
        corners_px=intersections(frame, lines),
        contrast=median(brighter)[..., 0].astype(np.float64) / 3,
        colour_contrast=usual[..., 0].astype(np.float64),
        support=(lines.used & (brighter * sign > 0)).sum(axis=2) / brighter.shape[2],
        scatter_px=lines.scatter_px,
        steps=lines.steps,
        edge_px=1 / median(np.maximum(drop, MIN_DROP))[..., 0],
        inside=inside[:, :, 0].astype(np.float64),
        unevenness=median(np.abs(inside_codes - inside).max(axis=3))[..., 0].astype(np.float64),
    )


def _means(levels: Profiles) -> tuple[Profiles, Profiles]:
    """Return the means inside and outside each step: of two pixels each, so that one alone counts less."""
    half = np.float32(0.5)
    return (levels[:, :, :, 0] + levels[:, :, :, 1]) * half, (levels[:, :, :, 2] + levels[:, :, :, 3]) * half


def _profiles(image: Image, frame: QuadFrame, reach: int) -> tuple[Plane, Plane]:
    """Return the code values across each side, from the inside to the outside, shape ``(c, 4, n, 2 reach + 1, 3)``.

    And the two pixels at either end, as far as each outline itself reaches: the profiles all have the widest reach.
    """
    width = image.shape[1]
    # Pixels counted row by row: one further across is a row further for flat sides, a column for the others. Offsets
    # beyond an outline's own reach repeat its last pixel, so that all profiles have one shape.
    apart = np.where(frame.flat, width, 1)
    middle = (frame.pixel * apart + frame.along * (width + 1 - apart)).astype(np.int64)
    offsets = np.minimum(np.maximum(np.arange(-reach, reach + 1), -frame.reach), frame.reach)
    ends = np.concatenate((-frame.reach, 1 - frame.reach, frame.reach - 1, frame.reach), axis=2)
    pixels, outward, middle = image.reshape(-1, image.shape[2]), apart * frame.outward, middle[..., None]
    codes, levels = (pixels.take(middle + (outward * each)[:, :, None], axis=0) for each in (offsets, ends))
    return codes, levels


def _steps(
    profiles: Profiles, inside: Profiles, outside: Profiles, frame: QuadFrame, reach: int
) -> tuple[Values, Values, Values]:
    """Return where each profile passes half way from the inside to the outside, and how much it drops there.

    The last is how far beside its edge a profile is from what it should be there, as a share of the way: where another
    edge runs beside that of the sheet, half way is not where it seems.
    """
    # Projection on the line from the outside's colour o to the inside's i: share = (p - o) . (i - o) / |i - o|^2 - 1/2,
    # which is 0.5 inside, -0.5 outside and 0 where a pixel mixes both half and half.
    difference = inside - outside
    scale = np.einsum("cskx,cskx->csk", difference, difference)
    towards = difference / np.maximum(scale, 1e-9)[..., None]
    share = np.einsum("cskpx,cskx->cskp", profiles, towards)
    share -= (np.einsum("cskx,cskx->csk", outside, towards) + 0.5)[..., None]
    before, after = share[..., :-1], share[..., 1:]
    drop = (before - after) * ((before >= 0) & (after < 0))
    # Of several crossings in one profile the steepest is the edge; within it light falls in a straight line.
    best = drop.argmax(axis=3)[..., None]
    height = picked(drop, best)[..., 0].astype(np.float64)
    start = picked(share, best)[..., 0]
    beyond = best[..., 0] + start / np.maximum(height, MIN_DROP)
    # The largest distance from +-0.5 further than CLEAR_PX from the crossing.
    apart = np.abs(np.arange(share.shape[3]) - beyond[..., None])
    off_level = np.abs(np.abs(share) - 0.5) * (apart > CLEAR_PX)
    return frame.pixel + frame.outward * (beyond - reach), height, np.maximum.reduce(off_level, axis=3)
