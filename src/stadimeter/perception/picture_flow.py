"""Motion of the blocks of the picture: cheap, and not fooled by noise or by a clock that is drawn over it.

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

In the same way the newest picture is compared with those of the last `REMEMBERED_S` that look most like it: one of
them that stands still beside it, in three of four blocks, has come again, whatever is drawn, added or encoded anew.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame, Image
from stadimeter.core.observation import FlowSince, PictureFlow

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

# Pictures are remembered for this long, so that a cycle of up to 20 s is noticed, but no more than so many: they take
# 12 MB, and are those of 25 s at 30 Hz.
REMEMBERED_S = 25.0
REMEMBERED_MAX = 750

# Of the pictures that are older than this, the one that looks most like the newest is compared with it.
AGAIN_AGE_S = 0.5

# Such a look is taken at one picture of so many, in place of that of 1 s ago; one that slides, which costs more, at
# fewer.
AGAIN_EVERY, SLID_EVERY = 2, 4

# A picture of this age is also compared after it was slid over the newest: one that is scrolled shows no drive.
SLID_AGE_S = 1.0

# Pictures of which less than this share overlaps are not slid.
MIN_OVERLAP = 0.5

# Pictures look alike by the brightness of so many cells; to compare 750 takes 0.05 ms.
CELLS = (20, 12)

# Of those that are alike to this, as a correlation, the oldest is taken: the robot is the furthest from there.
ALIKE = 0.001

# A picture has come again if this share of the blocks with texture is where it was. A clock and the target are less
# than the rest; a floor of equal tiles that has moved on by one is less than the floor and the walls around it.
AGAIN_SHARE = 0.75


class _Memory:
    """The reduced pictures of the last `REMEMBERED_S`, in a ring; they are counted from 0."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.shape = shape
        self.count = 0
        self._at_s = self._ages_s = np.full(REMEMBERED_MAX, np.inf)
        self._planes = np.empty((REMEMBERED_MAX, *shape), np.uint8)
        self._cells = np.zeros((REMEMBERED_MAX, CELLS[0] * CELLS[1]), np.float32)

    def add(self, plane: Image, at_s: float) -> None:
        place = self.count % REMEMBERED_MAX
        self._at_s[place], self._planes[place] = at_s, plane
        cells = cv2.resize(plane, CELLS, interpolation=cv2.INTER_AREA).astype(np.float32).ravel()
        cells -= cells.mean()
        self._cells[place] = cells / max(1.0, float(cells @ cells) ** 0.5)
        self.count += 1
        # An earlier picture must differ from both newest ones, and have one before it.
        self._ages_s = at_s - self._at_s
        for number in (self.count - 1, self.count - 2, max(0, self.count - REMEMBERED_MAX)):
            self._ages_s[number % REMEMBERED_MAX] = -1.0

    def at_s(self, number: int) -> float:
        """Return when a picture was taken."""
        return float(self._at_s[number % REMEMBERED_MAX])

    def plane(self, number: int) -> Plane:
        """Return a picture."""
        return np.asarray(self._planes[number % REMEMBERED_MAX], np.float32)

    def of_age(self, age_s: float) -> int | None:
        """Return the newest picture that is as old as this at least; None if there is none."""
        ages = np.where(self._ages_s >= age_s - 1e-6, self._ages_s, np.inf)
        place = int(ages.argmin())
        return self._number(place) if np.isfinite(ages[place]) else None

    def alike(self) -> int | None:
        """Return the picture older than `AGAIN_AGE_S` that looks most like the newest; None if there is none."""
        is_old = (self._ages_s >= AGAIN_AGE_S) & (self._ages_s < REMEMBERED_S)
        if not is_old.any():
            return None
        likeness = np.where(is_old, self._cells @ self._cells[(self.count - 1) % REMEMBERED_MAX], -1.0)
        return self._number(int(np.where(likeness >= likeness.max() - ALIKE, self._ages_s, -1.0).argmax()))

    def _number(self, place: int) -> int:
        newest = self.count - 1
        return newest - (newest - place) % REMEMBERED_MAX


class FlowMeter:
    """Measures the flow of the pictures of one run."""

    def __init__(self) -> None:
        self._memory: _Memory | None = None

    def measure(self, frame: Frame, lens: CameraModel) -> PictureFlow:
        """Measure how far a picture has moved since earlier ones, and remember it.

        Args:
            lens: The camera model at the frame's resolution.
        """
        plane, at_s, memory = _reduce(frame), frame.captured_at_s, self._memory
        if memory is None or memory.shape != plane.shape or memory.at_s(memory.count - 1) >= at_s:
            memory = self._memory = _Memory((plane.shape[0], plane.shape[1]))
        memory.add(plane, at_s)
        newest = memory.count - 1
        now = plane.astype(np.float32)
        if not newest:
            gradient2 = _block_means(_gradient(now) ** 2, BLOCK_PX)
            return PictureFlow(textured=float((gradient2 >= MIN_GRADIENT2).mean()))
        scale = REDUCED_WIDTH_PX / frame.width_px
        before = memory.plane(newest - 1)
        fine = _Look.of(now, before, BLOCK_PX, lens, scale)
        coarse = _Look.of(_coarser(now), _coarser(before), COARSE_BLOCK_PX, lens, scale / COARSER)
        is_again, is_slid = newest % AGAIN_EVERY == 0, newest % SLID_EVERY == 1
        ages_s = FINE_AGES_S[:-1] if is_again else FINE_AGES_S
        looks = [*((fine, age_s) for age_s in ages_s), (coarse, COARSE_AGE_S)]
        since = [look.flow(memory, number) for look, age_s in looks if (number := memory.of_age(age_s)) is not None]
        again = []
        if is_again and (number := memory.alike()) is not None:
            again = [fine.flow(memory, number, AGAIN_SHARE)]
        elif is_slid and (number := memory.of_age(SLID_AGE_S)) is not None:
            again = [fine.flow(memory, number, AGAIN_SHARE, is_slid=True)]
        return PictureFlow(textured=fine.share, since=_told(since), again=_told(again))


class _Look(NamedTuple):
    """The two newest pictures, and which of their blocks have texture.

    Attributes:
        gradient2: The mean square of the gradient of the blocks.
        aside_px: How far those with texture are from the optical axis sideways, as a median.
        share: How many of the blocks have texture.
    """

    now: Plane
    before: Plane
    is_textured: NDArray[np.bool_]
    gradient2: Plane
    aside_px: float
    focal_px: float
    share: float

    @classmethod
    def of(cls, now: Plane, before: Plane, block_px: int, lens: CameraModel, scale: float) -> _Look:
        gradient2 = _block_means(_gradient(now) * _gradient(before), block_px)
        is_textured = gradient2 >= MIN_GRADIENT2
        from_axis_px = np.abs((np.arange(gradient2.shape[1]) + 0.5) * block_px - 0.5 - lens.cx_px * scale)
        _, columns = np.nonzero(is_textured)
        aside_px = _middle(np.sort(from_axis_px[columns])) if len(columns) else 0.0
        share = len(columns) / is_textured.size
        return cls(now, before, is_textured, gradient2, aside_px, lens.fx_px * scale, share)

    def flow(self, memory: _Memory, number: int, share: float = 0.5, *, is_slid: bool = False) -> FlowSince | None:
        """Return the flow since a picture of the memory; None if there is too little texture to tell.

        Args:
            share: How many of the blocks with texture have flowed by this at most: half of them for a median.
            is_slid: Whether to slide the earlier picture over this one first: what is left is no turn of the camera.
        """
        then, before_then = memory.plane(number), memory.plane(number - 1)
        if then.shape != self.now.shape:
            then, before_then = _coarser(then), _coarser(before_then)
        counts, aside_px = self.is_textured, self.aside_px
        if is_slid:
            slide = _slide(then, self.now)
            then, before_then = (_slid(each, slide) for each in (then, before_then))
            counts, aside_px = self._overlap(slide), 0.5 * aside_px
        blocks = int(counts.sum())
        if blocks < MIN_BLOCKS:
            return None
        shift2 = self._change(then, before_then)[counts] / self.gradient2[counts]
        shift2.sort()
        median = _middle(shift2)
        deviations = np.abs(shift2 - median)
        deviations.sort()
        return FlowSince(
            since_s=memory.at_s(number),
            step_s=memory.at_s(memory.count - 1) - memory.at_s(memory.count - 2),
            focal_px=self.focal_px,
            aside_px=aside_px,
            blocks=blocks,
            shift2_px2=median if share == 0.5 else float(shift2[int(share * blocks)]),
            sigma_px2=MEDIAN_SIGMA_PER_MAD * _middle(deviations) / blocks**0.5,
            is_slid=is_slid,
        )

    def _overlap(self, slide: tuple[float, float]) -> NDArray[np.bool_]:
        """Return the blocks with texture that a picture covers when it was slid; none if they are too few."""
        covered = _block_means(_slid(np.ones_like(self.now), slide), BLOCK_PX) > 0.999
        is_enough = bool(covered.mean() >= MIN_OVERLAP)
        return np.asarray(self.is_textured & covered & is_enough, np.bool_)

    def _change(self, then: Plane, before_then: Plane) -> Plane:
        """Return for each block the mean of the product of two differences, less their own means (exposure)."""
        size = self.now.shape[1] // self.gradient2.shape[1]
        one, other = self.now - then, self.before - before_then
        mean = _block_means(one, size) * _block_means(other, size)
        return _block_means(one * other, size) - mean


def _told(flows: Iterable[FlowSince | None]) -> tuple[FlowSince, ...]:
    return tuple([flow for flow in flows if flow is not None])


def _reduce(frame: Frame) -> Image:
    """Return a frame's green channel, reduced by averaging, without its upper and lower edge."""
    green = cv2.extractChannel(frame.image, 1)
    # To halve a picture, again and again, takes a fifth of the time that reducing it at once does.
    while green.shape[1] >= 2 * REDUCED_WIDTH_PX and not (green.shape[0] % 2 or green.shape[1] % 2):
        green = cv2.resize(green, (green.shape[1] // 2, green.shape[0] // 2), interpolation=cv2.INTER_AREA)
    height_px = max(1, round(frame.height_px * REDUCED_WIDTH_PX / frame.width_px))
    small = cv2.resize(green, (REDUCED_WIDTH_PX, height_px), interpolation=cv2.INTER_AREA)
    edge_px = round(EDGE_SHARE * height_px)
    rows = (height_px - 2 * edge_px) // BLOCK_PX * BLOCK_PX
    return np.asarray(small[edge_px : edge_px + rows], np.uint8)


def _slide(then: Plane, now: Plane) -> tuple[float, float]:
    """Return the motion of a picture as a whole, right and down: by the peak of the phase correlation."""
    (x_px, y_px), _ = cv2.phaseCorrelate(then, now, _window(*now.shape))
    return x_px, y_px


@cache
def _window(height_px: int, width_px: int) -> Plane:
    return np.asarray(cv2.createHanningWindow((width_px, height_px), cv2.CV_32F), np.float32)


def _slid(plane: Plane, slide: tuple[float, float]) -> Plane:
    ways = np.array([[1.0, 0.0, slide[0]], [0.0, 1.0, slide[1]]])
    return np.asarray(cv2.warpAffine(plane, ways, plane.shape[::-1]), np.float32)


def _coarser(plane: Plane) -> Plane:
    size = (plane.shape[1] // COARSER, plane.shape[0] // COARSER)
    return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_AREA), np.float32)


def _middle(ordered: NDArray[np.floating]) -> float:
    """Return the median of a few values in order, in a tenth of numpy's time."""
    return float(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2


def _gradient(plane: Plane) -> Plane:
    """Return half the difference of the neighbours to the right and to the left."""
    return np.asarray(cv2.filter2D(plane, cv2.CV_32F, np.array([[-0.5, 0.0, 0.5]], np.float32)), np.float32)


def _block_means(plane: Plane, block_px: int) -> Plane:
    size = (plane.shape[1] // block_px, plane.shape[0] // block_px)
    return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_AREA), np.float32)
