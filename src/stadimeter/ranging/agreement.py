"""Whether pictures at known distances agree on one focal length, as far as they can be expected to.

Each picture gives a focal length, sure to within how well its distance and its edges are known (see
`stadimeter.ranging.calibration`). An edge bias makes those of small, far targets differ from those of large, near ones.
Two pictures fit any edge bias, so for this test it counts as what it mostly is: below 0.3 px. What remains is a
mistake: a distance measured from another point, a focus that moved, another thing taken for the target.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

from stadimeter.core.camera_model import UNKNOWN_EDGE_BIAS_SIGMA_PX, CameraModel
from stadimeter.ranging.calibration import FocalEstimate, KnownDistance, focal_estimate

ALLOWED_SIGMAS = 3.0
"""Pictures without a mistake disagree by more than this many standard deviations once in 400 times."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Disagreement:
    """Two pictures that contradict each other.

    Attributes:
        share: By how much the focal length of the farther one is larger, as a share of that of the nearer one.
        allowed_share: By how much it may be, either way.
        offset_m: By how much both distances would have to be longer for the two to agree.
    """

    nearer: KnownDistance
    farther: KnownDistance
    share: float
    allowed_share: float
    offset_m: float


def disagreement(known: Sequence[KnownDistance], *, distance_relative_sigma: float) -> Disagreement | None:
    """Return the two pictures that contradict each other most, or None if no two do.

    Args:
        known: Pictures of one resolution in which the target was found whole.
        distance_relative_sigma: Standard deviation of the known distances, as a share of each.
    """
    by_depth = sorted(known, key=lambda each: each.depth_m)
    pairs = [
        _compared(nearer, farther, distance_relative_sigma) for nearer, farther in itertools.combinations(by_depth, 2)
    ]
    worst = max(pairs, key=lambda each: abs(each.share) / each.allowed_share, default=None)
    return worst if worst is not None and abs(worst.share) > worst.allowed_share else None


def _compared(nearer: KnownDistance, farther: KnownDistance, distance_relative_sigma: float) -> Disagreement:
    plain = CameraModel.with_focal_length(float(nearer.width_px), nearer.width_px, nearer.height_px)
    near, far = (focal_estimate(each, plain, distance_relative_sigma) for each in (nearer, farther))
    sigma_share = math.hypot(
        near.sigma_px / near.focal_px,
        far.sigma_px / far.focal_px,
        UNKNOWN_EDGE_BIAS_SIGMA_PX * (far.per_bias / far.focal_px - near.per_bias / near.focal_px),
    )
    return Disagreement(
        nearer=nearer,
        farther=farther,
        share=far.focal_px / near.focal_px - 1,
        allowed_share=ALLOWED_SIGMAS * sigma_share,
        offset_m=_offset_m(nearer.depth_m, near, farther.depth_m, far),
    )


def _offset_m(near_m: float, near: FocalEstimate, far_m: float, far: FocalEstimate) -> float:
    """Return what would have to be added to both depths for equal focal lengths, which grow as F_i·(d_i + x)/d_i."""
    slope_px = near.focal_px / near_m - far.focal_px / far_m
    return (far.focal_px - near.focal_px) / slope_px if slope_px else math.inf
