"""How far the blocks of the picture have moved: cheap, and not fooled by noise or by a clock that is drawn over it.

The picture is reduced to 160 pixels across and divided into blocks. Of each block two things are estimated, and both
from products of two different pictures, so that noise, which is new in each, has no part in their mean:

* Change: with pictures ``a`` (now), ``b`` (the one before), ``c`` (of a while ago) and ``d`` (the one before that), the
  mean of ``(a - c) * (b - d)``. If the view stands still, both differences are nothing but noise, of four different
  pictures: the mean is 0, however strong the noise. If it moves, both hold the same change.
* Texture: the mean of the products of the gradients of ``a`` and ``b`` across the picture.

A small shift by ``s`` pixels changes a grey level by ``s`` times the gradient (B. Lucas and T. Kanade, "An iterative
image registration technique", 1981), so change divided by texture is the square of the shift. Larger shifts come out
too small, but not below a pixel or so: enough to tell moving from standing. Both count for as long as the view moves
little from one picture to the next; a coarser look, with four times the pixels' size, is for fast turns.

The median over the blocks is what counts. A clock or a name that is drawn over the picture, the target itself and the
place towards which the robot drives are a minority; the upper and lower edge, where overlays are, is left out.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame
from stadimeter.core.picture_flow import FlowSince, PictureFlow

Plane = NDArray[np.float32]

REDUCED_WIDTH_PX = 160
BLOCK_PX = 16

# The upper and the lower tenth of the picture hold clocks and names, and are not looked at.
EDGE_SHARE = 0.1

# How much coarser the look for fast turns is, and its blocks in its own pixels.
COARSER = 4
COARSE_BLOCK_PX = BLOCK_PX // COARSER

# Ages of the earlier pictures, in seconds, for the fine and for the coarse look. A robot at 0.3 m/s is seen to move
# after the shortest, one at 0.1 m/s after the second, one that creeps after the longest.
FINE_AGES_S = (0.12, 0.3, 1.0)
COARSE_AGE_S = 0.1

# A block has texture if the mean square of its gradient is this, in grey levels of 255 per reduced pixel: a plain wall
# with sensor noise of 2 grey levels has less than 0.1, a room with furniture 10 to 500.
MIN_GRADIENT2 = 2.0

# With fewer blocks a median means nothing.
MIN_BLOCKS = 8

# 1.2533 · 1.4826: the standard deviation of a median, from the median absolute deviation of normal values.
MEDIAN_SIGMA_PER_MAD = 1.858

# Pictures that are remembered: 1.0 s at 60 Hz.
REMEMBERED_MAX = 64


class _Reduced(NamedTuple):
    at_s: float
    fine: Plane
    coarse: Plane


class FlowMeter:
    """Measures the flow of the pictures of one run."""

    def __init__(self) -> None:
        self._before: deque[_Reduced] = deque(maxlen=REMEMBERED_MAX)

    def measure(self, frame: Frame, lens: CameraModel) -> PictureFlow:
        """Return how far a picture has moved since earlier ones, and remember it.

        Args:
            lens: The camera model at the frame's resolution.
        """
        now = _Reduced(frame.captured_at_s, *_reduce(frame))
        earlier = self._before
        if earlier and (earlier[-1].fine.shape != now.fine.shape or earlier[-1].at_s >= now.at_s):
            earlier.clear()
        scale = REDUCED_WIDTH_PX / frame.width_px
        focal_px, centre_px = lens.fx_px * scale, lens.cx_px * scale
        if not earlier:
            gradient2 = _block_means(_gradient(now.fine) ** 2, BLOCK_PX)
            earlier.append(now)
            return PictureFlow(textured=float((gradient2 >= MIN_GRADIENT2).mean()))
        fine = _Texture.of(now.fine, earlier[-1].fine, BLOCK_PX, centre_px)
        coarse = _Texture.of(now.coarse, earlier[-1].coarse, COARSE_BLOCK_PX, centre_px / COARSER)
        # The earlier picture must differ from both newest ones, and have one before it.
        pairs = [(then, before) for before, then in zip(earlier, list(earlier)[1:-1], strict=False)]
        since = []
        for age_s in FINE_AGES_S:
            if pair := _pair_of_age(pairs, now.at_s, age_s):
                change = _change(now.fine, earlier[-1].fine, pair[0].fine, pair[1].fine, BLOCK_PX)
                since.append(fine.flow(change, pair[0].at_s, now.at_s - earlier[-1].at_s, focal_px))
        if pair := _pair_of_age(pairs, now.at_s, COARSE_AGE_S):
            change = _change(now.coarse, earlier[-1].coarse, pair[0].coarse, pair[1].coarse, COARSE_BLOCK_PX)
            since.append(coarse.flow(change, pair[0].at_s, now.at_s - earlier[-1].at_s, focal_px / COARSER))
        earlier.append(now)
        return PictureFlow(textured=fine.share, since=tuple([flow for flow in since if flow is not None]))


class _Texture(NamedTuple):
    """Which blocks have texture: the mean square of their gradient, where they are, and their share."""

    is_textured: NDArray[np.bool_]
    gradient2: Plane
    aside_px: float
    share: float

    @classmethod
    def of(cls, now: Plane, before: Plane, block_px: int, centre_px: float) -> _Texture:
        gradient2 = _block_means(_gradient(now) * _gradient(before), block_px)
        is_textured = gradient2 >= MIN_GRADIENT2
        from_axis_px = np.abs((np.arange(gradient2.shape[1]) + 0.5) * block_px - 0.5 - centre_px)
        _, columns = np.nonzero(is_textured)
        aside_px = _median(from_axis_px[columns]) if len(columns) else 0.0
        return cls(is_textured, gradient2, aside_px, float(is_textured.mean()))

    def flow(self, change: Plane, since_s: float, step_s: float, focal_px: float) -> FlowSince | None:
        """Return the flow that a change means; None if there is too little texture to tell."""
        blocks = int(self.is_textured.sum())
        if blocks < MIN_BLOCKS:
            return None
        shift2 = change[self.is_textured] / self.gradient2[self.is_textured]
        median = _median(shift2)
        mad = _median(np.abs(shift2 - median))
        return FlowSince(
            since_s=since_s,
            step_s=step_s,
            focal_px=focal_px,
            aside_px=self.aside_px,
            blocks=blocks,
            shift2_px2=median,
            sigma_px2=MEDIAN_SIGMA_PER_MAD * mad / blocks**0.5,
        )


def _reduce(frame: Frame) -> tuple[Plane, Plane]:
    """Return a frame's green channel, reduced by averaging, without its upper and lower edge; and the same coarser."""
    green = cv2.extractChannel(frame.image, 1)
    height_px = max(1, round(frame.height_px * REDUCED_WIDTH_PX / frame.width_px))
    small = cv2.resize(green, (REDUCED_WIDTH_PX, height_px), interpolation=cv2.INTER_AREA)
    edge_px = round(EDGE_SHARE * height_px)
    rows = (height_px - 2 * edge_px) // BLOCK_PX * BLOCK_PX
    fine = small[edge_px : edge_px + rows].astype(np.float32)
    coarse = cv2.resize(fine, (REDUCED_WIDTH_PX // COARSER, rows // COARSER), interpolation=cv2.INTER_AREA)
    return fine, np.asarray(coarse, np.float32)


def _pair_of_age(
    pairs: list[tuple[_Reduced, _Reduced]], now_s: float, age_s: float
) -> tuple[_Reduced, _Reduced] | None:
    """Return the newest picture that is as old as this at least, and the one before it; None if there is none."""
    return next((pair for pair in reversed(pairs) if now_s - pair[0].at_s >= age_s - 1e-6), None)


def _change(now: Plane, before: Plane, then: Plane, before_then: Plane, block_px: int) -> Plane:
    """Return for each block the mean of the product of two differences, whose own means (exposure) are taken off."""
    one, other = now - then, before - before_then
    mean = _block_means(one, block_px) * _block_means(other, block_px)
    return _block_means(one * other, block_px) - mean


def _median(values: NDArray[np.floating]) -> float:
    """Return the median of a few values, in a tenth of numpy's time."""
    ordered = np.sort(values)
    return float(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2


def _gradient(plane: Plane) -> Plane:
    """Return half the difference of the neighbours to the right and to the left."""
    return np.asarray(cv2.filter2D(plane, cv2.CV_32F, np.array([[-0.5, 0.0, 0.5]], np.float32)), np.float32)


def _block_means(plane: Plane, block_px: int) -> Plane:
    size = (plane.shape[1] // block_px, plane.shape[0] // block_px)
    return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_AREA), np.float32)
