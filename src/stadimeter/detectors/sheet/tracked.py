"""A sheet that was seen a moment ago: four short searches along where its sides are expected, and a look at its shape.

What counts against chance in a whole picture counts little here: something with four straight sides of a sheet's shape,
within some pixels of where the sheet was a moment ago, is the sheet. Its sides and its shape are judged in each frame
as in the search; whatever does not pass is left to the search.
"""

from __future__ import annotations

import math

import numpy as np

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points, Prediction
from stadimeter.core.frame import Image
from stadimeter.detectors.sampling import light_table
from stadimeter.detectors.sheet.candidates import SheetCandidate
from stadimeter.detectors.sheet.evidence import slack_share
from stadimeter.detectors.sheet.one_outline import OutlineSides, measure_outline
from stadimeter.detectors.sheet.search import (
    EXPECTED_SIZES,
    MISFIT_FACTOR,
    MISFIT_SIGMAS,
    SLACK_SIGMAS,
)
from stadimeter.detectors.sheet.side_tests import (
    MAX_BEND_PX,
    MAX_BEND_SHARE,
    MIN_CONTRAST,
    MIN_MEAN_SUPPORT,
    MIN_SUPPORT,
)
from stadimeter.detectors.sides import side_lengths
from stadimeter.ranging.flat import SheetShape
from stadimeter.ranging.plane_pose import rectangle_poses

# An outline that leads further out, or nowhere, is none.
MAX_COORDINATE_PX = 1e5


def follow(
    image: Image, expected: Prediction, size: SheetShape, min_side_px: float, lens: CameraModel
) -> SheetCandidate | None:
    """Return the sheet whose outline is expected; None where it is not found at once, or only one side is known."""
    outline_px, sigma_px = expected.outline_px, expected.sigma_px
    if outline_px is None or size.known_side != "auto" or not 0 < sigma_px < expected.size_px:
        return None
    if outline_px.shape != (4, 2) or not float(np.abs(outline_px).max()) < MAX_COORDINATE_PX:
        return None
    bent = lens if lens.distortion else None
    sides = measure_outline(image, outline_px, sigma_px, light_table(lens.tone_curve), bent)
    if sides is None or not _looks_whole(sides, expected, min_side_px):
        return None
    # The limit has two parts, in pixels: of the measurement, and of a sheet that is no exact rectangle.
    corner_px = sides.corner_sigma_px
    longest_px = max(side_lengths(sides.corners_px))
    limit_px = MISFIT_SIGMAS * corner_px + SLACK_SIGMAS * slack_share(size) * longest_px
    misfit_px = _misfit_px(sides.corners_px, size, lens, limit_px)
    if not misfit_px <= limit_px:
        return None
    return SheetCandidate(
        corners_px=sides.corners_px,
        corner_sigma_px=math.hypot(corner_px, MISFIT_FACTOR * misfit_px),
        is_brighter=bool(sides.contrast.sum() >= 0),
        quality=float(sides.support.mean()) * (1 - misfit_px / limit_px / 2),
    )


def _looks_whole(sides: OutlineSides, expected: Prediction, min_side_px: float) -> bool:
    """Return whether there are four straight sides that stand out all alike, about as long as expected."""
    lengths = side_lengths(sides.corners_px)
    low, high = (each * expected.size_px for each in EXPECTED_SIZES)
    if not low <= max(lengths) + 3 * expected.sigma_px or not max(lengths) - 3 * expected.sigma_px <= high:
        return False
    if min(lengths[0] + lengths[2], lengths[1] + lengths[3]) < 2 * min_side_px:
        return False
    contrasts = sides.contrast.tolist()
    stands_out = min(sides.colour_contrast.tolist()) >= MIN_CONTRAST
    is_one_kind = min(contrasts) >= 0 or max(contrasts) <= 0
    support = sides.support.tolist()
    is_seen = min(support) >= MIN_SUPPORT and sum(support) >= 4 * MIN_MEAN_SUPPORT
    is_straight = all(
        scatter <= max(MAX_BEND_PX, MAX_BEND_SHARE * length)
        for scatter, length in zip(sides.scatter_px.tolist(), lengths, strict=True)
    )
    return stands_out and is_one_kind and is_seen and is_straight


def _misfit_px(corners_px: Points, size: SheetShape, lens: CameraModel, enough_px: float) -> float:
    """Return how far corners are from those of the sheet, hung either way; not looked further once it is enough."""
    # Root mean square of the coordinates, as in the search, but from the pose itself: for one outline that is quicker.
    seen = lens.directions(corners_px).tolist()
    focal_px = math.sqrt(lens.fx_px * lens.fy_px)
    min_px = math.inf
    for width_m, height_m in ((size.width_m, size.height_m), (size.height_m, size.width_m)):
        poses = rectangle_poses(width_m / 2, height_m / 2, seen)
        min_px = min(min_px, poses[0].misfit * focal_px) if poses else min_px
        if min_px <= enough_px:
            break
    return min_px
