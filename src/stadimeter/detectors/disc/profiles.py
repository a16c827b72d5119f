"""Light along lines across an ellipse, and where on them the edge is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.core.frame import Image
from stadimeter.detectors.disc.ellipse import Bend, Rim, Values
from stadimeter.detectors.sampling import Light, quantile

Profiles = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Shares of blue, green and red in the light (ITU-R BT.709). Channels are decoded one by one and added as light: the
# luma of a pixel that is half white and half blue stands for too much of it.
LUMINANCE = np.array((0.0722, 0.7152, 0.2126), np.float32)

# Spacing of the samples on a line; on long lines more, so that there are no more than 17 of them.
STEP_PX = 0.5
MAX_STEPS = 8

# The blur that the reach follows from: that many edges are sharper. What moves is blurred on two sides only.
WIDE_BLUR_QUANTILE = 0.85

# The standard deviation of a distribution in units of its mean absolute value: 1.25 if it is normal, as that of a
# sharp lens, 1.18 out of focus, 1.15 for a straight motion.
SHARP_SPREAD_PX, WIDE_SPREAD_PX = 0.75, 1.75
SIGMA_OF_SHARP, SIGMA_OF_WIDE = 1.25, 1.17

# The standard deviation of a normal distribution, times its greatest value.
SIGMA_OF_STEEPNESS = 1 / math.sqrt(2 * math.pi)

# An edge that seems more times as blurred as usual has something beside it.
MAX_BLUR_FACTOR = 3.0

# Least change of the light from one sample to the next at the edge, as a share of that from inside to outside.
MIN_RISE = 0.02

# Lines over which the median of the light inside is taken.
MIN_LIGHT = 1e-4
LEVEL_LINES = 9


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EdgePicture:
    """A picture in which edges are looked for."""

    image: Image  # the picture, 2 pixels each way at least
    light: Light
    bend: Bend | None = None  # how the lens bends outlines; None if it does not

    def read(self, points_px: Points) -> tuple[Values, Mask]:
        """Return the light at undistorted places, ``(..., 2)``, bilinearly, and whether each is inside the picture."""
        height, width = self.image.shape[:2]
        places = points_px if self.bend is None else self.bend(points_px)
        x, y = places[..., 0], places[..., 1]
        inside = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
        x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
        left, top = np.minimum(x.astype(np.intp), width - 2), np.minimum(y.astype(np.intp), height - 2)
        right, below = x - left, y - top
        # Bilinear: the four neighbours of every place in one gather, shape (4, …, 3), decoded to light and weighted to
        # luminance before they are mixed, since light adds up and code values do not.
        first = top * width + left
        neighbours = np.array((first, first + 1, first + width, first + width + 1))
        light = self.light.take(self.image.reshape(-1, 3).take(neighbours, axis=0)) @ LUMINANCE
        upper = light[0] * (1 - right) + light[1] * right
        lower = light[2] * (1 - right) + light[3] * right
        return upper * (1 - below) + lower * below, inside


class Steps(NamedTuple):
    """Edges on n lines."""

    off_px: Values  # how far outside the ellipse the edge is, shape ``(n,)``
    is_edge: Mask  # whether there is one
    visible: Mask  # whether all of the line is inside the picture
    contrast: Values  # how much more light comes from inside; of a dark disc, how much less
    inside: Values  # the light inside; of a dark disc, below zero
    blur_px: Values  # how blurred the edge is: the standard deviation of a distribution
    edge_px: float  # the median of that
    widest_px: float  # the blur that nearly all edges are below


def read_steps(picture: EdgePicture, rim: Rim, reach_px: float, *, is_bright: bool, is_first: bool) -> Steps:
    """Find the edges of a disc on lines that cross an ellipse and reach equally far to both sides.

    At the first look the steepest place is taken, since both ends of the line may be anywhere, instead of that half way
    from inside to outside.
    """
    # Samples from -reach to +reach, 17 at most, outwards positive, in pixels without distortion.
    half = min(MAX_STEPS, math.ceil(reach_px / STEP_PX))
    along: Values = np.arange(-half, half + 1, dtype=np.float64) * (reach_px / half)
    light, is_inside = picture.read(rim.points_px[:, None, :] + along[None, :, None] * rim.outward[:, None, :])
    visible: Mask = np.asarray(is_inside.all(axis=1), np.bool_)
    bright = light if is_bright else -light
    return (_find_steepest if is_first else _find_half_way)(bright, visible, along)


def _find_steepest(bright: Profiles, visible: Mask, along: Values) -> Steps:
    # Central differences, outwards; a dark disc has its sign turned, so that its edge falls as well.
    fall = bright[:, :-2] - bright[:, 2:]
    best = np.argmax(fall, axis=1)
    height = fall[np.arange(len(fall)), best]
    contrast = bright.max(axis=1) - bright.min(axis=1)
    usual = quantile(height[visible]) if visible.any() else 0.0
    is_edge = visible & (height > max(MIN_LIGHT, usual / 4))
    # Contrast over steepest fall is the width of the step in samples two apart; the density of a normal distribution
    # has its peak at 1 / (σ √2π).
    steps_wide = quantile(contrast[is_edge] / height[is_edge]) if is_edge.any() else 0.0
    return Steps(
        off_px=along[best + 1],
        is_edge=is_edge,
        visible=visible,
        contrast=contrast,
        inside=bright[:, 0],
        blur_px=np.zeros(len(bright)),
        edge_px=0.0,
        widest_px=SIGMA_OF_STEEPNESS * 2 * float(along[1] - along[0]) * steps_wide,
    )


def _find_half_way(bright: Profiles, visible: Mask, along: Values) -> Steps:
    lines = np.arange(len(bright))
    # Levels are the means of the two samples at either end of the line; inside the median of nine lines is taken, since
    # print and gloss lie there, outside each line's own, since what is behind the disc changes.
    inside = _smooth((bright[:, 0] + bright[:, 1]) / 2)
    outside = (bright[:, -1] + bright[:, -2]) / 2
    contrast = inside - outside
    safe = np.where(contrast > MIN_LIGHT, contrast, np.inf)
    # -1/2 outside to 1/2 inside, 0 half way; the steepest passage through 0 is the edge, placed by linear
    # interpolation.
    share = (bright - ((inside + outside) / 2)[:, None]) / safe[:, None]
    before, after = share[:, :-1], share[:, 1:]
    fall = (before - after) * ((before > 0) & (after <= 0))
    best = np.argmax(fall, axis=1)
    height = fall[lines, best]
    is_edge = visible & (height > MIN_RISE)
    step_px = along[1] - along[0]
    off = along[best] + step_px * before[lines, best] / np.where(is_edge, height, 1.0)
    # The mean distance of the light from an ideal step is the mean absolute deviation of the blur, whatever its shape.
    towards = np.where(along < off[:, None], 1.0, -1.0)
    blur = _deviation_px(step_px * (0.5 - share * towards).sum(axis=1))
    seen = blur[is_edge] if is_edge.any() else np.ones(1)
    usual_px = max(quantile(seen), 0.0)
    return Steps(
        off_px=off,
        is_edge=is_edge,
        visible=visible,
        contrast=contrast,
        inside=inside,
        blur_px=np.clip(blur, 0.0, MAX_BLUR_FACTOR * usual_px),
        edge_px=usual_px,
        widest_px=max(quantile(seen, WIDE_BLUR_QUANTILE), 0.0),
    )


def _deviation_px(spread_px: Values) -> Values:
    """Return the standard deviation of blurs from their mean absolute value."""
    # Between a sharp lens and one out of focus the factor goes over linearly.
    wide = np.clip((spread_px - SHARP_SPREAD_PX) / (WIDE_SPREAD_PX - SHARP_SPREAD_PX), 0.0, 1.0)
    return np.asarray(spread_px * (SIGMA_OF_SHARP + (SIGMA_OF_WIDE - SIGMA_OF_SHARP) * wide))


def _smooth(values: Values) -> Values:
    """Return the median of each value and its neighbours, around the outline."""
    side = LEVEL_LINES // 2
    around = np.concatenate((values[-side:], values, values[:side]))
    neighbours = np.lib.stride_tricks.sliding_window_view(around, LEVEL_LINES)
    return np.asarray(np.partition(neighbours, side, axis=1)[:, side])
