"""The picture detector: a poster, a book cover or a label of known size, from a file that shows what is on it.

It needs no rim, no colour and no code: its key points say where it is, and all of its area then says it to a few
hundredths of a pixel, also where a finger hides a part.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray
from pydantic import Field, model_validator

from stadimeter.config.files import PICTURE_MAX_BYTES, decode_picture, read_untrusted
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import FilePath, Length, Tolerance
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Points, Prediction, Profiles, RejectedCandidate
from stadimeter.core.frame import Frame, Image
from stadimeter.detectors.protocol import check_image
from stadimeter.detectors.sampling import Light, Region, grey_of, in_light, light_table, median, touches_border
from stadimeter.detectors.sides import MAD_TO_SIGMA, diagonals_meet, side_lengths, width_and_height
from stadimeter.errors import PictureError, UnreadableError
from stadimeter.ranging.flat import PictureShape

# Finding a picture in a frame by its key points -----------------------------------------------------------------------
#
# Key points with SIFT descriptors (D. Lowe, "Distinctive image features from scale-invariant keypoints", 2004) of
# the picture, at some sizes and turned away to some sides, are matched with those of the frame. Three of them make
# an affine map; the one that most of the others agree with says about where the picture is. `align` judges that, and
# measures it.

# The picture is described as it looks at these lengths of its longer side, in pixels, straight and turned away to four
# sides, by which it is squeezed as by a tilt of 53 degrees; descriptors bear half of that (J.-M. Morel and G. Yu,
# "ASIFT", 2009). Without the slanting ones, one poster of four at 60 pixels and 50 degrees was not found.
VIEW_SIZES_PX = (320, 160, 96, 60)
SQUEEZE, DIRECTIONS_DEG = 0.6, (0, 45, 90, 135)

# Key points of a view, and of a frame, the strongest.
VIEW_FEATURES, FRAME_FEATURES = 400, 1500
MIN_CONTRAST = 0.02

# A match counts if the next best place in the frame is less alike, by this ratio of distances (Lowe, section 7.1).
MATCH_RATIO = 0.8

# Of a homography: how far matches may be off, in pixels, and how many must agree; the place is judged afterwards.
AGREE_PX = 4.0
MIN_AGREEING = 5
MAX_TRIALS = 5000

# Matches are near an affine place within this share of the picture's size: what a tilt of 50 degrees tapers.
NEAR_SHARE = 0.2

# This number of places is tried, each without the matches of those before.
PLACES = 3

# A side may not be this many times as long as the opposite one: beyond it, the picture is seen from its edge.
MAX_TAPER = 4.0


class Descriptors(Struct, frozen=True, eq=False):
    """Key points."""

    places: Points  # shape (n, 2)
    rows: Profiles  # descriptors of length 1, shape (n, 128)


class PictureFeatures:
    """The key points of a picture.

    Args:
        grey: The picture in code values.
    """

    def __init__(self, grey: Image) -> None:
        views = [_view(grey, size_px, 1.0, 0) for size_px in VIEW_SIZES_PX]
        views += [_view(grey, size_px, SQUEEZE, turn) for size_px in VIEW_SIZES_PX for turn in DIRECTIONS_DEG]
        self._known = Descriptors(
            np.concatenate([each.places for each in views]), np.concatenate([each.rows for each in views])
        )
        self.count = len(self._known.places)
        self._frame_sift = _sift(FRAME_FEATURES)

    def places_in(self, grey: Image) -> list[Points]:
        """Return where the picture may be: its corners, the place that most key points agree on first."""
        seen = _described(self._frame_sift, grey)
        known, there = _matches(self._known, seen)
        places: list[Points] = []
        while len(places) < PLACES and len(known) >= MIN_AGREEING:
            homography, chosen = _likeliest_place(known, there)
            if int(np.sum(chosen)) < MIN_AGREEING:
                break
            corners = mapped(homography, UNIT_CORNERS)
            if _is_a_view(homography, corners):
                places.append(corners)
            known, there = known[~chosen], there[~chosen]
        return places


def _likeliest_place(known: Points, there: Points) -> tuple[Matrix, NDArray[np.bool_]]:
    """Return where most matches agree that the picture is, and which of them.

    Affine first: four matches of a small picture, off by a pixel, make homographies that are far off between them. What
    is near that then says how the picture tapers.
    """
    affine, inliers = cv2.estimateAffine2D(
        known, there, method=cv2.RANSAC, ransacReprojThreshold=AGREE_PX, maxIters=MAX_TRIALS, confidence=0.999
    )
    if inliers is None or not inliers.any():  # OpenCV then gives no map either
        return np.eye(3), np.zeros(len(known), bool)
    flat, chosen = np.vstack((affine, (0, 0, 1))), inliers.ravel().astype(bool)
    size_px = max(side_lengths(mapped(flat, UNIT_CORNERS)))
    near = np.linalg.norm(mapped(flat, known) - there, axis=1) < max(AGREE_PX, NEAR_SHARE * size_px)
    if int(near.sum()) > MIN_AGREEING:
        tapered, inliers = cv2.findHomography(
            known[near], there[near], cv2.RANSAC, AGREE_PX, maxIters=MAX_TRIALS, confidence=0.999
        )
        if tapered is not None and int(inliers.sum()) > int(chosen.sum()):
            chosen = np.zeros(len(known), bool)
            chosen[near] = inliers.ravel().astype(bool)
            return np.asarray(tapered, np.float64), chosen
    return flat, chosen


def _view(grey: Image, size_px: int, squeeze: float, direction_deg: float) -> Descriptors:
    """Return the key points of the picture at a size, squeezed in a direction, at places from 0 to 1."""
    height, width = grey.shape
    scale = size_px / max(width, height)
    small = (max(8, round(width * scale)), max(8, round(height * scale)))
    seen = cv2.resize(grey, small, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    # Turned by the direction, squeezed across, and moved so that all of it is seen.
    angle = math.radians(direction_deg)
    turned = np.array(((math.cos(angle), math.sin(angle)), (-math.sin(angle), math.cos(angle))))
    affine = np.diag((squeeze, 1.0)) @ turned
    corners = (UNIT_CORNERS * small) @ affine.T
    low = corners.min(axis=0)
    box = tuple(int(each) for each in np.ceil(corners.max(axis=0) - low) + 1)
    if squeeze < 1:  # no detail finer than the samples that are left
        seen = cv2.GaussianBlur(seen, (0, 0), 0.5 / squeeze)
    shown = cv2.warpAffine(seen, np.column_stack((affine, -low)), box, borderMode=cv2.BORDER_REPLICATE)
    found = _described(_sift(VIEW_FEATURES), np.asarray(shown, np.uint8))
    places = ((found.places + low) @ np.linalg.inv(affine).T + 0.5) / np.array(small)
    on_it = ((places > 0) & (places < 1)).all(axis=1)
    return Descriptors(places[on_it], found.rows[on_it])


def _sift(count: int) -> cv2.SIFT:
    return cv2.SIFT.create(nfeatures=count, contrastThreshold=MIN_CONTRAST)


def _described(sift: cv2.SIFT, grey: Image) -> Descriptors:
    points, rows = sift.detectAndCompute(grey, None)
    if rows is None or not len(points):
        return Descriptors(np.empty((0, 2)), np.empty((0, 128), np.float32))
    places = np.array([point.pt for point in points])
    # Square roots of descriptors whose sum is 1: their products tell alike ones better (R. Arandjelović and A.
    # Zisserman, "Three things everyone should know to improve object retrieval", 2012).
    shares = rows / np.maximum(rows.sum(axis=1, keepdims=True), 1e-6)
    return Descriptors(places, np.sqrt(shares).astype(np.float32))


def _matches(known: Descriptors, seen: Descriptors) -> tuple[Points, Points]:
    """Return the places of key points of the picture, and of those of the frame that are like them and no other is."""
    if len(seen.places) < 4 or not len(known.places):
        return np.empty((0, 2)), np.empty((0, 2))
    alike = known.rows @ seen.rows.T
    best = np.argpartition(-alike, 3, axis=1)[:, :4]
    rows = np.arange(len(best))[:, None]
    best = np.take_along_axis(best, np.argsort(-alike[rows, best], axis=1, kind="stable"), axis=1)
    # Of one place with two directions there are two key points: the next best is the next that is elsewhere.
    there = seen.places[best]
    elsewhere = np.abs(there - there[:, :1]).max(axis=2) > 2
    second = np.where(elsewhere.any(axis=1), elsewhere.argmax(axis=1), 3)
    # The distance of two vectors of length 1 is √(2 - 2 a b).
    off, off_next = (
        np.sqrt(np.maximum(2 - 2 * alike[rows[:, 0], column], 0.0)) for column in (best[:, 0], best[rows[:, 0], second])
    )
    # Of all key points that match one of the frame, the most alike counts: else a place of clutter that many match
    # would win, by a map that shrinks the picture to a point.
    nearest_first = np.argsort(off, kind="stable")
    nearest_first = nearest_first[(off < MATCH_RATIO * off_next)[nearest_first]]
    _, firsts = np.unique(best[nearest_first, 0], return_index=True)
    matched = nearest_first[np.sort(firsts)]
    return known.places[matched], seen.places[best[matched, 0]]


def _is_a_view(homography: Matrix, corners_px: Points) -> bool:
    """Check whether corners are those of a picture seen from its front."""
    depths = UNIT_CORNERS @ homography[2, :2] + homography[2, 2]
    if not (np.isfinite(corners_px).all() and (depths > 0).all()):
        return False
    sides = np.roll(corners_px, -1, axis=0) - corners_px
    after = np.roll(sides, -1, axis=0)
    turns = sides[:, 0] * after[:, 1] - sides[:, 1] * after[:, 0]  # all positive: convex, and not mirrored
    pairs = np.reshape(side_lengths(corners_px), (2, 2))  # opposite sides stand in one column
    return bool((turns > 0).all() and (pairs.max(axis=0) < MAX_TAPER * pairs.min(axis=0)).all())


# Laying a picture over what a camera sees of it: its four corners, to a few hundredths of a pixel ---------------------
#
# All of the picture counts, not its edges alone: Gauss-Newton steps move the four corners until the light of the
# frame, read where the picture should be, equals the picture's own but for brightness, contrast and a gradient of the
# lighting. The picture is what is differentiated, so its slopes are worked out once (inverse compositional alignment:
# S. Baker and I. Matthews, "Lucas-Kanade 20 Years On", 2004, section 3.2).
#
# Coordinates of the picture run from 0 to 1 from its top left corner; pixels have (0, 0) at the centre of the first
# one.

Matrix = NDArray[np.float64]

UNIT_CORNERS = np.array(((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)))

# The picture is compared in as many samples as it has pixels in the frame, along a side at least and at most. More
# would gain little: of 112 across, an error of 0.02 samples is 0.016 % of the size.
MIN_SAMPLES, MAX_SAMPLES = 20, 112

# Samples at the rim are left out: what is behind the picture blurs into them.
RIM_SAMPLES = 2

# What a camera's optics blur, in samples: rendered pictures have a point spread of 0.7 pixels.
BLUR_SAMPLES = 0.7

# Each size is worked on until corners move by less than this number of samples over the root of their number, a small
# part of what noise moves them by; or this often.
SETTLED_SAMPLES = 0.2
MAX_STEPS = 10

# A step may move a corner by this share of the size at most: beyond it the slopes say nothing.
MAX_STEP_SHARE = 0.25

# What hides a part, a glare or a finger, must not count. Residuals beyond this many standard deviations count less (P.
# J. Huber's weights) while corners are moved into place, and then nothing (J. W. Tukey's biweight).
HUBER_SIGMAS, BIWEIGHT_SIGMAS = 1.5, 4.685

# Least share of the samples that must lie in the frame.
MIN_VISIBLE = 0.6

# Residuals of neighbouring samples are alike, since blur, interpolation and JPEG spread them: the covariance of
# independent ones is multiplied by this. Chosen on rendered posters of 60 to 300 px, as what it leaves out is, see
# `stadimeter.ranging.flat.PictureShape`.
COVARIANCE_FACTOR = 10.0

# A finite step of a corner, as a share of the size, to find how the frame's corners follow.
PROBE = 1e-5


class Alignment(Struct, frozen=True, kw_only=True, eq=False):
    """The place of a picture in a frame.

    Attributes:
        corners_px: Its corners from its own top left one on, clockwise as it is printed, shape ``(4, 2)``.
        covariance_px2: Of these eight coordinates, shape ``(8, 8)``, from the noise that is left.
        correlation: Of the frame's light with the picture's, from -1 to 1, where they agree.
        agreeing: The share of its samples in the frame that agree with the picture at all.
    """

    corners_px: Points
    covariance_px2: Matrix
    correlation: float
    agreeing: float


class PictureLight:
    """A picture's light, at the sizes at which it is compared."""

    def __init__(self, light: Light) -> None:
        self._light = light
        self.at = lru_cache(maxsize=12)(self._at)

    def _at(self, across: int, down: int) -> _Samples:
        """Return the picture in a number of samples, with what a step of each corner changes in them."""
        blurred = cv2.GaussianBlur(
            cv2.resize(self._light, (across, down), interpolation=cv2.INTER_AREA), (0, 0), BLUR_SAMPLES
        )
        down_slope, across_slope = (np.gradient(blurred.astype(np.float64), axis=axis) for axis in (0, 1))
        x, y = np.meshgrid((np.arange(across) + 0.5) / across, (np.arange(down) + 0.5) / down)
        inner = np.zeros((down, across), bool)
        inner[RIM_SAMPLES:-RIM_SAMPLES, RIM_SAMPLES:-RIM_SAMPLES] = True
        x, y, value = x[inner], y[inner], blurred[inner].astype(np.float64)
        # Light per unit of the picture's own coordinates.
        slopes = np.column_stack((across_slope[inner] * across, down_slope[inner] * down))
        moved = np.einsum("na,nac->nc", slopes, _by_corners(x, y))
        # Unknown beside the corners' steps: contrast, brightness, and a gradient of the lighting across and down.
        columns = np.column_stack((moved, value, np.ones_like(x), x - 0.5, y - 0.5))
        return _Samples(places=np.column_stack((x, y)), light=value, columns=columns)


class _Samples(Struct, frozen=True, eq=False):
    """A picture in samples."""

    places: Points  # in the picture's coordinates, shape (n, 2)
    light: Matrix  # shape (n,)
    columns: Matrix  # what each unknown adds to the light, shape (n, 12): eight of corners, then contrast first


def _by_corners(x: Matrix, y: Matrix) -> Matrix:
    """Return the motion of places with the four corners, shape ``(n, 2, 8)``.

    To first order a homography near the identity moves (x, y) by ``(a x + b y + c - g x² - h x y, d x + e y + f - g x y
    - h y²)``; its eight parameters follow from the steps of the four corners by a linear system.
    """

    def basis(x: Matrix, y: Matrix) -> Matrix:
        zero, one = np.zeros_like(x), np.ones_like(x)
        across = np.stack((x, y, one, zero, zero, zero, -x * x, -x * y), axis=-1)
        down = np.stack((zero, zero, zero, x, y, one, -x * y, -y * y), axis=-1)
        return np.stack((across, down), axis=-2)

    at_corners = basis(UNIT_CORNERS[:, 0], UNIT_CORNERS[:, 1]).reshape(8, 8)
    return np.asarray(basis(x, y) @ np.linalg.inv(at_corners))


def align(frame: Light, picture: PictureLight, corners_px: Points, lens: CameraModel | None = None) -> Alignment | None:
    """Lay the picture over a frame from where it may be; None where that leads nowhere.

    A quarter of the size first, then half, then all of it, so that a start that is off by a tenth of the picture is
    good enough.

    Args:
        frame: Its light, shape ``(height, width)``.
        corners_px: About where its corners are.
        lens: The camera model, whose distortion bends what is straight on the picture.
    """
    found = None
    lens = lens if lens is not None and lens.distortion else None
    corners_px = straightened(lens, corners_px)
    for share in (0.25, 0.5, 1.0):
        samples = _samples_of(corners_px, share)
        if samples is None:
            return None
        part = _ReducedPart.of(frame, lens, corners_px, max(samples))
        found = _settle(part, picture.at(*samples), corners_px, is_last=share == 1.0)
        if found is None:
            return None
        corners_px = found.corners_px
    # How a lens stretches the place of a corner changes its covariance by some percent only.
    return found and replace(found, corners_px=bent(lens, corners_px))


def bent(lens: CameraModel | None, points_px: Points) -> Points:
    """Return where a lens shows places of the straight picture."""
    if lens is None:
        return points_px
    focal, centre = np.array((lens.fx_px, lens.fy_px)), np.array((lens.cx_px, lens.cy_px))
    return lens.project((points_px - centre) / focal)


def straightened(lens: CameraModel | None, points_px: Points) -> Points:
    """Return the inverse of `bent`."""
    if lens is None:
        return points_px
    focal, centre = np.array((lens.fx_px, lens.fy_px)), np.array((lens.cx_px, lens.cy_px))
    return np.asarray(lens.directions(points_px) * focal + centre)


def _samples_of(corners_px: Points, share: float) -> tuple[int, int] | None:
    """Return in how many samples across and down a picture with such corners is compared."""
    top, right, bottom, left = side_lengths(corners_px)
    sides = ((top + bottom) / 2, (left + right) / 2)
    if not (min(sides) > 0 and max(sides) < math.inf):
        return None
    factor = share * min(1.0, MAX_SAMPLES / max(sides))
    across, down = (int(np.clip(round(side * factor / 4) * 4, MIN_SAMPLES, MAX_SAMPLES)) for side in sides)
    return across, down


class _ReducedPart(Struct, frozen=True, eq=False):
    """The part of a frame around a picture, about as coarse as the samples that it is compared in."""

    light: Light
    scale: float  # reduced pixels per pixel of the frame
    left_top_px: Points
    lens: CameraModel | None  # with distortion; None where straight lines are straight

    @classmethod
    def of(cls, frame: Light, lens: CameraModel | None, corners_px: Points, samples: int) -> _ReducedPart:
        """Return the part within a quarter of the picture's size around it."""
        seen_px = bent(lens, corners_px)
        low, high = seen_px.min(axis=0), seen_px.max(axis=0)
        margin = 4 + 0.25 * (high - low)
        left, top = np.maximum(np.floor(low - margin), 0).astype(int)
        right, bottom = np.minimum(np.ceil(high + margin) + 1, frame.shape[::-1]).astype(int)
        part = frame[top : max(bottom, top), left : max(right, left)]
        # Whole steps only: each reduced pixel is then the mean of a square of whole ones.
        step = max(1, int(max(side_lengths(corners_px)) / samples))
        rows, columns = (length // step for length in part.shape)
        if step > 1 and rows and columns:
            whole = part[: rows * step, : columns * step]
            part = np.asarray(cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)
        return cls(np.asarray(part, np.float32), 1 / step, np.array((left, top), np.float64), lens)

    def read(self, points_px: Points) -> tuple[Matrix, NDArray[np.bool_]]:
        """Return the light at places of the frame, between pixels in proportion, and which of them are in the part."""
        height, width = self.light.shape
        points_px = bent(self.lens, points_px)
        x, y = ((points_px - self.left_top_px + 0.5) * self.scale - 0.5).T
        inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        if height < 2 or width < 2:
            return np.zeros(len(x)), np.zeros(len(x), bool)
        x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
        column, row = np.minimum(x.astype(np.intp), width - 2), np.minimum(y.astype(np.intp), height - 2)
        across, down = x - column, y - row
        flat, at = self.light.ravel(), row * width + column
        above = flat[at] * (1 - across) + flat[at + 1] * across
        below = flat[at + width] * (1 - across) + flat[at + width + 1] * across
        return np.asarray(above * (1 - down) + below * down, np.float64), inside


def _settle(frame: _ReducedPart, samples: _Samples, corners_px: Points, *, is_last: bool) -> Alignment | None:
    """Move corners until nothing changes; None where they run away."""
    weights = np.ones_like(samples.light)
    settled = SETTLED_SAMPLES / math.sqrt(len(samples.light))  # in the picture's own coordinates
    for _ in range(MAX_STEPS):
        homography = homography_to(corners_px)
        light, inside = frame.read(mapped(homography, samples.places))
        if float(inside.mean()) < MIN_VISIBLE:
            return None
        columns, seen = samples.columns[inside], light[inside]
        unknowns, inverse = _fit(columns, seen, weights[inside])
        off = seen - columns @ unknowns
        sigma = max(MAD_TO_SIGMA * float(median(np.abs(off))[0]), 1e-6)
        if is_last:
            weights[inside] = np.maximum(1 - (off / (BIWEIGHT_SIGMAS * sigma)) ** 2, 0.0) ** 2
        else:  # what does not fit yet may fit later
            weights[inside] = np.minimum(1.0, HUBER_SIGMAS * sigma / np.maximum(np.abs(off), 1e-12))
        # The fit tells by how much the picture must be moved to look like the frame; so the frame's corners are where
        # the homography takes the corners moved back by it.
        contrast = float(unknowns[8])
        step = unknowns[:8].reshape(4, 2) / contrast if contrast > 0 else np.full((4, 2), np.inf)
        if not np.abs(step).max() < MAX_STEP_SHARE:
            return None
        corners_px = mapped(homography, _moved_back(step))
        if np.abs(step).max() < settled:
            break
    used = weights[inside]
    variance = float((used * off**2).sum() / max(used.sum() - len(unknowns), 1.0))
    spread = _spread(homography)
    return Alignment(
        corners_px=corners_px,
        covariance_px2=spread @ (COVARIANCE_FACTOR * variance / contrast**2 * inverse[:8, :8]) @ spread.T,
        correlation=_correlation(seen, samples.light[inside], used),
        agreeing=float((used > 0).mean()),
    )


def _correlation(one: Matrix, other: Matrix, weights: Matrix) -> float:
    """Return the correlation of weighted values; 0 where one of them does not vary."""
    one, other = (each - np.average(each, weights=weights) for each in (one, other))
    product = float((weights * one * one).sum() * (weights * other * other).sum())
    return float((weights * one * other).sum()) / math.sqrt(product) if product > 0 else 0.0


def _fit(columns: Matrix, light: Matrix, weights: Matrix) -> tuple[Matrix, Matrix]:
    """Return the unknowns by least squares, and the inverse of the normal matrix."""
    weighted = columns * weights[:, None]
    normal = weighted.T @ columns
    # A trace of a ridge: a plain picture has nothing to hold on to, and its steps are refused afterwards.
    inverse = np.linalg.inv(normal + 1e-12 * np.trace(normal) * np.eye(len(normal)))
    return inverse @ (weighted.T @ light), inverse


def homography_to(corners_px: Points) -> Matrix:
    """Return the homography that takes the picture's coordinates to the frame's pixels."""
    return np.asarray(cv2.getPerspectiveTransform(UNIT_CORNERS.astype(np.float32), corners_px.astype(np.float32)))


def mapped(homography: Matrix, points: Points) -> Points:
    """Return where a homography takes points, shape ``(n, 2)``."""
    taken = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(taken[:, :2] / taken[:, 2:])


def _moved_back(step: Points) -> Points:
    """Return where the inverse of the homography that moves the corners by a step takes them."""
    there = homography_to(UNIT_CORNERS + step)
    return mapped(np.asarray(np.linalg.inv(there), np.float64), UNIT_CORNERS)


def _spread(homography: Matrix) -> Matrix:
    """Return the motion of the frame's corners with those of the picture, shape ``(8, 8)``."""
    spread = np.zeros((8, 8))
    for axis, step in enumerate(PROBE * np.eye(2)):
        change = (mapped(homography, UNIT_CORNERS + step) - mapped(homography, UNIT_CORNERS)) / PROBE
        for corner in range(4):
            spread[2 * corner : 2 * corner + 2, 2 * corner + axis] = change[corner]
    return spread


# The detector ---------------------------------------------------------------------------------------------------------

# The light of what is seen must follow that of the picture this closely, as a correlation, on this share of its area:
# the rest may be hidden.
MIN_CORRELATION, MIN_AGREEING_SHARE = 0.85, 0.55

# A file is worked with at this length of its longer side at most: it is compared in 112 samples, and described at 320
# pixels.
MAX_FILE_SIDE_PX = 1024

# With fewer key points the file is too plain to be found: each view of it must have some.
MIN_FILE_FEATURES = 60

# Least and greatest ratio of a file's sides to those that are stated.
MAX_ASPECT_OFF = 0.1

# Reach of the search around a prediction, to each side: in longer sides.
REGION_SIDES = 0.8

# Standard deviation of the apparent size at its best.
SIGMA_FLOOR_PX = 0.015


class PictureOptions(DriverOptions):
    """The options of a flat picture, such as a poster or a book cover."""

    file: FilePath
    """A picture that shows it from the front, and nothing around it: a scan, or what was printed."""
    width: Length | None = None
    """Its width, such as ``"42 cm"``; the height follows from the file, unless it is given."""
    height: Length | None = None
    """Its height, instead of the width."""
    tolerance: Tolerance | None = None
    """One standard deviation of its sides; None for exactly known ones."""
    min_side_px: Annotated[float, Field(ge=24)] = 32.0
    """Where its shorter side is smaller than this in the frame, it is not accepted."""

    @model_validator(mode="after")
    def _has_a_size(self) -> PictureOptions:
        if self.width is None and self.height is None:
            raise ValueError('give its width or its height, such as width = "42 cm"')
        return self

    def build(self, context: DriverContext) -> PictureDetector:
        """Return the detector.

        Raises:
            PictureError: The file cannot be read, shows too little, or has other proportions than stated.
        """
        return PictureDetector(context.name, self)

    def lacks(self) -> tuple[str, ...]:
        """Return why the file cannot be used."""
        try:
            PictureDetector("picture", self)
        except PictureError as error:
            return (str(error),)
        return ()


class PictureDetector:
    """Finds one picture."""

    def __init__(self, name: str, options: PictureOptions) -> None:
        self._name = name
        self._min_side_px = options.min_side_px
        known = _read(options.file)
        self._size = _shape(options, known)
        grey = grey_of(known)
        self._features = PictureFeatures(grey)
        if self._features.count < MIN_FILE_FEATURES:
            raise PictureError(
                f"the picture {options.file} is too plain to be found: {self._features.count} key points, limit "
                f"{MIN_FILE_FEATURES}; take one with more on it, or the detector sheet"
            )
        self._light = PictureLight(in_light(grey, light_table("srgb")))

    @property
    def target_shape(self) -> PictureShape:
        """The picture's size."""
        return self._size

    def detect(
        self, frame: Frame, prediction: Prediction | None = None, *, lens: CameraModel | None = None
    ) -> Detection:
        """Look for the picture: over its expected corners first, then by its key points in the whole frame."""
        check_image(frame)
        grey = grey_of(frame.image)
        light = in_light(grey, light_table("srgb" if lens is None else lens.tone_curve))
        if prediction is not None and prediction.outline_px is not None and prediction.outline_px.shape == (4, 2):
            followed = self._align_at(light, prediction.outline_px, lens)
            if isinstance(followed, Detection) and followed.status is DetectionStatus.FOUND:
                return followed
        near = Region.expected(prediction, frame.image, sizes=REGION_SIDES, outwards=True)
        if near is not None:
            places = self._features.places_in(near.of(grey))
            found, _ = self._best([corners + near.left_top_px for corners in places], light, lens)
            if found is not None and found.status is DetectionStatus.FOUND:
                return found
        found, rejected = self._best(self._features.places_in(grey), light, lens)
        if found is not None:
            return found
        likeliest = f"the likeliest place is refused: {rejected[0].reason}" if rejected else ""
        reason = likeliest or f"fewer than {MIN_AGREEING} of its key points agree on a place"
        return Detection(target=self._name, status=DetectionStatus.NOT_FOUND, reason=reason, rejected=tuple(rejected))

    def _best(
        self, places: Sequence[Points], light: Light, lens: CameraModel | None
    ) -> tuple[Detection | None, list[RejectedCandidate]]:
        """Return the picture at the first place where it is, and the places before it with why it is not there."""
        rejected: list[RejectedCandidate] = []
        for corners in places:
            found = self._align_at(light, corners, lens)
            if isinstance(found, Detection):
                return found, rejected
            outline = tuple((float(each[0]), float(each[1])) for each in corners)
            size_px, (x, y) = max(side_lengths(corners)), diagonals_meet(corners)
            rejected.append(RejectedCandidate(centre_px=(x, y), size_px=size_px, reason=found, corners_px=outline))
        return None, rejected

    def _align_at(self, light: Light, corners_px: Points, lens: CameraModel | None) -> Detection | str:
        """Return the picture where it may be, or why it is not there."""
        if not np.isfinite(corners_px).all() or np.abs(corners_px).max() > 10 * max(light.shape):
            return "leads out of the frame"
        found = align(light, self._light, corners_px, lens)
        if found is None:
            return "what is there does not become like the picture"
        if found.correlation < MIN_CORRELATION or found.agreeing < MIN_AGREEING_SHARE:
            like = f"{found.agreeing:.0%} of it is like the picture by {found.correlation:.2f}"
            return f"{like}, limits {MIN_AGREEING_SHARE:.0%} and {MIN_CORRELATION:g}"
        if not min(side_lengths(found.corners_px)) >= self._min_side_px:
            return f"too small: {min(side_lengths(found.corners_px)):.0f} px, limit {self._min_side_px:g} px"
        if touches_border(found.corners_px, light.shape, 0.0):
            reason = "the picture is cut off by the border"
            status = DetectionStatus.TRUNCATED
            return Detection(target=self._name, status=status, reason=reason, outline_px=found.corners_px)
        return self._found(found)

    def _found(self, found: Alignment) -> Detection:
        width_px, height_px = width_and_height(found.corners_px)
        return Detection(
            target=self._name,
            status=DetectionStatus.FOUND,
            outline_px=found.corners_px,
            centre_px=diagonals_meet(found.corners_px),
            width_px=width_px,
            height_px=height_px,
            size_sigma_px=math.hypot(SIGMA_FLOOR_PX, _size_sigma_px(found)),
            quality=float(np.clip(found.correlation, 0, 1)),
        )


def _size_sigma_px(found: Alignment) -> float:
    """Return the standard deviation of the mean of width and height, from the corners' covariance."""
    sides = np.roll(found.corners_px, -1, axis=0) - found.corners_px
    along = sides / np.maximum(side_lengths(found.corners_px), 1e-9)[:, None]
    # Width and height are each the mean of two sides, so each side counts a quarter. A corner ends one and begins one.
    row = ((np.roll(along, 1, axis=0) - along) / 4).ravel()
    return math.sqrt(max(float(row @ found.covariance_px2 @ row), 0.0))


def _read(path: Path) -> Image:
    """Return the picture of a file, no larger than is needed."""
    try:
        image = decode_picture(read_untrusted(path, PICTURE_MAX_BYTES))
    except (UnreadableError, PictureError) as error:
        why = f"cannot be read: {error.reason}" if isinstance(error, UnreadableError) else str(error)
        raise PictureError(f"the picture {path} {why}") from error
    scale = min(1.0, MAX_FILE_SIDE_PX / max(image.shape[:2]))
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _shape(options: PictureOptions, known: Image) -> PictureShape:
    """Return the picture's size, of which the file says the proportions."""
    height_px, width_px = known.shape[:2]
    width_m = options.width or (options.height or 0.0) * width_px / height_px
    height_m = options.height or width_m * height_px / width_px
    off = width_m / height_m / (width_px / height_px) - 1
    if abs(off) > MAX_ASPECT_OFF:
        raise PictureError(
            f"the picture {options.file} has {width_px}x{height_px} pixels, but {width_m:g} x {height_m:g} m are other "
            "proportions; cut away what is around it, or leave out the height"
        )
    sigma = (options.tolerance or 0.0) / math.sqrt(width_m * height_m)
    return PictureShape(width_m=width_m, height_m=height_m, relative_sigma=sigma)
