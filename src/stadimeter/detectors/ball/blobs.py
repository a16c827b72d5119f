"""Blobs of a range of colours: where in a picture a ball may be.

Most of a picture is not the ball, so only every fourth pixel or so is looked at. Leaving out pixels, not averaging
them, costs a thirteenth of a proper reduction, and each pixel that is left keeps its colour. How large the ball is
comes later, from all pixels along its limb.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache, lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from msgspec import Struct

from stadimeter.core.detection import Flags, Indices, Points, Profiles
from stadimeter.core.frame import Image
from stadimeter.detectors.hsv import HsvRange, Mask
from stadimeter.detectors.sampling import Region

# Circles through points of which many do not belong to it -------------------------------------------------------------

# With half of the points on the circle, 64 triples miss it twice in ten thousand times.
TRIES = 64

# Steps of three sequences that fill a cube evenly: powers of the root of ``x⁴ = x + 1``.
EVENLY = 1 / 1.2207440846057596 ** np.arange(1, 4)


class ImageCircle(Struct, frozen=True, kw_only=True):
    """A circle in pixels."""

    x_px: float
    y_px: float
    radius_px: float


def find_common_circle(points_px: Points) -> ImageCircle | None:
    """Find the circle within a pixel of which most of the points lie; None if no three of them form one.

    Circles through three points each are tried. The same points always give the same circle.
    """
    circles = _circles_through_triples(points_px, TRIES)
    if not len(circles):
        return None
    across, down = points_px[:, 0] - circles[:, :1], points_px[:, 1] - circles[:, 1:2]
    # Each point votes with 1 - d², none beyond a pixel (RANSAC with a truncated square as its score, MSAC: P.
    # Torr and A. Zisserman, "MLESAC", 2000).
    apart = np.sqrt(across * across + down * down) - circles[:, 2:]
    score = np.maximum(1 - apart * apart, 0.0).sum(axis=1)
    x, y, radius = (float(value) for value in circles[int(np.argmax(score))])
    return ImageCircle(x_px=x, y_px=y, radius_px=radius)


def _circles_through_triples(points: Points, tries: int) -> Points:
    """Return the circles through triples of points as x, y, radius, shape ``(m, 3)``."""
    all_x, all_y = np.ascontiguousarray(points.T)
    picks = _picks(tries, len(points))
    (x, bx, cx), (y, by, cy) = all_x.take(picks), all_y.take(picks)
    # Circumcentre of the triangle in coordinates from its first corner. Twice its signed area is the determinant;
    # nearly zero for three points on a line, which form no circle.
    bx, cx, by, cy = bx - x, cx - x, by - y, cy - y
    twice_area = 2 * (bx * cy - by * cx)
    apart = np.abs(twice_area) > 1e-6
    twice_area = np.where(apart, twice_area, 1.0)
    b2, c2 = bx * bx + by * by, cx * cx + cy * cy
    to_x = (cy * b2 - by * c2) / twice_area
    to_y = (bx * c2 - cx * b2) / twice_area
    radius = np.sqrt(to_x * to_x + to_y * to_y)
    # Circles wider than the cloud of points are nearly straight lines through a few of them.
    size = max(float(all_x.max() - all_x.min()), float(all_y.max() - all_y.min()))
    circles = np.array([x + to_x, y + to_y, radius])
    return np.ascontiguousarray(circles.compress(apart & (radius > 1.0) & (radius < size), axis=1).T)


@lru_cache(maxsize=256)
def _picks(tries: int, points: int) -> Indices:
    """Return the indices of the points that each triple takes, shape ``(3, tries)``."""
    return np.ascontiguousarray((_spread(tries) * points).astype(np.intp).T)


@cache
def _spread(tries: int) -> Points:
    """Return triples of numbers from 0 to 1 that fill the cube evenly, shape ``(tries, 3)``.

    The additive recurrence of M. Roberts (2018); numpy's generators take 10 ms to load.
    """
    return np.outer(np.arange(1, tries + 1), EVENLY) % 1.0


# Pixels are left out only as long as the smallest accepted ball still has this radius in what remains.
MIN_SEARCHED_RADIUS_PX = 1.25

MAX_STEP = 8

# Number of blobs that are looked at: the largest.
MAX_BLOBS = 16


class Blob(Struct, frozen=True, kw_only=True, eq=False):
    """Pixels of the ball's colour that hang together."""

    circle: ImageCircle  # the circle around which its limb may be: as wide or as high as the blob, whichever is more
    contour: cv2.typing.MatLike  # its outline as OpenCV has it, in pixels of the thinned picture
    coloured_px2: float  # area of the pixels in its box that have the colour
    step: int  # every step-th pixel of the picture was looked at
    origin_px: tuple[int, int]  # where the thinned part begins in the picture, x and y

    @property
    def size_px(self) -> float:
        """The larger of its width and its height."""
        return 2 * self.circle.radius_px

    @property
    def fill(self) -> float:
        """The share of the circle around it that has the colour."""
        return self.coloured_px2 / (math.pi * self.circle.radius_px**2)

    @property
    def outline_px(self) -> Points:
        """Points along its outline, shape ``(n, 2)``."""
        return np.asarray(self.contour, np.float64).reshape(-1, 2) * self.step + self.origin_px


def search_step(min_radius_px: float) -> int:
    """Return the k of "every k-th pixel"."""
    return max(1, min(MAX_STEP, int(min_radius_px / MIN_SEARCHED_RADIUS_PX)))


def find_blobs(
    image: Image,
    colour: HsvRange,
    step: int,
    region: Region | None = None,
    *,
    without: Sequence[ImageCircle] = (),
    most: int = MAX_BLOBS,
) -> list[Blob]:
    """Find the largest blobs of a colour, the largest first; looks at every step-th pixel.

    Args:
        without: Balls that are known: what is within them, and a cell around, does not count.
        most: How many at most.
    """
    region = region or Region.whole(image)
    # Nearest-neighbour thinning first, HSV after: at a quarter of 640x480 both take 0.08 ms, HSV of all pixels 0.5 ms
    # (x86).
    mask = colour.mask(thin_out(region.of(image), step))
    for each in without:
        centre = (round((each.x_px - region.left) / step), round((each.y_px - region.top) / step))
        cv2.circle(mask, centre, math.ceil(each.radius_px / step) + 1, 0, cv2.FILLED)
    # Contours, not connected components with statistics, which take 26 times as long on such a mask.
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if len(contours) > most:
        # Of texture, blobs are wide but thin; that of a ball is solid.
        contours = sorted(contours, key=cv2.contourArea, reverse=True)[:most]
    boxed = [(contour, cv2.boundingRect(contour)) for contour in contours]
    boxed.sort(key=lambda pair: (-max(pair[1][2:]), pair[1]))
    return [_make_blob(contour, box, mask, step, (region.left, region.top)) for contour, box in boxed]


def thin_out(image: Image, step: int) -> Image:
    """Return every k-th pixel of every k-th row."""
    if step == 1:
        return image
    height, width = image.shape[:2]
    # OpenCV's nearest neighbour takes the first pixel of each cell, and is four times as fast as slicing and copying.
    whole = image[: height - height % step or height, : width - width % step or width]
    size = (max(1, width // step), max(1, height // step))
    return np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_NEAREST), np.uint8)


def _make_blob(
    contour: cv2.typing.MatLike, box: cv2.typing.Rect, mask: Mask, step: int, origin_px: tuple[int, int]
) -> Blob:
    (x, y, width, height), (left, top) = box, origin_px
    # The pixel that was looked at is the first of its cell; the blob reaches half a cell beyond it on average.
    circle = ImageCircle(
        x_px=left + (x + (width - 1) / 2) * step,
        y_px=top + (y + (height - 1) / 2) * step,
        radius_px=max(width, height) * step / 2,
    )
    coloured = cv2.countNonZero(mask[y : y + height, x : x + width])
    return Blob(circle=circle, contour=contour, coloured_px2=coloured * step**2, step=step, origin_px=origin_px)


# The colours of a ball and those around it, learnt from the frame itself.
#
# A ball may have stripes, the floor speckles, and its shadow an edge that is sharper than the ball's own. The limb is
# none of these: it is where the colours of the ball end and those of its surroundings begin. So colours are counted
# well inside a first circle and well outside of it. For each colour the logarithm of the ratio of both shares says
# which side it belongs to, whatever either side consists of. Along a spoke, the sum of these logarithms up to a
# pixel, all that is inside of it, is greatest at the limb: that is the likeliest place for the one change from ball
# to surroundings.
#
# Which of the places that are likely is the limb is seen by the steepest step along the axis of colours that tells
# ball and surroundings apart best: Fisher's linear discriminant. Along it, light and shade on the ball and the grain
# of the floor vary little, so that the edge of a shadow is no step.

# Pixels each way from which the colours are counted.
GRID = 32

# Half the side of the square that is counted: a multiple of the radius, and pixels.
REACH_SHARE, REACH_PX = 1.5, 3.0

# Pixels this near to the circle are not counted: a share of the radius, or pixels if that is more. The first circle
# may be wrong by this much, and pixels on the limb are a mixture.
INSIDE_SHARE, INSIDE_PX = 0.12, 1.2
OUTSIDE_SHARE, OUTSIDE_PX = 0.15, 2.0

# Fewer pixels on either side tell no colours.
MIN_COUNTED = 8

# Colours are told apart by the highest bits of each channel.
BITS = 4
BINS = 1 << BITS

# Each count, and half of those of either neighbour.
SPREAD = np.eye(BINS, dtype=np.float32) + 0.5 * (np.eye(BINS, k=1) + np.eye(BINS, k=-1)).astype(np.float32)

# A share of pixels that counts as chance, added to both sides of the ratio.
RARE_SHARE = 0.02

# No pixel says more than this for either side: speckles and scratches are a few pixels.
MAX_ODDS = 1.0

# A place on a spoke whose sum is lower than the greatest by more than this is not the limb.
PLAUSIBLE_ODDS = 2.0

# Variance of each channel that is added to that of the colours, in squared levels: noise, and that few were seen.
SPREAD_OF_NOISE = 30.0

PLACES = np.array([BINS * BINS, BINS, 1], np.intp)


class BallColours(NamedTuple):
    """Colours that distinguish a ball from its surroundings."""

    # How much each colour speaks for the ball, negative for what is around it: logarithms by the index of `_bins`,
    # shape ``(4096,)``.
    odds: Profiles
    axis: Profiles  # the direction from the colours around it to those of the ball, of length 1, shape ``(3,)``


def learn_colours(image: Image, circle: ImageCircle) -> BallColours | None:
    """Learn the colours of the ball inside a circle and of what is around it; None from too few pixels."""
    # A square of 1.5 radii each way, thinned to 32 by 32 pixels whatever its size: of a large ball about
    # 280 pixels inside and 550 outside, at a cost that does not grow with the ball.
    half_px = REACH_SHARE * circle.radius_px + REACH_PX
    left, top = max(int(circle.x_px - half_px), 0), max(int(circle.y_px - half_px), 0)
    part = image[top : max(int(circle.y_px + half_px) + 1, 0), left : max(int(circle.x_px + half_px) + 1, 0)]
    if part.size == 0:
        return None
    height, width = part.shape[:2]
    pixels = np.asarray(cv2.resize(part, (GRID, GRID), interpolation=cv2.INTER_NEAREST), np.uint8)
    cells = np.arange(GRID)
    x, y = left + cells * width // GRID - circle.x_px, top + cells * height // GRID - circle.y_px
    # Distance of each grid point from the centre in pixels of the picture; both sides leave out a ring around the
    # circle.
    apart = np.sqrt(np.add.outer(y * y, x * x))
    inside = pixels[apart < circle.radius_px - max(INSIDE_SHARE * circle.radius_px, INSIDE_PX)]
    outside = pixels[apart > circle.radius_px + max(OUTSIDE_SHARE * circle.radius_px, OUTSIDE_PX)]
    if min(len(inside), len(outside)) < MIN_COUNTED:
        return None
    return BallColours(_odds(inside, outside), separate(inside.astype(np.float32), outside.astype(np.float32))[0])


def _odds(inside: Image, outside: Image) -> Profiles:
    # Histograms over 16³ colours, as shares. Smoothing by (1/2, 1, 1/2) along each channel stands for noise and
    # shading; the added 2 % keeps a colour that was seen once from being certain.
    shares = np.stack([np.bincount(_bins(each), minlength=BINS**3) / len(each) for each in (inside, outside)])
    ball, around = _smooth(shares.astype(np.float32)) + RARE_SHARE
    return np.asarray(np.clip(np.log(ball / around), -MAX_ODDS, MAX_ODDS), np.float32)


def separate(inside: Profiles, outside: Profiles) -> tuple[Profiles, float]:
    """Return the direction along which the colours of both, shape ``(n, 3)``, are furthest apart, and how far.

    Returns:
        The direction, of length 1, and the distance of the means in standard deviations.
    """
    # Fisher's discriminant: (covariance within)⁻¹ times the difference of the means (R. Fisher, 1936). The added
    # variance of 30 squared levels (5.5 levels) keeps the solution stable on plain surfaces.
    how = cv2.COVAR_NORMAL | cv2.COVAR_ROWS | cv2.COVAR_SCALE
    (ball, ball_mean), (around, around_mean) = (
        cv2.calcCovarMatrix(each, np.empty(0), how) for each in (inside, outside)
    )
    spread, apart = SPREAD_OF_NOISE * np.eye(3) + (ball + around) / 2, (ball_mean - around_mean)[0]
    axis = np.linalg.solve(spread, apart)
    return np.asarray(axis / max(float(np.sqrt(axis.dot(axis))), 1e-9), np.float32), math.sqrt(
        max(apart.dot(axis), 0.0)
    )


def likely_drop(codes: Image, colours: BallColours) -> Profiles:
    """Return the fall of each spoke's colour from the ball's to others, from the pixel before to the one after.

    Returns:
        Levels of 8 bits along the axis, shape ``(n, k - 2)`` for ``(n, k, 3)``; 0 where it does not fall and where the
        limb cannot be by `find_plausible`.
    """
    # Projected on that axis each pixel is one number, larger for the ball's colours. The drop spans two pixels, as a
    # step of a sharp picture does.
    along = codes.astype(np.float32).dot(colours.axis)
    drop = np.maximum(along[:, :-2] - along[:, 2:], 0)
    return np.asarray(drop * find_plausible(codes, colours.odds)[:, 1:-1])


def find_plausible(codes: Image, odds: Profiles) -> Flags:
    """Return where on each spoke the limb may be by the colours on either side, shape ``(n, k)`` for ``(n, k, 3)``.

    Where colours say nothing, since ball and surroundings look alike, that is everywhere.
    """
    # Log-likelihood ratio of a change point: with independent pixels, the sum of the odds up to a place is the
    # logarithm of how likely the change is there, but for a constant. Within 2 of the best is within a factor of e² =
    # 7.4.
    each = odds.take(_bins(codes))
    # Half of the pixel itself is inside.
    sums = np.cumsum(each, axis=1) - 0.5 * each
    return np.asarray(sums >= sums.max(axis=1, keepdims=True) - PLAUSIBLE_ODDS)


def _bins(codes: Image) -> Indices:
    # Exact in floating point; numpy's product with a matrix of two axes is much faster than any other.
    highest = (codes >> (8 - BITS)).astype(np.float32).reshape(-1, 3)
    return np.asarray(highest.dot(PLACES.astype(np.float32)).astype(np.intp).reshape(codes.shape[:-1]))


def _smooth(shares: Profiles) -> Profiles:
    """Spread the counts of each colour to its neighbours: light and noise move colours by more than a bin."""
    blue = SPREAD @ shares.reshape(-1, BINS, BINS * BINS)
    green = SPREAD @ blue.reshape(-1, BINS, BINS)
    return np.asarray((green.reshape(-1, BINS) @ SPREAD).reshape(shares.shape))
