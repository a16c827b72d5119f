"""Agreement of pictures at known distances: with each other on one focal length, and with a camera model.

Each picture gives a focal length, sure to within how well its distance and its edges are known (see
`stadimeter.ranging.calibration`). An edge bias makes those of small, far targets differ from those of large, near ones.
Two pictures fit any edge bias, so for this test it counts as what it mostly is: below 0.3 px. What remains is a
mistake: a distance measured from another point, a focus that moved, another thing taken for the target.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Sequence
from statistics import NormalDist

from msgspec import Struct

from stadimeter.core.camera_model import UNKNOWN_EDGE_BIAS_SIGMA_PX, CameraModel
from stadimeter.errors import CalibrationError
from stadimeter.ranging.calibration import (
    FocalEstimate,
    KnownDistance,
    depth_shares,
    focal_estimate,
    measured_depth_m,
    off_axis_rad,
    tape_share,
)

# Sets of pictures without a mistake are found to contradict each other once in 400 times.
_BY_CHANCE = 1 / 400

# An offset of the distances beyond this is no mistake of the tape.
_NO_MISTAKE_M = 0.2

# An error beyond this many standard deviations comes by chance in 1 of 370 pictures.
PICTURE_LIMIT_SIGMAS = 3.0

# A mean error beyond this many standard deviations comes by chance in 1 of 80 checks.
MEAN_LIMIT_SIGMAS = 2.5


class Disagreement(Struct, frozen=True, kw_only=True):
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

    def __str__(self) -> str:
        """Say which they are, by how much they differ, and what usually causes it."""
        apart = (
            f"{self.nearer.picture} and {self.farther.picture} contradict each other: their focal lengths are"
            f" {abs(self.share):.1%} apart, and {self.allowed_share:.1%} is the most that tape and edges allow."
        )
        causes = (
            " Usual causes: the focus moved (switch autofocus off); a distance was not measured from the lens to the"
            " target's nearest point; the size is wrong; something else was found."
        )
        if abs(self.offset_m) > _NO_MISTAKE_M:
            return apart + causes
        longer = "longer" if self.offset_m > 0 else "shorter"
        return f"{apart}{causes} They would agree if both distances were {abs(self.offset_m) * 100:.1f} cm {longer}."


def split_outliers(
    known: Sequence[KnownDistance], *, distance_relative_sigma: float
) -> tuple[tuple[KnownDistance, ...], tuple[KnownDistance, ...]]:
    """Return the pictures that agree with each other, and the outliers: those that contradict most of the others.

    Args:
        known: Pictures of one resolution in which the target was found whole.
        distance_relative_sigma: Standard deviation of the known distances, as a share of each.

    Raises:
        CalibrationError: Outliers are half of the pictures or more, or two pictures contradict each other and the
            others do not tell which of them is wrong.
    """
    by_depth = sorted(range(len(known)), key=lambda at: known[at].depth_m)
    # Any focal length will do to begin with: `focal_estimate` finds by bisection the one that measures the known depth.
    plain = CameraModel.with_focal_length(float(known[0].width_px), known[0].width_px, known[0].height_px)
    estimates = [focal_estimate(each, plain, distance_relative_sigma) for each in known]
    pairs = list(itertools.combinations(by_depth, 2))
    # The more pairs are compared, the farther apart two may be by chance: 3.0 standard deviations for one pair, 3.8
    # for fifteen (Bonferroni's correction).
    allowed_sigmas = NormalDist().inv_cdf(1 - _BY_CHANCE / 2 / max(len(pairs), 1))
    at_odds: dict[tuple[int, int], Disagreement] = {}
    for near, far in pairs:
        found = _compare((known[near], estimates[near]), (known[far], estimates[far]), allowed_sigmas)
        if abs(found.share) > found.allowed_share:
            at_odds[near, far] = found
    kept = list(range(len(known)))
    while at_odds:
        times = Counter(itertools.chain.from_iterable(at_odds))
        worst, contradicted = max(times.items(), key=lambda each: each[1])
        kept.remove(worst)
        if 2 * contradicted <= len(kept) or 2 * len(kept) <= len(known):
            raise CalibrationError(str(max(at_odds.values(), key=lambda each: abs(each.share) / each.allowed_share)))
        at_odds = {pair: found for pair, found in at_odds.items() if worst not in pair}
    return tuple(known[at] for at in kept), tuple(each for at, each in enumerate(known) if at not in kept)


def _compare(
    nearer: tuple[KnownDistance, FocalEstimate], farther: tuple[KnownDistance, FocalEstimate], allowed_sigmas: float
) -> Disagreement:
    near, far = nearer[1], farther[1]
    # Standard deviation of ln F_far - ln F_near: both pictures' own, and an edge bias of unknown size, which acts on
    # the difference of how much it changes each (per_bias, in px of F a px of bias).
    sigma_share = math.hypot(
        near.sigma_px / near.focal_px,
        far.sigma_px / far.focal_px,
        UNKNOWN_EDGE_BIAS_SIGMA_PX * (far.per_bias / far.focal_px - near.per_bias / near.focal_px),
    )
    return Disagreement(
        nearer=nearer[0],
        farther=farther[0],
        share=far.focal_px / near.focal_px - 1,
        allowed_share=allowed_sigmas * sigma_share,
        offset_m=_offset_m(nearer[0].depth_m, near, farther[0].depth_m, far),
    )


def _offset_m(near_m: float, near: FocalEstimate, far_m: float, far: FocalEstimate) -> float:
    """Return the offset to add to both depths for equal focal lengths, which grow as F_i·(d_i + x)/d_i."""
    slope_px = near.focal_px / near_m - far.focal_px / far_m
    return (far.focal_px - near.focal_px) / slope_px if slope_px else math.inf


class DistanceError(Struct, frozen=True, kw_only=True):
    """The error of the distance of one picture."""

    picture: str
    depth_m: float
    measured_m: float
    error_share: float  # what was measured, less what is known, as a share of the latter
    sigma_share: float  # the standard deviation that measurement and tape allow, as a share of the known depth

    @property
    def sigmas(self) -> float:
        """The error in standard deviations."""
        return self.error_share / self.sigma_share

    @property
    def is_outside(self) -> bool:
        """True if the error is more than the standard deviation allows."""
        return abs(self.sigmas) > PICTURE_LIMIT_SIGMAS


class CalibrationCheck(Struct, frozen=True, kw_only=True):
    """The accuracy of a camera model on new pictures of known distance."""

    pictures: tuple[DistanceError, ...]  # one for each picture, in their order
    bias_share: float  # the mean error, as a share of the distance
    bias_sigma_share: float  # the standard deviation that the mean may have, what all pictures have in common included

    @property
    def bias_is_outside(self) -> bool:
        """True if the mean error is more than its standard deviation allows."""
        return abs(self.bias_share) > MEAN_LIMIT_SIGMAS * self.bias_sigma_share

    @property
    def is_sound(self) -> bool:
        """True if all errors are within what the standard deviations allow."""
        return not (self.bias_is_outside or any(each.is_outside for each in self.pictures))


def check_calibration(
    known: Sequence[KnownDistance], model: CameraModel, *, distance_relative_sigma: float
) -> CalibrationCheck:
    """Compare what a camera model measures with what is known.

    Args:
        known: One picture at least, in which the target was found whole; of any resolution of the model's aspect.
        distance_relative_sigma: Standard deviation of the known distances, as a share of each.

    Raises:
        CalibrationError: There is no picture, or one has another aspect than the camera model.
    """
    if not known:
        raise CalibrationError("there is no picture to check with; give at least one at a known distance")
    errors, own_shares, common_shares = [], [], []
    for each in known:
        here = model.scaled_to(each.width_px, each.height_px)
        noise_share, lasting_share = depth_shares(each, here)
        own_shares.append(math.hypot(noise_share, distance_relative_sigma, tape_share(off_axis_rad(each, here))))
        common_shares.append(lasting_share)
        errors.append(_error(each, here, math.hypot(own_shares[-1], lasting_share)))
    return CalibrationCheck(
        pictures=tuple(errors),
        bias_share=sum(each.error_share for each in errors) / len(errors),
        # Own errors (noise, tape) average out over n pictures, σ = √Σ own² / n; common ones (lens, size of the target)
        # do not.
        bias_sigma_share=math.hypot(math.hypot(*own_shares) / len(errors), max(common_shares)),
    )


def _error(known: KnownDistance, model: CameraModel, sigma_share: float) -> DistanceError:
    measured_m = measured_depth_m(known, model)
    return DistanceError(
        picture=known.picture,
        depth_m=known.depth_m,
        measured_m=measured_m,
        error_share=measured_m / known.depth_m - 1,
        sigma_share=max(sigma_share, 1e-6),
    )
