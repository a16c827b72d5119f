"""The limb of a ball: the cone of rays that touches it, fitted to the steps around an expected circle.

Some of the steps are not the ball's: a finger hides part of it, what lies behind it is as bright. The cone is fitted
robustly, and where too many steps miss it, started anew from the best of many circles through three steps each.
`stadimeter.detectors.ball.evidence` weighs whether the limb is that of a ball.
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
from stadimeter.detectors.ball.blobs import BallColours, ImageCircle, find_common_circle, likely_drop
from stadimeter.detectors.sampling import Light, light_table, quantile
from stadimeter.ranging.ball import MIN_RAYS, ConeFrame, SphereCone, with_ones

# The edges of something round, to a few hundredths of a pixel.
#
# Spokes cross the expected outline all around. Each is a piece of the row of pixels, or of the column, that crosses
# the outline more squarely, so no pixel has to be interpolated; only where the step lies between two of them is. The
# step is where the light passes half way from what is inside to what is outside, see `stadimeter.detectors.sampling`;
# with colours, on the straight line from the one colour to the other. Both levels are read just beside the step:
# further inside a ball is shaded differently, further outside begins something else. Three things are then put right:
#
# - A ball gets darker towards its limb, so the level inside is a little too bright, and the step would seem to lie too
#   far inside. How much darker is seen between the level and a place further inside. It holds all around for sharp
#   steps, and for each spoke for blurred ones, whose levels are read where light comes from one side.
# - Blur moves the step of a curved edge inwards, by ``σ² / 2 r`` for a blur with a standard deviation of σ on a
#   radius r.
# - What sharpening and glare add is the camera's edge bias, in proportion to the contrast of each step.
#
# Arrays have the spokes first, then the pixels along them from the inside to the outside.

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
SHARP_EDGE_PX, BLURRED_PX = 3.0, 3.2

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
    sharp = rise.compress(width < SHARP_EDGE_PX)
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
    middle, width = steepest, np.full(len(share), SHARP_EDGE_PX, np.float32)
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


# Pixels read in the first look beyond where the limb may be, for the levels beside it.
BEYOND_PX = 2.5

# Least and greatest reach on either side of the circle of the last fit.
MIN_REACH_PX, MAX_REACH_PX = 6.0, 24.0

# Half of a step, and some room, must be within reach on either side of it.
REACH_OF_WIDTH = 0.6

# Pixels that must be left of the reach beside the step: the pixels that its levels are read from, and the rounding.
REACH_SPARE_PX = 4.0

# Once a circle was fitted, the limb is looked for so near to it: pixels, a share of the radius for an oblong outline,
# and a share of how wide the steps are. Further away is the edge of a hand or of what lies behind.
WITHIN_PX, WITHIN_SHARE, WITHIN_OF_WIDTH = 2.0, 0.06, 0.3

# Once it was fitted to steps between the ball's colours and others, so near: pixels, and a share of the radius.
NEAR_PX, NEAR_SHARE = 2.0, 0.02

# A limb is doubtful where a smaller share of the spokes has a step on it, or where these scatter by more: pixels, and a
# share of what blur adds to their width. The second share is that of a limb that is beyond doubt a ball's: a look by
# colour at those of which more is seen lowered no error of 900 rendered balls, and took a fifth of the mean time.
LOOK_SUPPORT, LOOK_SUPPORT_OF_SURE, LOOK_SCATTER_PX, LOOK_SCATTER_OF_BLUR = 0.85, 0.7, 0.25, 0.2

# A limb is as rough as any ball's if its steps scatter by this: pixels for noise, a share of the radius for felt and
# fingers, and a share of what blur adds to the width of a step. And how much of a limb is as good as less roughness.
ROUGH_PX, ROUGH_SHARE, ROUGH_OF_BLUR, WORTH_OF_ROUGH = 0.3, 0.07, 0.3, 1.2

# Greatest number of looks, each around the last fit, until the same steps are found.
MAX_LOOKS = 4

# Greatest number of reweighted fits of the cone; they end once the limit for outliers shrinks by less, nor
# where all steps are so near that they count fully.
ROUNDS, SETTLED_SHARE = 5, 0.8

# Steps no further from the cone than this always count fully: noise alone puts them there.
MIN_OUTLIER_PX = 0.25

# Steps further from the cone than this many of their usual distances are outliers.
OUTLIER_SIGMAS = 4.0

# Nor do steps further away than this, however far they usually are: pixels, a share of the radius for felt, and a
# share of what blur adds to their width.
OFF_PX, OFF_SHARE, OFF_OF_WIDTH = 1.0, 0.015, 0.6

# Of normal errors, 30 % are smaller than 0.385 standard deviations; more than half of the steps may be outliers.
RANK, RANK_SIGMAS = 0.3, 0.385

# A usual distance above the one, or a share of steps on the cone below the other, may be a fit to the wrong steps.
DOUBTFUL_PX = 0.3
DOUBTFUL_SHARE = 0.75

# Pieces of the limb, compared with each other to see how far the errors of neighbouring steps reach.
BLOCKS = 8

# Points of the outline from which its circle follows where the lens distorts.
OUTLINE_POINTS = 16

# Spokes cross the limb at up to 45 degrees, so steps are wider along them; this is the mean.
SQUARENESS = 1.11

# Width of a sharp step.
SHARP_PX = 2.6

# The standard deviation of a radius r is ``hypot(1.6 s, 0.01, 0.35 / r, (0.7 + u) e, 0.8 c)`` pixels. s is what the fit
# gives, with how far the errors of neighbouring steps reach taken from the frame itself; small balls suffer from what
# is behind them; felt, sharpening and a tone curve other than the assumed one move all steps alike, the more the more
# they scatter, e, and where a share u of the limb is not seen, a hand or what else hides it draws the rest to itself;
# colour that is stored more coarsely than brightness does so by 0.9 + u; and where looking by colour changed the radius
# by c, either may be wrong. Fitted to 3,700 rendered balls, with markings on floors and in hands, and plain ones on
# clutter under twenty troubles; the factors of e to 165 real ones, whose limbs err half as much again.
SIGMA_FACTOR = 1.6
SIGMA_FLOOR_PX = 0.01
SIGMA_SMALL_PX2 = 0.35
SIGMA_OF_SCATTER, SIGMA_OF_COARSE_CHROMA, SIGMA_OF_UNSEEN = 0.7, 0.9, 1.0
SIGMA_OF_CHANGE = 0.8


class Limb(Struct, frozen=True, kw_only=True, eq=False):
    """The limb of a ball."""

    cone: SphereCone  # the rays that touch the ball
    circle: ImageCircle  # the circle that comes nearest to the outline, as wide as its smaller diameter
    straight_radius_px: float  # that radius if the lens bent no lines
    points_px: Points  # the steps on it, shape ``(n, 2)``
    support: float  # the share of the spokes that have a step on it: how much of the limb is seen
    support_inside: float  # the same share of the spokes that do not leave the picture
    scatter_px: float  # standard deviation of these steps about it
    width_px: float  # how many pixels the steps take from inside to outside, the median, across the limb
    # Standard deviation of `straight_radius_px` if steps err by as much as they scatter, neighbouring ones alike as far
    # as is seen.
    sigma_px: float
    is_chroma_coarse: bool  # whether the camera stores colour more coarsely than brightness
    change_px: float = 0.0  # how far apart the radii of several looks are

    def is_doubtful(self, *, is_sure: bool = False) -> bool:
        """Check whether its steps may be those of a pattern, of the floor or of a hand.

        Args:
            is_sure: Whether it is beyond doubt a ball's.
        """
        usual_px = LOOK_SCATTER_PX + LOOK_SCATTER_OF_BLUR * max(0.0, self.width_px - SHARP_PX)
        return self.scatter_px > usual_px or self.support_inside < (LOOK_SUPPORT_OF_SURE if is_sure else LOOK_SUPPORT)

    @property
    def roughness(self) -> float:
        """Scatter of its steps, as a share of what is usual at most: 0 for a perfect outline."""
        usual_px = ROUGH_PX + ROUGH_SHARE * self.circle.radius_px
        return self.scatter_px / (usual_px + ROUGH_OF_BLUR * max(0.0, self.width_px - SHARP_PX))

    @property
    def worth(self) -> float:
        """Strength of its support: the share of the spokes with a step on it, less for those that lie beside it."""
        return self.support - WORTH_OF_ROUGH * self.roughness

    @property
    def radius_sigma_px(self) -> float:
        """Standard deviation of the radius."""
        of_scatter = SIGMA_OF_COARSE_CHROMA if self.is_chroma_coarse else SIGMA_OF_SCATTER
        return math.hypot(
            SIGMA_FACTOR * self.sigma_px,
            SIGMA_FLOOR_PX,
            SIGMA_SMALL_PX2 / self.circle.radius_px,
            (of_scatter + SIGMA_OF_UNSEEN * (1 - self.support_inside)) * self.scatter_px,
            SIGMA_OF_CHANGE * self.change_px,
        )


def find_limb(
    image: Image, circle: ImageCircle, within_px: float, lens: CameraModel, colours: BallColours | None = None
) -> Limb | None:
    """Fit the limb near an expected circle, then around where the fit put it; None with too few steps.

    Without colours it goes by brightness alone. Where that is doubtful, since steps scatter or too few are on one limb,
    `look_again.look_by_colour` may know better.
    """
    # Invariant: the result does not depend on where the search began. So the spokes are laid again around each fit
    # until the part of the picture that they cover holds the whole of every step.
    limb, reach_px = None, within_px + BEYOND_PX
    for looks in range(MAX_LOOKS):
        edges = limb_edges(image, circle, reach_px, within_px, lens, colours)
        found = None if edges is None else _fit_limb(edges, circle, lens)
        if edges is None or found is None:
            # Of a ball that the border cuts off, the oblong outline may be lost around the circle of its fit.
            break
        limb = found
        # How far the spokes that were read are now from where they should be, in place and radius together; a pixel to
        # spare.
        moved_px = math.hypot(limb.circle.x_px - circle.x_px, limb.circle.y_px - circle.y_px) + abs(
            limb.circle.radius_px - circle.radius_px
        )
        needed_px = _reach_px(edges, limb)
        # Nor are there more where a fit is rough and of little of a circle: it wanders among other edges, and looks a
        # little more like a limb by chance at one of many places.
        if moved_px + needed_px <= reach_px + 1.0 or (looks and limb.support_inside < WORTH_OF_ROUGH * limb.roughness):
            break
        circle, reach_px = limb.circle, min(max(needed_px + 1.0, MIN_REACH_PX), MAX_REACH_PX)
        within_px = min(reach_px, within(circle) + WITHIN_OF_WIDTH * limb.width_px)
    return limb


def near_px(limb: Limb) -> float:
    """Return the largest distance of steps from a limb that was fitted by colour."""
    felt_px = NEAR_SHARE * limb.circle.radius_px
    return NEAR_PX + felt_px + _oblong_px(limb) + WITHIN_OF_WIDTH * max(0.0, limb.width_px - SHARP_PX)


def within(circle: ImageCircle) -> float:
    """Return the largest distance of the limb from a circle that was fitted to it."""
    return WITHIN_PX + WITHIN_SHARE * circle.radius_px


def _reach_px(edges: LimbEdges, limb: Limb) -> float:
    """Return the distance to look from the limb to see its steps whole, on an outline that is no circle."""
    return min(REACH_SPARE_PX + REACH_OF_WIDTH * edges.wide_width_px + _oblong_px(limb), MAX_REACH_PX)


def _oblong_px(limb: Limb) -> float:
    """Return the reach of the outline, which is an ellipse away from the optical axis, beyond its circle."""
    # The ellipse's axes differ by the factor 1 / cos θ to first order, θ off the optical axis; z is cos θ.
    z = limb.cone.axis[2]
    return limb.circle.radius_px * (1 / z - 1) if z > 0 else 0.0


def _fit_limb(edges: LimbEdges, circle: ImageCircle, lens: CameraModel) -> Limb | None:
    count = edges.places.shape[1]
    if count < MIN_RAYS:
        return None
    frame = _cone_frame(edges, circle, lens)
    max_px = _max_miss_px(circle, edges)
    # Least squares first: with few outliers, reweighting finds them. Where too many steps miss the cone, least squares
    # may have settled between the limb and another edge; then the fit starts again from the circle of most votes.
    fit = _fit_robustly(frame, frame.fit(), lens, max_px)
    if fit is None or fit.usual_px > DOUBTFUL_PX or fit.steps < DOUBTFUL_SHARE * count:
        points = edges.points_px
        common = find_common_circle(points)
        if common is not None:
            # Weights of 1 near the circle of most votes and 0 elsewhere; 5 % of the radius allow for the ellipse off
            # the axis.
            near = np.abs(np.hypot(points[:, 0] - common.x_px, points[:, 1] - common.y_px) - common.radius_px)
            again = _fit_robustly(
                frame, frame.fit(np.where(near < 0.05 * common.radius_px + 1.0, 1.0, 0.0)), lens, max_px
            )
            fit = _pick_better(fit, again)
    return None if fit is None else _limb(fit, edges, lens)


def _cone_frame(edges: LimbEdges, circle: ImageCircle, lens: CameraModel) -> ConeFrame:
    """Return the rays to the steps, as seen along the one to the middle of the circle."""
    # Directions are x and y per unit of depth. Without distortion rays are linear in pixels, so the pixels go in as
    # they are and one small matrix takes them to the frame of the cone; with distortion each has to be undone first.
    towards = lens.direction(circle.x_px, circle.y_px)
    if lens.distortion:
        return ConeFrame(with_ones(lens.directions(edges.points_px)), towards)
    return ConeFrame(edges.places, towards, lens)


def _max_miss_px(circle: ImageCircle, edges: LimbEdges) -> float:
    """Return the largest distance that steps may have from the cone: felt and blur spread them."""
    return OFF_PX + OFF_SHARE * circle.radius_px + OFF_OF_WIDTH * max(0.0, edges.usual_width_px - 3.0)


class _ConeFit(NamedTuple):
    """A cone, how far outside it each step lies, which steps are on it, how many, and how far they usually are."""

    cone: SphereCone
    misses_px: Values
    on_it: Flags
    steps: int
    usual_px: float


def _fit_robustly(frame: ConeFrame, cone: SphereCone | None, lens: CameraModel, max_px: float) -> _ConeFit | None:
    """Fit a cone again with Tukey's weights, until what belongs to it is settled."""
    last_px = math.inf
    for _ in range(ROUNDS):
        if cone is None:
            return None
        misses = frame.misses(cone, _pixels_a_radian(cone, lens))
        # Iteratively reweighted least squares: the limit follows from the scatter of the last fit.
        usual, limit, furthest = _limits(misses, max_px)
        if limit > SETTLED_SHARE * last_px or furthest < MIN_OUTLIER_PX:
            break
        last_px = limit
        # Tukey's biweight: (1 - (miss / limit)²)², and nothing beyond the limit.
        weights = misses * (1 / limit)
        weights *= weights
        np.subtract(1.0, weights, out=weights)
        np.maximum(weights, 0.0, out=weights)
        weights *= weights
        cone = frame.fit(weights)
    if cone is None:
        return None
    on_it = np.abs(misses) < limit
    return _ConeFit(cone, misses, on_it, int(np.count_nonzero(on_it)), usual)


def _limits(misses: Values, max_px: float) -> tuple[float, float, float]:
    """Return the usual distance of steps from the cone, that from which on they are not of it, and the largest."""
    # Robust scale: the 30th percentile of |miss| in place of the median, so that more than half of the steps may lie
    # elsewhere; 0.385 makes it a standard deviation for normal errors.
    ordered = np.abs(misses)
    ordered.sort()
    usual = float(ordered[int(RANK * len(ordered))]) / RANK_SIGMAS
    return usual, min(max(OUTLIER_SIGMAS * usual, MIN_OUTLIER_PX), max_px), float(ordered[-1])


def _pick_better(one: _ConeFit | None, other: _ConeFit | None) -> _ConeFit | None:
    """Return the fit with more steps that lie closer to it."""
    if one is None or other is None:
        return one or other

    def worth(fit: _ConeFit) -> float:
        return float(np.maximum(1 - (fit.misses_px / 1.0) ** 2, 0.0).sum())

    return one if worth(one) >= worth(other) else other


def _pixels_a_radian(cone: SphereCone, lens: CameraModel) -> float:
    """Return the pixels that an angle across the cone takes in the picture: away from the optical axis more."""
    # An angle dα moves a place at θ off the axis by f dα / cos² θ radially and f dα / cos θ across: the geometric mean
    # is f / cos^1.5 θ. z below 0.1 (84 degrees off) is beyond any lens here.
    return math.sqrt(lens.fx_px * lens.fy_px) / math.pow(max(cone.axis[2], 0.1), 1.5)


def _limb(fit: _ConeFit, edges: LimbEdges, lens: CameraModel) -> Limb | None:
    steps, cone = fit.steps, fit.cone
    if steps < MIN_RAYS or not (math.isfinite(cone.half_across) and cone.axis[2] > 0.1):
        return None
    # Scatter with n - 3 degrees of freedom: the cone has three unknowns. Misses are in pixels, outside positive.
    misses = fit.misses_px.compress(fit.on_it)
    squared = float(misses.dot(misses))
    scatter = math.sqrt(squared / max(1, steps - 3))
    circle = _outline_circle(cone, lens)
    straight_radius_px = cone.half_across * math.sqrt(lens.fx_px * lens.fy_px)
    return Limb(
        cone=cone,
        circle=circle,
        straight_radius_px=straight_radius_px,
        points_px=edges.places[:2].compress(fit.on_it, axis=1).T,
        # Spokes beyond the border count in `support`, not in `support_inside`.
        support=steps / edges.spokes,
        support_inside=steps / edges.inside,
        scatter_px=scatter,
        width_px=edges.usual_width_px / SQUARENESS,
        # σ of the radius: `sine_share` is that of sin α for rays that err by one radian each on its own, so times the
        # radius (in pixels) and the scatter (in radians: pixels over pixels a radian), times the root of how much
        # neighbours err together. Residual over root n alone held 3 to 25 % of errors in its 95 % interval.
        sigma_px=cone.sine_share
        * straight_radius_px
        * scatter
        * math.sqrt(_correlation(misses, squared))
        / _pixels_a_radian(cone, lens),
        is_chroma_coarse=lens.chroma_pitch_px != (1, 1),
    )


def _correlation(misses: Values, squared: float) -> float:
    """Return the variance of the mean of the steps, as a multiple of that of independent ones; no less than 1.

    A finger, a stripe or the grain of a floor moves neighbouring steps the same way. So the sums over `BLOCKS` pieces
    of the limb vary more than those of independent steps would. Three of them are taken by the fit.
    """
    # Of B sums of independent steps, the fit of three unknowns takes three: E[Σ sum²] = Σ miss² (B - 3) / B.
    blocks = min(BLOCKS, len(misses) // 2)
    if blocks <= 3 or squared <= 0:
        return 1.0
    sums = np.add.reduceat(misses, _block_starts(len(misses), blocks))
    return max(1.0, float(sums.dot(sums)) / squared * blocks / (blocks - 3))


@lru_cache(maxsize=128)
def _block_starts(steps: int, blocks: int) -> Indices:
    return np.arange(blocks) * steps // blocks


def _outline_circle(cone: SphereCone, lens: CameraModel) -> ImageCircle:
    """Return the circle that comes nearest to the outline in the picture."""
    if not lens.distortion:
        x, y = cone.outline_centre
        return ImageCircle(
            x_px=x * lens.fx_px + lens.cx_px,
            y_px=y * lens.fy_px + lens.cy_px,
            radius_px=cone.half_across * math.sqrt(lens.fx_px * lens.fy_px),
        )
    x_px, y_px = lens.project(np.array([cone.outline_centre]))[0].tolist()
    # Distorted, the outline is no ellipse: the nearest of 16 points stands for the smaller half axis.
    points = lens.project(cone.outline(OUTLINE_POINTS))
    radius_px = float(np.hypot(points[:, 0] - x_px, points[:, 1] - y_px).min())
    return ImageCircle(x_px=x_px, y_px=y_px, radius_px=radius_px)
