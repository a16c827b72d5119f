"""The colours of a ball and those around it, learnt from the frame itself.

A ball may have stripes, the floor speckles, and its shadow an edge that is sharper than the ball's own. The limb is
none of these: it is where the colours of the ball end and those of its surroundings begin. So colours are counted well
inside a first circle and well outside of it. For each colour the logarithm of the ratio of both shares says which side
it belongs to, whatever either side consists of. Along a spoke, the sum of these logarithms up to a pixel, all that is
inside of it, is greatest at the limb: that is the likeliest place for the one change from ball to surroundings.

Which of the places that are likely is the limb is seen by the steepest step along the axis of colours that tells ball
and surroundings apart best: Fisher's linear discriminant. Along it, light and shade on the ball and the grain of the
floor vary little, so that the edge of a shadow is no step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from stadimeter.core.detection import Flags, Indices, Profiles
from stadimeter.core.frame import Image
from stadimeter.detectors.ball.blobs import ImageCircle

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
