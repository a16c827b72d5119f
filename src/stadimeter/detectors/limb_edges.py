"""The edges of something round, to a few hundredths of a pixel.

Spokes cross the expected outline all around. Each is a piece of the row of pixels, or of the column, that crosses the
outline more squarely, so no pixel has to be interpolated; only where the step lies between two of them is. The step is
where the light passes half way from what is inside to what is outside, see `stadimeter.detectors.linear_light`; with
colours, on the straight line from the one colour to the other. Both levels are read just beside the step: further
inside a ball is shaded differently, further outside begins something else. Three things are then put right:

- A ball gets darker towards its limb, so the level inside is a little too bright, and the step would seem to lie too
  far inside. How much darker is seen between the level and a place further inside, and holds all around.
- Blur moves the step of a curved edge inwards, by ``σ² / 2 r`` for a blur with a standard deviation of σ on a radius r.
- What sharpening and glare add is the camera's edge bias.

Arrays have the spokes first, then the pixels along them from the inside to the outside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.core.frame import Image
from stadimeter.detectors.circle_fit import Circle
from stadimeter.detectors.linear_light import Light

Values = NDArray[np.float64]
Profiles = NDArray[np.float32]
Indices = NDArray[np.intp]
Flags = NDArray[np.bool_]

MOST_SPOKES_A_SIDE = 16
SPOKES_A_PIXEL = 1.2
LEAST_RADIUS_PX = 2.0

LEAST_CHANGE, CLEAR_SHARE = 12.0, 0.25
"""Over two pixels the colour must change by so many levels of 8 bits, and by this share of what it does elsewhere."""

NEAR = np.arange(-6, 4)
"""The pixels beside the steepest place that tell where a sharp step is. By their number in this list:"""
DEEPER, INNER, HERE, OUTER = (0, 1), (3, 4), 6, (8, 9)

CLIPPED = 251
"""A channel with such a code value holds more light than it tells; the others must do. JPEG leaves it below 255."""

LEAST_LIGHT = 2e-5
"""Where the squared difference of inside and outside is less there is no step, but noise of dark pixels."""

SHARP_PX, BLURRED_PX = 3.0, 3.2
"""Steps up to the first width tell how a ball is shaded. If most are wider than the second, levels are read further
off."""

MOST_SHADE = 0.2
"""A ball's limb is not darker than this, as a share of the step; more is a seam or a hand."""

GAP_PX, GAP_OF_WIDTH, MOST_GAP_PX = 0.7, 0.5, 10.7
"""How far from a blurred step its levels are read: half its width, and what point spread adds at its foot."""

MOST_ROUNDS = 4
"""How often the levels of a blurred step are read again, from further away."""

BLUR_OF_WIDTH = 0.3
"""Standard deviation of the blur as a share of how wide a step is."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LimbEdges:
    """Steps around something round.

    Attributes:
        points_px: Where they are, shape ``(n, 2)``.
        width_px: How many pixels each takes from inside to outside at its steepest, along its spoke, shape ``(n,)``.
        usual_width_px: The median of these.
        spokes: How many spokes there are around it, those that leave the picture included.
        inside: How many of them do not, and were looked along.
    """

    points_px: Points
    width_px: Profiles
    usual_width_px: float
    spokes: int
    inside: int


@dataclass(frozen=True, slots=True, eq=False)
class _Rose:
    """Where spokes are on a circle with a radius of 1: a quarter of them crosses each of its four sides.

    Attributes:
        sine: How far from the middle of its side each spoke is, shape ``(n,)``.
        slant: One by the cosine of that: how much longer a way across the edge is along the spoke, shape ``(n,)``.
        sign: 1 for the right and the lower side, -1 for the left and the upper one, shape ``(n,)``.
        on_rows: Which spokes are pieces of rows: those of the right and the left side, shape ``(n,)``.
    """

    sine: Values
    slant: Values
    sign: Values
    on_rows: Flags

    def part(self, which: Flags) -> _Rose:
        """Return some of the spokes."""
        return _Rose(self.sine[which], self.slant[which], self.sign[which], self.on_rows[which])


@dataclass(frozen=True, slots=True, eq=False)
class _Spokes:
    """Which pixels are looked at.

    Attributes:
        places: Index of each pixel in the flat picture, shape ``(n, k)``.
        along_px: Where the first pixel of each is along its row or column, shape ``(n,)``.
        across_px: Which row or column it is, shape ``(n,)``.
        rose: How they lie.
        expected: How many there would be without the border.
    """

    places: Indices
    along_px: Values
    across_px: Values
    rose: _Rose
    expected: int


@dataclass(frozen=True, slots=True, eq=False)
class _Steps:
    """Steps on spokes, shape ``(n,)`` each.

    Attributes:
        at: Where they are, in pixels from the start of the spoke.
        width: How wide they are.
        found: Which of them are steps.
        brighter: How much brighter it is inside, the sum over all.
    """

    at: Profiles
    width: Profiles
    found: Flags
    brighter: float


def limb_edges(
    image: Image, circle: Circle, reach_px: float, within_px: float, light: Light, bias_px: float = 0.0
) -> LimbEdges | None:
    """Look for the steps near an expected circle.

    Args:
        image: The picture, three channels.
        circle: Where the outline is expected.
        reach_px: How far from it pixels are looked at, along rows and columns.
        within_px: How far from it the steps may be.
        light: What each code value stands for.
        bias_px: The camera's edge bias: how far outwards the edge of something bright appears.

    Returns:
        The steps, one for each spoke that shows one; None where no spoke does.
    """
    inside = max(1, round(min(reach_px, 0.8 * circle.radius_px)))
    spokes = _spokes(image.shape, circle, inside, max(4, math.ceil(reach_px)))
    if spokes is None:
        return None
    codes = image.reshape(-1, 3).take(spokes.places, axis=0, mode="clip")
    first, last = max(0, math.floor(inside - within_px)), math.ceil(inside + within_px) + 1
    steepest, is_clear = _steepest(codes[:, first:last].astype(np.float32))
    steps = _sharp_steps(codes, steepest + first, light)
    if middle_value(steps.width) > BLURRED_PX:
        steps = _blurred_steps(codes, steepest + first, light)
    found = steps.found & is_clear
    if not found.any():
        return None
    width = steps.width[found]
    usual = middle_value(width)
    blurred_px = (BLUR_OF_WIDTH * usual) ** 2 / (2 * circle.radius_px)
    outwards_px = blurred_px - math.copysign(bias_px, bias_px * steps.brighter)
    along = spokes.along_px + spokes.rose.sign * (steps.at + outwards_px * spokes.rose.slant)
    points = np.empty((len(along), 2))
    points[:, 0] = np.where(spokes.rose.on_rows, along, spokes.across_px)
    points[:, 1] = np.where(spokes.rose.on_rows, spokes.across_px, along)
    return LimbEdges(
        points_px=points[found], width_px=width, usual_width_px=usual, spokes=spokes.expected, inside=len(along)
    )


def middle_value(values: Profiles | Values) -> float:
    """Return the (upper) median; for so few values ten times as fast as numpy's."""
    half = len(values) // 2
    return float(np.partition(values, half)[half])


@lru_cache(maxsize=MOST_SPOKES_A_SIDE)
def _rose(a_side: int) -> _Rose:
    """Return spokes at evenly spread angles, in the quarter circles about right, down, left and up."""
    angles = np.tile((np.arange(a_side) + 0.5) * (math.pi / 2 / a_side) - math.pi / 4, 4)
    sides = np.repeat((1.0, 1.0, -1.0, -1.0), a_side)
    return _Rose(np.sin(angles), 1 / np.cos(angles), sides, np.repeat((True, False, True, False), a_side))


@lru_cache(maxsize=64)
def _strides(a_side: int, width: int, length: int) -> tuple[Values, Values, Indices]:
    """Return how far apart pixels are in the flat picture: along a spoke's row or column, across, and for all of it."""
    rose = _rose(a_side)
    along = np.where(rose.on_rows, 1.0, width)
    across = width + 1 - along
    return along, across, (along * rose.sign)[:, None].astype(np.intp) * np.arange(length)


def _spokes(shape: tuple[int, ...], circle: Circle, inside: int, outside: int) -> _Spokes | None:
    """Lay spokes from `inside` pixels inside the circle to `outside` pixels outside, those that fit the picture."""
    height, width = shape[:2]
    radius = max(circle.radius_px, LEAST_RADIUS_PX)
    a_side = int(min(MOST_SPOKES_A_SIDE, max(3, SPOKES_A_PIXEL * radius)))
    rose = _rose(a_side)
    middle_across = np.where(rose.on_rows, circle.y_px, circle.x_px)
    across = np.rint(middle_across + radius * rose.sine)
    beside = across - middle_across
    half = np.sqrt(np.maximum(radius * radius - beside * beside, 0.0))
    along = np.rint(np.where(rose.on_rows, circle.x_px, circle.y_px) + rose.sign * half) - rose.sign * inside
    stride_along, stride_across, offsets = _strides(a_side, width, inside + outside + 1)
    places = (along * stride_along + across * stride_across).astype(np.intp)[:, None] + offsets
    spokes = _Spokes(places, along, across, rose, 4 * a_side)
    reach = radius + outside + 1
    to_border = min(circle.x_px, circle.y_px, width - 1 - circle.x_px, height - 1 - circle.y_px)
    return spokes if to_border >= reach and radius >= inside else _inside(spokes, width, height)


def _inside(spokes: _Spokes, width: int, height: int) -> _Spokes | None:
    """Return the spokes that are whole in the picture; None if there are none."""
    rose, along, across = spokes.rose, spokes.along_px, spokes.across_px
    ends = along + rose.sign * (spokes.places.shape[1] - 1)
    lengths = np.where(rose.on_rows, width, height)
    whole = (np.minimum(along, ends) >= 0) & (np.maximum(along, ends) < lengths)
    whole &= (across >= 0) & (across < width + height - lengths)
    if not whole.any():
        return None
    return _Spokes(spokes.places[whole], along[whole], across[whole], rose.part(whole), spokes.expected)


def _steepest(codes: Profiles) -> tuple[Indices, Flags]:
    """Return where the colour of each spoke changes most, and whether that is more than noise, shape ``(n,)`` each.

    Compared are the pixel before and the one after. Noise has a steepest place too, but nothing like that of most.
    """
    change = codes[:, 2:] - codes[:, :-2]
    change *= change
    squared = change[:, :, 0] + change[:, :, 1]
    squared += change[:, :, 2]
    steepest = squared.argmax(axis=1)
    most = squared.max(axis=1)
    rank = len(most) * 3 // 4
    usual = float(np.partition(most, rank)[rank])
    return steepest + 1, most > max(LEAST_CHANGE**2, CLEAR_SHARE**2 * usual)


def _sharp_steps(codes: Image, steepest: Indices, light: Light) -> _Steps:
    """Measure steps no wider than a sharp picture has them, from a few pixels about the steepest places."""
    length = codes.shape[1]
    near = np.minimum(np.maximum(steepest[:, None] + NEAR, 0), length - 1)
    near += np.arange(0, length * len(codes), length)[:, None]
    near_codes = codes.reshape(-1, 3).take(near, axis=0)
    lit = light.take(near_codes)
    outside = lit[:, OUTER[0]] + lit[:, OUTER[1]]
    way = lit[:, INNER[0]] + lit[:, INNER[1]] - outside
    if near_codes.max() >= CLIPPED:
        way *= near_codes.max(axis=1) < CLIPPED
    squared = np.maximum((way * way).sum(axis=1), 4 * LEAST_LIGHT)
    # Twice the levels cancel: way is twice the way from outside to inside, and so is its square root.
    share = np.matmul(lit, (way * (2 / squared)[:, None])[:, :, None])[:, :, 0]
    share -= ((outside * way).sum(axis=1) / squared)[:, None]
    before, here, after = share[:, HERE - 1], share[:, HERE], share[:, HERE + 1]
    width = 2 / np.maximum(before - after, 0.02)
    half = 0.5 - 0.5 * _shade((share[:, DEEPER[0]] + share[:, DEEPER[1]]) / 2 - 1, width)
    is_beyond = here > half
    drop = np.where(is_beyond, here - after, before - here)
    at = steepest + (here - half) / np.maximum(drop, 1e-3)
    found = (before > half) & (after <= half) & (drop > 0)
    return _Steps(at, width, found, float(way.sum()))


def _shade(rise: Profiles, width: Profiles) -> float:
    """Return by how much the level inside is brighter where it is read than at the limb, as a share of the step."""
    sharp = rise[width < SHARP_PX]
    return min(max(middle_value(sharp), 0.0), MOST_SHADE) if len(sharp) else 0.0


def _blurred_steps(codes: Image, steepest: Indices, light: Light) -> _Steps:
    """Measure steps of any width: levels are read beyond their foot, found in a few rounds."""
    spoke, last = np.arange(len(codes)), codes.shape[1] - 1
    lit = light.take(codes)
    way = lit[spoke, np.maximum(steepest - 2, 0)] - lit[spoke, np.minimum(steepest + 2, last)]
    way *= codes.max(axis=1) < CLIPPED
    squared = np.maximum((way * way).sum(axis=1), LEAST_LIGHT)
    share = np.matmul(lit, (way / squared[:, None])[:, :, None])[:, :, 0]
    fall = np.maximum((share[spoke, steepest - 1] - share[spoke, steepest + 1]) / 2, 1e-3)
    middle, width = steepest, np.full(len(share), SHARP_PX, np.float32)
    for _ in range(MOST_ROUNDS):
        gap = np.rint(GAP_PX + GAP_OF_WIDTH * width).clip(1, MOST_GAP_PX).astype(np.intp)
        inner, outer = np.maximum(middle - gap, 1), np.minimum(middle + gap, last - 1)
        high = (share[spoke, inner] + share[spoke, inner - 1]) / 2
        low = (share[spoke, outer] + share[spoke, outer + 1]) / 2
        width = (high - low) / fall
        at, found = _passes(share, spoke, middle, (high + low) / 2)
        middle = np.where(found, np.rint(at), middle).astype(np.intp)
    return _Steps(at, width, found & (high > low), float(way.sum()))


def _passes(share: Profiles, spoke: Indices, middle: Indices, half: Profiles) -> tuple[Profiles, Flags]:
    """Return where each spoke passes half way nearest to its middle, and whether it does."""
    above = share > half[:, None]
    passes = above[:, :-1] & ~above[:, 1:]
    distance = np.abs(np.arange(share.shape[1] - 1) + 0.5 - middle[:, None])
    distance[~passes] = np.inf
    before = np.argmin(distance, axis=1)
    found = passes[spoke, before]
    upper, lower = share[spoke, before], share[spoke, before + 1]
    return before + (upper - half) / np.where(found, upper - lower, 1.0), found
