"""The edges of something round, to a few hundredths of a pixel.

Spokes cross the expected outline all around. Each is a piece of the row of pixels, or of the column, that crosses the
outline more squarely, so no pixel has to be interpolated; only where the step lies between two of them is. The step is
where the light passes half way from what is inside to what is outside, see `stadimeter.detectors.sampling`; with
colours, on the straight line from the one colour to the other. Both levels are read just beside the step: further
inside a ball is shaded differently, further outside begins something else. Three things are then put right:

- A ball gets darker towards its limb, so the level inside is a little too bright, and the step would seem to lie too
  far inside. How much darker is seen between the level and a place further inside. It holds all around for sharp
  steps, and for each spoke for blurred ones, whose levels are read where light comes from one side.
- Blur moves the step of a curved edge inwards, by ``σ² / 2 r`` for a blur with a standard deviation of σ on a radius r.
- What sharpening and glare add is the camera's edge bias, in proportion to the contrast of each step.

Arrays have the spokes first, then the pixels along them from the inside to the outside.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Flags, Indices, Points, Profiles, Values
from stadimeter.core.frame import Image
from stadimeter.detectors.ball.blobs import ImageCircle
from stadimeter.detectors.ball.colours import BallColours, likely_drop
from stadimeter.detectors.sampling import Light, light_table, quantile

# Spokes across each of the four sides for each pixel of the radius: no row or column is read twice.
MAX_SPOKES_A_SIDE = 16
SPOKES_A_PIXEL = 1.2

# A smaller circle is looked around as if it had this radius.
MIN_RADIUS_PX = 2.0

# Least change over two pixels: in levels of 8 bits, of all channels or along one axis of colours, and as a share of
# the upper quartile of all spokes.
MIN_CHANGE, MIN_DROP, CLEAR_SHARE = 12.0, 5.0, 0.12

# The pixels beside the steepest place that tell where a sharp step is.
NEAR = np.arange(-6, 4)[:, None]

# Weights of these pixels, a row for each figure: how much brighter it is inside, two to three pixels before the
# steepest place, than outside, two to three pixels behind it; how much brighter still it is further inside; and how
# much brighter than outside the pixels before, at and behind the steepest place are.
LEVELS = np.array(
    [
        [0.0, 0.0, 0.0, 0.5, 0.5, 0.0, 0.0, 0.0, -0.5, -0.5],
        [0.5, 0.5, 0.0, -0.5, -0.5, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -0.5, -0.5],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -0.5, -0.5],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, -0.5, -0.5],
    ],
    np.float32,
)

# The product with these is the sum over the channels, several times as fast as numpy's.
CHANNELS = np.ones(3, np.float32)

# A channel with such a code value holds more light than it tells; the others must do. JPEG leaves it below 255.
CLIPPED = 251

# Least squared difference of inside and outside; less is noise of dark pixels.
MIN_LIGHT = 2e-5

# Steps up to the first width tell how a ball is shaded. If most are wider than the second, levels are read further
# off.
SHARP_PX, BLURRED_PX = 3.0, 3.2

# A ball's limb is not darker than this, as a share of the step; more is a seam or a hand.
MAX_SHADE = 0.2

# The same for blurred steps, whose levels are read further off, so that one side may be shaded more than the other.
MIN_BLURRED_SHADE, MAX_BLURRED_SHADE = -0.1, 0.4

# Distance from a blurred step at which its levels are read: half its width, and what point spread adds.
GAP_PX, GAP_OF_WIDTH, MAX_GAP_PX = 0.7, 0.5, 10.7

# Greatest number of times that the levels of a blurred step are read, each time from further away; and of the first of
# them, in which a wide step would look like shade.
MAX_ROUNDS, UNSHADED_ROUNDS = 4, 2

# Distance from the steepest place at which the light on either side of it is compared, for the edge bias.
BESIDE_PX = 3

# Standard deviation of the blur as a share of how wide a step is.
BLUR_OF_WIDTH = 0.3


class LimbEdges(Struct, frozen=True, kw_only=True, eq=False):
    """Steps around something round."""

    places: Values  # where they are, shape ``(3, n)``: x and y in pixels, and ones
    usual_width_px: float  # how many pixels they take from inside to outside, along the spokes: the median
    wide_width_px: float  # one in eight is wider than this
    spokes: int  # how many spokes there are around it, those that leave the picture included
    inside: int  # how many of them do not, and were looked along

    @property
    def points_px(self) -> Points:
        """The steps, shape ``(n, 2)``."""
        return self.places[:2].T


class _Rose(Struct, frozen=True, kw_only=True, eq=False):
    """Spokes around any circle: a quarter of them crosses each of its four sides, at evenly spread angles."""

    # What the first pixels follow from: the sums of these rows, times the radius, the pixels inside, the
    # centre's x, its y, and 1, are their x, then their y, then ones, shape ``(5, 3 n)``.
    start: Values
    step: Values  # from each pixel to the next, x, y and 0, shape ``(3, n)``
    slant: Values  # how much longer a way across the edge is along the spoke, shape ``(n,)``


class _Spokes(NamedTuple):
    """The pixels that are looked at."""

    pixels: Indices  # index of each in the flat picture, shape ``(n, k)``
    start: Values  # where the first pixel of each spoke is: x, y and 1, shape ``(3, n)``
    step: Values  # from each pixel to the next, x, y and 0, shape ``(3, n)``
    slant: Values  # how much longer a way across the edge is along the spoke, shape ``(n,)``
    expected: int  # how many there would be without the border


class _LimbSteps(NamedTuple):
    """Steps on spokes."""

    at: Profiles | Values  # where they are, in pixels from the start of the spoke, shape ``(n,)``
    width: Profiles  # how wide they are, shape ``(n,)``
    found: Flags  # which of them are steps, shape ``(n,)``


def limb_edges(
    image: Image,
    circle: ImageCircle,
    reach_px: float,
    within_px: float,
    lens: CameraModel,
    colours: BallColours | None = None,
) -> LimbEdges | None:
    """Find a step for each spoke that shows one, near an expected circle; None where no spoke does.

    Args:
        reach_px: How far from it pixels are looked at, along rows and columns.
        within_px: How far from it the steps may be.
        lens: For its tone curve and its edge bias: how far outwards the edge of something bright appears.
        colours: Those of the ball and around it; None to go by the steps alone.
    """
    light = light_table(lens.tone_curve)
    # Whole pixels inside and outside; never over the centre, beyond which the other side of the ball begins.
    inside = max(1, round(min(reach_px, 0.8 * circle.radius_px)))
    spokes = _spokes(image.shape, circle, inside, max(4, math.ceil(reach_px)))
    if spokes is None:
        return None
    # One gather for all spokes, shape (spokes, pixels, 3), 8-bit code values.
    codes = image.reshape(-1, 3).take(spokes.pixels, axis=0, mode="clip")
    first, last = max(0, math.floor(inside - within_px)), math.ceil(inside + within_px) + 1
    steepest, is_clear = _find_steepest(codes[:, first:last], colours)
    steepest += first
    steps = _measure_sharp(codes, steepest, light)
    # The median width decides for all spokes, so that both ways of reading are never mixed in one fit. Half-level
    # windows of ±1.5 px win on sharp pictures (0.23 % median), wide ones on blur above 8 px.
    if quantile(steps.width) > BLURRED_PX:
        steps = _measure_blurred(codes, steepest, light)
    found = steps.found & is_clear
    width = steps.width.compress(found)
    if not len(width):
        return None
    width.sort()
    # Sorted: the median, and the seventh eighth of the widths.
    usual_px = float(width[len(width) // 2])
    # A blur of σ draws the step of a circle of radius r inwards by σ² / 2 r.
    outwards_px: float | Profiles = (BLUR_OF_WIDTH * usual_px) ** 2 / (2 * circle.radius_px)
    if lens.edge_bias_px:
        outwards_px = outwards_px - lens.edge_bias_px * _contrast(codes, steepest, light)
    # Across the edge one pixel, along the spoke `slant` of them: places move along the row or column that was read.
    places = spokes.start + spokes.step * (steps.at + outwards_px * spokes.slant)
    return LimbEdges(
        places=places.compress(found, axis=1),
        usual_width_px=usual_px,
        wide_width_px=float(width[len(width) - 1 - len(width) // 8]),
        spokes=spokes.expected,
        inside=len(found),
    )


def _contrast(codes: Image, steepest: Indices, light: Light) -> Profiles:
    """Return the excess of light inside each step over outside, as a share of the brighter side: -1 to 1.

    The camera shows the edges of the bright too far out, those of the dark too far in, and an edge between two sides
    of the same light where it is.
    """
    spoke, last = np.arange(len(codes)), codes.shape[1] - 1
    # Sums of the light of the three channels, three pixels to either side of the steepest place.
    inside, outside = (
        light.take(codes[spoke, np.minimum(np.maximum(steepest + beside, 0), last)]).dot(CHANNELS)
        for beside in (-BESIDE_PX, BESIDE_PX)
    )
    return np.asarray((inside - outside) / np.maximum(np.maximum(inside, outside), MIN_LIGHT))


@lru_cache(maxsize=MAX_SPOKES_A_SIDE)
def _rose(a_side: int) -> _Rose:
    """Return spokes at evenly spread angles, in the quarter circles about right, down, left and up."""
    # Four sides of the outline: right, down, left, up. On each, spokes run along rows or columns, within 45 degrees of
    # the normal, so the slant 1 / cos is 1.41 at most, 1.11 in the mean.
    angles = np.repeat(np.arange(4) * (math.pi / 2), a_side)
    beside = np.tile((np.arange(a_side) + 0.5) * (math.pi / 2 / a_side) - math.pi / 4, 4)
    step = np.rint([np.cos(angles), np.sin(angles), np.zeros(4 * a_side)])
    limb = np.array([np.cos(angles + beside), np.sin(angles + beside), np.zeros(4 * a_side)])
    constant = np.repeat(np.eye(3), 4 * a_side, axis=1)
    return _Rose(
        start=np.vstack([limb.ravel(), -step.ravel(), constant]), step=step, slant=np.asarray(1 / np.cos(beside))
    )


@lru_cache(maxsize=64)
def _offsets(a_side: int, width: int, length: int) -> tuple[Values, Indices]:
    """Return the factors of the index of a place in the flat picture, and offsets along each spoke from its first."""
    index = np.array((1.0, width, 0.0))
    return index, np.outer(index.dot(_rose(a_side).step), np.arange(length)).astype(np.intp)


def _spokes(shape: tuple[int, ...], circle: ImageCircle, inside: int, outside: int) -> _Spokes | None:
    """Lay spokes from `inside` pixels inside the circle to `outside` pixels outside, those that fit the picture."""
    height, width = shape[:2]
    x, y, radius = circle.x_px, circle.y_px, max(circle.radius_px, MIN_RADIUS_PX)
    a_side = int(min(MAX_SPOKES_A_SIDE, max(3, SPOKES_A_PIXEL * radius)))
    rose = _rose(a_side)
    # First pixels rounded to whole ones; everything after is integer steps, so one index and a table of offsets address
    # the flat picture.
    start = np.rint(np.array((radius, inside, x, y, 1.0)).dot(rose.start)).reshape(3, -1)
    index, offsets = _offsets(a_side, width, inside + outside + 1)
    pixels = index.dot(start).astype(np.intp)[:, None] + offsets
    spokes = _Spokes(pixels, start, rose.step, rose.slant, 4 * a_side)
    reach = radius + outside + 1
    is_whole = min(x, y, width - 1 - x, height - 1 - y) >= reach and radius >= inside
    return spokes if is_whole else _keep_whole(spokes, width, height)


def _keep_whole(spokes: _Spokes, width: int, height: int) -> _Spokes | None:
    """Return the spokes that are whole in the picture; None if there are none."""
    # A spoke that leaves the picture is left out as a whole: its outer level would be that of a repeated border pixel.
    ends = spokes.start + spokes.step * (spokes.pixels.shape[1] - 1)
    low, high = np.minimum(spokes.start, ends), np.maximum(spokes.start, ends)
    whole = (low[0] >= 0) & (low[1] >= 0) & (high[0] < width) & (high[1] < height)
    if not whole.any():
        return None
    start, step = spokes.start[:, whole], spokes.step[:, whole]
    return _Spokes(spokes.pixels[whole], start, step, spokes.slant[whole], spokes.expected)


def _find_steepest(codes: Image, colours: BallColours | None) -> tuple[Indices, Flags]:
    """Return where the colour of each spoke changes most, and whether that is more than noise, shape ``(n,)`` each.

    Where it is known which colours are the ball's, only the change from these to others counts.

    Compared are the pixel before and the one after. Noise has a steepest place too, but nothing like that of most.
    """
    if colours is None:
        # Squared distance in BGR between the pixels two apart, about each pixel but the first and last.
        change = np.subtract(codes[:, 2:], codes[:, :-2], dtype=np.float32)
        change *= change
        squared, noise = change.reshape(-1, 3).dot(CHANNELS), MIN_CHANGE
    else:
        drop = likely_drop(codes, colours)
        squared, noise = np.square(drop).ravel(), MIN_DROP
    length = codes.shape[1] - 2
    steepest = squared.reshape(-1, length).argmax(axis=1)
    most = squared.take(steepest + _first_of_each(len(steepest), length))
    least = max(noise**2, CLEAR_SHARE**2 * quantile(most, 0.75))
    return steepest + 1, most > least


@lru_cache(maxsize=256)
def _first_of_each(rows: int, length: int) -> Indices:
    """Return the index of the first place of each row in their flat array."""
    return np.arange(0, rows * length, length)


def _measure_sharp(codes: Image, steepest: Indices, light: Light) -> _LimbSteps:
    """Measure steps no wider than a sharp picture has them, from a few pixels about the steepest places."""
    spokes, length = codes.shape[:2]
    # Ten pixels about each steepest place, six inside to three outside, turned so that each offset is a row: then five
    # weighted sums are one matrix product.
    near = _near(length).take(steepest, axis=1)
    near += _first_of_each(spokes, length)
    near_codes = codes.reshape(-1, 3).take(near, axis=0)
    levels = LEVELS.dot(_decode(near_codes, light).reshape(len(NEAR), -1))
    # `way` is the difference of the inner and the outer level as a vector of three channels, in linear light. Every
    # pixel is projected on it, so a step in any colour counts, not only one in brightness. Clipped channels say nothing
    # and are left out.
    way = levels[0]
    if near_codes.max() >= CLIPPED:
        way = way * (np.maximum.reduce(near_codes, axis=0) < CLIPPED).ravel()
    products = (levels * way).reshape(-1, 3).dot(CHANNELS).reshape(-1, spokes)
    rise, before, here, after = products[1:] / np.maximum(products[0], MIN_LIGHT)
    # From here on light is a share of the step: 1 inside, 0 outside. At the limb a ball is darker than where the inner
    # level is read, so half way is lowered by half of that shade.
    width = 2 / np.maximum(before - after, 0.02)
    half = 0.5 - 0.5 * _shade(rise, width)
    above = here - half
    drop = np.where(above > 0, here - after, before - here)
    # Linear interpolation between the two pixels on either side of half way.
    at = steepest + above / np.maximum(drop, 1e-3)
    return _LimbSteps(at, width, (before > half) & (after <= half))


@lru_cache(maxsize=64)
def _near(length: int) -> Indices:
    """Return the pixels beside each place of a spoke that are within it, a column for each place."""
    return np.asarray(np.minimum(np.maximum(np.arange(length) + NEAR, 0), length - 1), np.intp)


def _shade(rise: Profiles, width: Profiles) -> float:
    """Return by how much the level inside is brighter where it is read than at the limb, as a share of the step."""
    sharp = rise.compress(width < SHARP_PX)
    return min(max(quantile(sharp), 0.0), MAX_SHADE) if len(sharp) else 0.0


def _measure_blurred(codes: Image, steepest: Indices, light: Light) -> _LimbSteps:
    """Measure steps of any width: levels are read beyond their foot, found in a few rounds."""
    spoke, last = np.arange(len(codes)), codes.shape[1] - 1
    lit = _decode(codes, light)
    way = lit[spoke, np.maximum(steepest - 2, 0)] - lit[spoke, np.minimum(steepest + 2, last)]
    if codes.max() >= CLIPPED:
        # Turned so that each place of all spokes lies in a row, numpy is twenty times as fast.
        way *= np.maximum.reduce(np.ascontiguousarray(codes.swapaxes(0, 1)), axis=0) < CLIPPED
    squared = np.maximum((way * way).sum(axis=1), MIN_LIGHT)
    # Light along the way from outside to inside, in units of the step; the offset cancels in differences and halves.
    share = np.matmul(lit, (way / squared[:, None])[:, :, None])[:, :, 0]
    fall = np.maximum((share[spoke, steepest - 1] - share[spoke, steepest + 1]) / 2, 1e-3)
    middle, width = steepest, np.full(len(share), SHARP_PX, np.float32)
    # How wide a step is and where its levels are read follow from each other: a few rounds settle both.
    for rounds in range(MAX_ROUNDS):
        # Levels are read half a width beyond the step plus 0.7 px of point spread, two pixels averaged, 10.7 px at
        # most: further off other things begin.
        gap = np.rint(GAP_PX + GAP_OF_WIDTH * width).clip(1, MAX_GAP_PX).astype(np.intp)
        inner, outer = np.maximum(middle - gap, 1), np.minimum(middle + gap, last - 1)
        high = (share[spoke, inner] + share[spoke, inner - 1]) / 2
        low = (share[spoke, outer] + share[spoke, outer + 1]) / 2
        width = (high - low) / fall
        # As far again inside as the level was read, a ball that is lit from there is as much brighter again.
        rise, step = share[spoke, np.maximum(middle - 2 * gap, 0)] - high, np.maximum(high - low, 1e-3)
        shade = np.minimum(np.maximum(rise, MIN_BLURRED_SHADE * step), MAX_BLURRED_SHADE * step)
        at, found = _find_passages(
            share, spoke, middle, (high + low - (shade if rounds >= UNSHADED_ROUNDS else 0.0)) / 2
        )
        middle = np.where(found, np.rint(at), middle).astype(np.intp)
    return _LimbSteps(at, width, found & (high > low))


def _find_passages(share: Profiles, spoke: Indices, middle: Indices, half: Profiles) -> tuple[Profiles, Flags]:
    """Return where each spoke passes half way nearest to its middle, and whether it does."""
    above = share > half[:, None]
    # From above to not above.
    passes = above[:, :-1] > above[:, 1:]
    # Of several passages the one nearest to the middle: nearness times 0 or 1, the greatest wins.
    before = (_nearness(share.shape[1]).take(middle, axis=0) * passes).argmax(axis=1)
    found = passes[spoke, before]
    upper, lower = share[spoke, before], share[spoke, before + 1]
    return before + (upper - half) / np.where(found, upper - lower, 1.0), found


@lru_cache(maxsize=64)
def _nearness(length: int) -> Profiles:
    """Return the nearness of the place half way to the next to each of a spoke, a row for each; all above zero."""
    places = np.arange(length, dtype=np.float32)
    return np.asarray(length - np.abs(places[:-1] + 0.5 - places[:, None]), np.float32)


def _decode(codes: Image, light: Light) -> Profiles:
    """Return the light of code values of any shape ``(…, 3)``; OpenCV looks it up faster than numpy."""
    return np.asarray(cv2.LUT(codes, light), np.float32)
