"""Finding a picture in a frame by its key points.

Key points with SIFT descriptors (D. Lowe, "Distinctive image features from scale-invariant keypoints", 2004) of the
picture, at some sizes and turned away to some sides, are matched with those of the frame. Three of them make an
affine map; the one that most of the others agree with says about where the picture is. `stadimeter.detectors.picture.
alignment` judges that, and measures it.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.detection import Points, Profiles
from stadimeter.core.frame import Image
from stadimeter.detectors.picture.alignment import UNIT_CORNERS, Matrix, mapped
from stadimeter.detectors.sides import side_lengths

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
    lengths = side_lengths(corners_px)
    opposite = max(
        max(lengths[0], lengths[2]) / max(min(lengths[0], lengths[2]), 1e-9),
        max(lengths[1], lengths[3]) / max(min(lengths[1], lengths[3]), 1e-9),
    )
    return bool((turns > 0).all()) and opposite < MAX_TAPER
