"""What stands still in a camera's view, and what it shows of the camera: turned, zoomed, out of focus or dirty.

A view is a few hundred ORB features (E. Rublee and others, "ORB: an efficient alternative to SIFT or SURF", 2011),
spread over the picture: directions, descriptors, and two figures of each one's surroundings. No picture can be made of
them.

All that is measured of surroundings comes from products of two pictures of one moment, so that noise, which is new in
each, has no part in their mean, by night as by day (see `picture_flow`):

* Contrast: the energy of details of some 2 to 6 pixels.
* Sharpness: the energy of the finest details divided by the contrast. Light, shade and exposure change both alike;
  a lens out of focus takes the finest first. How much a blur takes depends on what is seen: it is tried out on the
  picture itself when a view is taken, which turns the ratio into pixels of blur.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from stadimeter.errors import CalibrationError
from stadimeter.ranging.view_motion import ViewMotion, fit_view_motion

Plane = NDArray[np.float32]

# Pictures are looked at with this width at most. All pixels here are of that size.
WIDTH_MAX_PX = 640

# The picture is divided so, and each cell gives its strongest features: else a bookcase would give all.
CELLS_ACROSS, CELLS_DOWN, FEATURES_PER_CELL = 8, 6, 10
CELLS = CELLS_ACROSS * CELLS_DOWN

# A cell agrees if this many of its features do.
AGREEING_PER_CELL = 3

# The lowest difference of grey levels of a corner. A picture by night has few stronger ones.
FAST_LEVELS = 8

# A view with fewer features in fewer cells cannot be compared: a white wall has none, a wall with one picture too few.
MIN_FEATURES, MIN_CELLS = 60, 8

# With fewer agreeing matches nothing is concluded. Wrong matches agree by chance on a turn with 8 at most.
MIN_INLIERS = 15

# A camera that hardly moved is looked for first: features within this of where they were, some 3 degrees. So few are
# left to be confused that faint ones count too.
NEAR = 0.05

# Two descriptors of 256 bits of one feature differ by less. Those of two features differ by 128 on average.
HAMMING_MAX = 64

# What is seen beside a feature counts within this half width.
SURROUNDINGS_PX = 6

# A feature that has kept less than this share of its contrast, once the light is allowed for, is behind dirt.
CONTRAST_LOST = 0.1

# A cell is behind dirt if this share of its features is.
LOST_SHARE = 0.8

# A feature stands still that moves by less than this from one moment to the next.
STILL_PX = 1.5

# Blur is tried out with this variance, in px².
TRIED_BLUR_PX2 = 0.25

MEDIAN_SIGMA_PER_MAD = 1.858


# Of each feature: its direction in the axes of the camera as it was when it was saved, 256 bits, and the logarithms of
# the contrast and the sharpness around it.
FEATURE = np.dtype([("place", "<f8", 2), ("bits", "u1", 32), ("contrast", "<f4"), ("sharpness", "<f4")])


class BackgroundView(Struct, frozen=True, kw_only=True):
    """The features of a view, ready for a file.

    Attributes:
        data: The features, each as `FEATURE`.
        blur_slope: How the median sharpness changes with the variance of the blur, per px²; below zero.
        brightness: Mean grey level.
        blur_px2: By how much its blur's variance differs from that of the view that was saved.
    """

    data: bytes
    blur_slope: float
    brightness: float
    blur_px2: float = 0.0

    @property
    def count(self) -> int:
        """How many features it has."""
        return len(self.data) // FEATURE.itemsize

    @property
    def features(self) -> NDArray[Any]:
        """The features, as an array of `FEATURE`."""
        return np.frombuffer(self.data, FEATURE)


class BackgroundComparison(Struct, frozen=True, kw_only=True):
    """What a view says of the camera, compared with an earlier one.

    Attributes:
        motion: How it moved; None if too few features agree.
        blur_px2: By how much the variance of the blur grew.
        blur_sigma_px2: Its standard deviation.
        agreeing_cells: The cells of the picture in which features agree.
        lost_cells: Those whose features in the earlier view have lost their contrast.
    """

    motion: ViewMotion | None = None
    blur_px2: float = 0.0
    blur_sigma_px2: float = math.inf
    agreeing_cells: frozenset[int] = frozenset()
    lost_cells: frozenset[int] = frozenset()

    @property
    def matched(self) -> int:
        """How many features agree."""
        return self.motion.inliers if self.motion is not None else 0

    def in_words(self) -> str:
        """Return what differs, with standard deviations."""
        if self.motion is None:
            return "fewer features agree than are needed"
        return f"{self.motion.in_words()}, blur {self.blur_px2:+.2f} ± {self.blur_sigma_px2:.2f} px²"


class BackgroundLook(Struct, frozen=True, kw_only=True, eq=False):
    """Two pictures of one moment, prepared: their view, and the maps that other views are compared on.

    Attributes:
        lens: The camera model at the resolution that is looked at.
    """

    view: BackgroundView
    lens: CameraModel
    contrast: Plane
    is_hidden: NDArray[np.bool_]

    def compare(self, view: BackgroundView) -> BackgroundComparison:
        """Return what differs from an earlier view."""
        then, now, found = view.features, self.view.features, None
        for within in (NEAR, math.inf):
            theirs, ours = _matches(then, now, within)
            found = found or fit_view_motion(then["place"][theirs], now["place"][ours], self.lens.fx_px, MIN_INLIERS)
            if found is not None:
                break
        else:
            return BackgroundComparison()
        motion, agrees = found
        sharpness = now["sharpness"][ours[agrees]] - then["sharpness"][theirs[agrees]]
        middle = float(np.median(sharpness))
        sigma = MEDIAN_SIGMA_PER_MAD * float(np.median(np.abs(sharpness - middle))) / motion.inliers**0.5
        return BackgroundComparison(
            motion=motion,
            blur_px2=middle / view.blur_slope,
            blur_sigma_px2=sigma / abs(view.blur_slope),
            agreeing_cells=self.cells_with(now["place"][ours[agrees]], AGREEING_PER_CELL),
            lost_cells=self._lost_cells(then, motion.apply(then["place"])),
        )

    def cells_with(self, places: NDArray[np.float64], count: int) -> frozenset[int]:
        """Return the cells of the picture in which there are `count` of some directions at least."""
        return frozenset(np.flatnonzero(np.bincount(self._cells(self.lens.project(places))) >= count).tolist())

    def _lost_cells(self, then: NDArray[Any], expected: NDArray[np.float64]) -> frozenset[int]:
        """Return the cells that have lost their contrast, given where features of an earlier view are expected."""
        places_px = np.nan_to_num(self.lens.project(expected), nan=-1.0).round().astype(int)
        seen = np.asarray(((places_px >= 0) & (places_px < self.contrast.shape[::-1])).all(axis=1))
        seen[seen] &= ~self.is_hidden[tuple(places_px[seen].T[::-1])]
        if not seen.any():
            return frozenset()
        change = self.contrast[tuple(places_px[seen].T[::-1])] - then["contrast"][seen]
        is_lost = change - np.median(change) < math.log(CONTRAST_LOST)
        counts, lost = (np.bincount(self._cells(places_px[seen]), each, CELLS) for each in (None, is_lost))
        return frozenset(np.flatnonzero((counts >= FEATURES_PER_CELL // 2) & (lost >= LOST_SHARE * counts)).tolist())

    def _cells(self, places_px: NDArray[Any]) -> NDArray[np.int64]:
        height_px, width_px = self.contrast.shape
        x, y = places_px.T
        return np.asarray(x * CELLS_ACROSS // width_px + CELLS_ACROSS * (y * CELLS_DOWN // height_px), np.int64)


def look_at(pair: Sequence[Image], lens: CameraModel, hidden: Sequence[NDArray[np.float64]] = ()) -> BackgroundLook:
    """Prepare two pictures of one moment.

    Args:
        lens: The camera model at their resolution.
        hidden: Outlines in their pixels of what does not belong to the background, such as targets.
    """
    scale = min(1.0, WIDTH_MAX_PX / lens.width_px)
    size = (round(lens.width_px * scale), round(lens.height_px * scale))
    one, other = (
        cv2.resize(cv2.cvtColor(each, cv2.COLOR_BGR2GRAY), size, interpolation=cv2.INTER_AREA) for each in pair
    )
    mask = np.full((size[1], size[0]), 255, np.uint8)
    for outline in hidden:
        x, y, width, height = cv2.boundingRect((outline * scale).astype(np.float32))
        cv2.rectangle(mask, (x - 10, y - 10), (x + width + 10, y + height + 10), 0, -1)
    small = lens.scaled_to(*size)
    planes = one.astype(np.float32), other.astype(np.float32)
    contrast, sharpness = _surroundings(*planes)
    found = _features(np.asarray(cv2.addWeighted(one, 0.5, other, 0.5, 0), np.uint8), mask)
    points = np.array([each.pt for each, _ in found], np.float64).reshape(-1, 2)
    column, row = points.round().astype(np.intp).T
    features = np.zeros(len(found), FEATURE)
    features["place"] = small.directions(points)
    features["bits"] = np.array([bits for _, bits in found], np.uint8).reshape(-1, 32)
    features["contrast"], features["sharpness"] = contrast[row, column], sharpness[row, column]
    slope = _blur_slope(planes, sharpness, column, row)
    view = BackgroundView(data=features.tobytes(), blur_slope=slope, brightness=float(one.mean()))
    return BackgroundLook(view=view, lens=small, contrast=contrast, is_hidden=mask == 0)


def keep_still(looks: Sequence[BackgroundLook]) -> BackgroundView:
    """Return what is in all of some views of a camera that stood still.

    Raises:
        CalibrationError: It is too little to be compared with later views; the message says what to do.
    """
    first, *others = looks
    features = first.view.features
    for look in others:
        theirs, ours = _matches(features, now := look.view.features, NEAR)
        shift_px = np.hypot(*(now["place"][ours] - features["place"][theirs]).T) * first.lens.fx_px
        features = features[theirs[shift_px < STILL_PX]]
    cells = len(first.cells_with(features["place"], 1))
    if len(features) < MIN_FEATURES or cells < MIN_CELLS:
        raise CalibrationError(
            f"the view has {len(features)} features that stand still, in {cells} of {CELLS} parts of the picture; "
            f"{MIN_FEATURES} in {MIN_CELLS} are needed. A plain wall or a dark room shows no movement of the camera: "
            "give it light, and something with edges to see, such as a poster"
        )
    return replace(first.view, data=features.tobytes())


def _features(grey: NDArray[np.uint8], mask: NDArray[np.uint8]) -> list[tuple[cv2.KeyPoint, NDArray[np.uint8]]]:
    """Return the strongest features of each cell, with their descriptors."""
    orb = cv2.ORB.create(nfeatures=4000, scaleFactor=1.2, nlevels=4, fastThreshold=FAST_LEVELS)
    height_px, width_px = grey.shape
    cells: dict[tuple[int, int], list[cv2.KeyPoint]] = {}
    for each in sorted(orb.detect(grey, mask), key=lambda each: -each.response):
        cell = int(each.pt[0] * CELLS_ACROSS // width_px), int(each.pt[1] * CELLS_DOWN // height_px)
        cells.setdefault(cell, []).append(each)
    chosen = [each for strongest in cells.values() for each in strongest[:FEATURES_PER_CELL]]
    points, bits = orb.compute(grey, chosen)
    return [*zip(points, np.asarray(bits, np.uint8), strict=True)] if points else []


def _matches(then: NDArray[Any], now: NDArray[Any], within: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return which features are the same, by their positions: each the nearest of the other.

    Args:
        within: How far apart their directions may be.
    """
    if not len(then) or not len(now):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    words = [np.ascontiguousarray(each["bits"]).view(np.uint64) for each in (then, now)]
    differing = np.bitwise_count(words[0][:, None] ^ words[1]).sum(axis=2, dtype=np.uint16)
    for axis in (0, 1) if within < math.inf else ():
        apart = then["place"][:, axis, None].astype(np.float32) - now["place"][:, axis].astype(np.float32)
        differing[np.abs(apart) > within] = HAMMING_MAX
    nearest, back, one = differing.argmin(axis=1), differing.argmin(axis=0), np.arange(len(then))
    is_mutual = (back[nearest] == one) & (differing[one, nearest] < HAMMING_MAX)
    return one[is_mutual], nearest[is_mutual]


def _surroundings(one: Plane, other: Plane) -> tuple[Plane, Plane]:
    """Return the logarithms of contrast and sharpness at each pixel, from two pictures of one moment."""
    size = (2 * SURROUNDINGS_PX + 1,) * 2
    fine, coarse = [], []
    for each in (one, other):
        near, far = cv2.GaussianBlur(each, (0, 0), 1.0), cv2.GaussianBlur(each, (0, 0), 3.0)
        fine.append(each - near)
        coarse.append(near - far)
    # A grey level of 0.1 is below all that noise leaves: no logarithm of nothing.
    energies = [np.maximum(cv2.boxFilter(a * b, -1, size), 0.01) for a, b in (fine, coarse)]
    logs = [np.log(each).astype(np.float32) for each in energies]
    return logs[1], logs[0] - logs[1]


def _blur_slope(planes: tuple[Plane, Plane], sharpness: Plane, x: NDArray[np.intp], y: NDArray[np.intp]) -> float:
    if not len(x):
        return -1.0
    one, other = (np.asarray(cv2.GaussianBlur(each, (0, 0), TRIED_BLUR_PX2**0.5), np.float32) for each in planes)
    _, blurred = _surroundings(one, other)
    return min(float(np.median((blurred - sharpness)[y, x])) / TRIED_BLUR_PX2, -0.1)
