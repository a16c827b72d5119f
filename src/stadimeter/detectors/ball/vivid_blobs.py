"""Blobs that stand out in a picture by a colour of their own: where a ball of unknown colour is likely to be."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np

from stadimeter.core.frame import Image
from stadimeter.detectors.ball.colour_ranges import Place

SEARCH_WIDTH_PX = 320.0
HUES_APART, HUE_REACH = 8, 9
"""Blobs are looked for in ranges of hues that overlap: this far apart, and reaching so far to either side."""

CHROMA_LEVELS = (20, 40, 70, 110)
"""In each range, among pixels whose channels differ by as many levels: vivid things touch paler ones of their hue."""

MAX_BLOBS_PER_HUE = 6
AREA_PX2, MAX_PICTURE_SHARE = 30, 0.3
RING_PX = 4
"""Width of the ring around a blob that its colour is compared with."""

APART_LEVELS = 5.0
"""A difference of the colours of a blob and its surroundings that begins to show, in levels of a* and b*."""

LARGE_PX = 30.0
"""Blobs of a greater radius are no better for that."""

OVERLAP = 0.7


class VividBlob(NamedTuple):
    """A blob with a colour of its own.

    Attributes:
        score: How much it looks like a ball: round, unlike its surroundings, vivid, large.
        place: The pixel that is deepest in it.
        radius_px: The radius of the smallest circle around it.
    """

    score: float
    place: Place
    radius_px: float


def vivid_blobs(image: Image, most: int) -> list[VividBlob]:
    """Return the blobs that look most like a ball, the best first; none of them in another."""
    scale = min(1.0, SEARCH_WIDTH_PX / max(image.shape[:2]))
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else image
    calm = cv2.GaussianBlur(small, (0, 0), 1.0)
    hsv, lab = cv2.cvtColor(calm, cv2.COLOR_BGR2HSV), cv2.cvtColor(calm, cv2.COLOR_BGR2LAB)
    chroma = cv2.multiply(cv2.extractChannel(hsv, 1), cv2.extractChannel(hsv, 2), scale=1 / 255)
    chosen: list[VividBlob] = []
    for blob in sorted(_blobs(hsv, lab, chroma), reverse=True):
        if all(math.dist(blob.place, other.place) > OVERLAP * max(blob.radius_px, other.radius_px) for other in chosen):
            chosen.append(blob)
        if len(chosen) == most:
            break
    return [_enlarged(blob, 1 / scale) for blob in chosen]


def _enlarged(blob: VividBlob, factor: float) -> VividBlob:
    x_px, y_px = blob.place
    return VividBlob(blob.score, ((x_px + 0.5) * factor - 0.5, (y_px + 0.5) * factor - 0.5), blob.radius_px * factor)


def _blobs(hsv: cv2.typing.MatLike, lab: cv2.typing.MatLike, chroma: cv2.typing.MatLike) -> Iterator[VividBlob]:
    hue = hsv[..., 0].astype(np.int16)
    for middle in range(0, 180, HUES_APART):
        is_near = np.abs((hue - middle + 90) % 180 - 90) <= HUE_REACH
        for least in CHROMA_LEVELS:
            mask = np.asarray(is_near & (chroma >= least), np.uint8)
            mask = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)), np.uint8)
            _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
            largest = 1 + np.argsort(-stats[1:, cv2.CC_STAT_AREA])[:MAX_BLOBS_PER_HUE]
            for label in largest.tolist():
                if AREA_PX2 <= stats[label, cv2.CC_STAT_AREA] <= MAX_PICTURE_SHARE * mask.size:
                    yield _blob(labels == label, stats[label], lab, chroma)


def _blob(is_in: np.ndarray, stats: np.ndarray, lab: cv2.typing.MatLike, chroma: cv2.typing.MatLike) -> VividBlob:
    x, y, width, height = (int(each) for each in stats[: cv2.CC_STAT_AREA])
    margin = RING_PX + 2
    top, left = max(0, y - margin), max(0, x - margin)
    part = (slice(top, y + height + margin), slice(left, x + width + margin))
    patch = is_in[part].astype(np.uint8)
    outlines, _ = cv2.findContours(patch, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(outlines, key=len)
    _, radius_px = cv2.minEnclosingCircle(outline)
    hull_px2 = cv2.contourArea(cv2.convexHull(outline))
    filled = min(1.0, (cv2.contourArea(outline) + len(outline) / 2) / (hull_px2 + 1))
    roundness = filled * hull_px2 / (math.pi * (radius_px + 0.5) ** 2)
    near = cv2.dilate(patch, np.ones((3, 3), np.uint8))
    ring = cv2.dilate(patch, np.ones((2 * RING_PX + 1,) * 2, np.uint8)) > near
    inside = np.median(lab[part][patch > 0], axis=0)
    outside = np.median(lab[part][ring], axis=0) if ring.any() else inside
    apart = math.hypot(*(inside - outside)[1:])
    vividness = math.sqrt(chroma[part][patch > 0].mean() / 255)
    depth = cv2.distanceTransform(cv2.copyMakeBorder(patch, 1, 1, 1, 1, cv2.BORDER_CONSTANT), cv2.DIST_L2, 3)
    row, column = divmod(int(np.argmax(depth)), depth.shape[1])
    return VividBlob(
        score=roundness**2 * math.log1p(apart / APART_LEVELS) * math.sqrt(min(radius_px, LARGE_PX)) * vividness,
        place=(left + column - 1.0, top + row - 1.0),
        radius_px=radius_px,
    )
