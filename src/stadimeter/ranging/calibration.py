"""The focal length and the edge bias of a camera, from pictures of a target at known distances.

The known distance is taken as the target's depth, the part of the distance along the optical axis: what a tape shows
that is held square to the wall with the sheet. For a target in the middle of the picture it is the straight line as
well, so that is where to put it.

Each picture gives the focal length with which `stadimeter.ranging.measure` measures just the known depth; so whatever
that takes into account, such as a ball's perspective or a sheet's tilt, is taken into account here.

Several are combined as follows. Every picture gives a focal length F_i. If each edge is measured b pixels too far out,
that is too much by the share 2·b / P_i, P_i being how large the target appears: much where it is small and far away,
little where it is large and near. So with s_i = 2·F_i / P_i, by how much F_i is too large for each pixel of bias, all
pictures agree on

    F = F_i - s_i · b

which is linear in F and b; weighted least squares gives both (Press et al., Numerical Recipes, 3rd ed., 15.4).
"""

from __future__ import annotations

import itertools
import math
import statistics
from collections import Counter
from collections.abc import Sequence
from statistics import NormalDist

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import UNKNOWN_EDGE_BIAS_SIGMA_PX, CameraModel, Provenance
from stadimeter.core.detection import Detection, DetectionStatus, TargetShape, Values
from stadimeter.errors import CalibrationError
from stadimeter.ranging.measure import measure

# Edge biases are mostly below this; a fit that is less sure of its bias than this says less than to assume none.
BIAS_SIGMA_LIMIT_PX = 0.3

# How well a distance is known that a person measures with a tape, as a share of it: 6 mm at 60 cm.
DISTANCE_RELATIVE_SIGMA = 0.01

# A focal length less sure than this is no calibration.
FOCAL_SIGMA_MAX = 0.3

# The focal length is found by bisection; this many halvings of a factor of two leave a relative error of 1e-13.
_DOUBLINGS = 30
_HALVINGS = 44

# The edge bias with which detectors are asked what an edge bias changes.
BIAS_STEP_PX = 0.25

# Distances that differ by less than this factor count as one.
_ONE_DISTANCE = 1.05


class FocalEstimate(Struct, frozen=True, kw_only=True):
    """The focal length that one picture gives."""

    focal_px: float  # the focal length if there is no edge bias, F_i
    sigma_px: float  # its standard deviation
    per_bias: float  # by how much it is too large for each pixel of edge bias, s_i


class FocalFit(Struct, frozen=True, kw_only=True):
    """The focal length and the edge bias from all pictures."""

    focal_px: float
    focal_sigma_px: float  # its standard deviation: what follows from that of the pictures, or more if they disagree
    edge_bias_px: float  # the edge bias; 0 where the pictures do not tell it
    # Its standard deviation from these pictures, whether or not it was used; infinite where all are at one
    # distance.
    edge_bias_sigma_px: float
    bias_was_fitted: bool  # whether the pictures tell the edge bias


def fit_focal_length(estimates: Sequence[FocalEstimate]) -> FocalFit:
    """Combine the focal lengths of one picture or more, with the edge bias if they tell it."""
    focal_px, weights = _columns(estimates)
    bias_sigma_px = edge_bias_sigma_px(estimates)
    together = np.column_stack((np.ones_like(focal_px), [each.per_bias for each in estimates]))
    (focal, bias), covariance, is_fitted = (0.0, 0.0), together, False
    if bias_sigma_px <= BIAS_SIGMA_LIMIT_PX:
        (focal, bias), covariance = _solve(together, focal_px, weights)
        bias_sigma_px = math.sqrt(covariance[1, 1])
        is_fitted = bias_sigma_px <= BIAS_SIGMA_LIMIT_PX
    if not is_fitted:
        (focal,), covariance = _solve(together[:, :1], focal_px, weights)
    return FocalFit(
        focal_px=float(focal),
        focal_sigma_px=math.sqrt(covariance[0, 0]),
        edge_bias_px=float(bias) if is_fitted else 0.0,
        edge_bias_sigma_px=bias_sigma_px,
        bias_was_fitted=is_fitted,
    )


def edge_bias_sigma_px(estimates: Sequence[FocalEstimate]) -> float:
    """Estimate how well pictures tell the edge bias, before it is known whether they agree; infinite if they do not."""
    _, weights = _columns(estimates)
    per_bias = np.array([each.per_bias for each in estimates])
    mean = float(np.average(per_bias, weights=weights))
    information = float(np.sum(weights * (per_bias - mean) ** 2))
    return 1 / math.sqrt(information) if information > 1e-12 * float(np.sum(weights)) * mean**2 else math.inf


def _columns(estimates: Sequence[FocalEstimate]) -> tuple[Values, Values]:
    focal_px = np.array([each.focal_px for each in estimates])
    sigma_px = np.maximum([each.sigma_px for each in estimates], 1e-9 * focal_px)
    return focal_px, 1 / sigma_px**2


def _solve(design: Values, values: Values, weights: Values) -> tuple[Values, Values]:
    """Return the weighted least squares solution and its covariance, widened where the values disagree."""
    covariance = np.linalg.inv(design.T @ (design * weights[:, None])).astype(np.float64)
    solution = covariance @ (design.T @ (weights * values))
    spare = len(values) - design.shape[1]
    if spare == 0:
        return solution, covariance
    # Reduced chi-square: where the pictures disagree by more than their σ says, all σ grow alike; they never shrink.
    disagreement = float(np.sum(weights * (values - design @ solution) ** 2)) / spare
    return solution, covariance * max(1.0, disagreement)


class KnownDistance(Struct, frozen=True, kw_only=True):
    """A picture of a target at a known distance."""

    picture: str  # the picture's name, for messages and notes
    width_px: int
    height_px: int
    detection: Detection  # where the target is in it
    size: TargetShape
    depth_m: float  # how far the target's centre is from the camera, along the optical axis
    # Where the target is found with a camera model that has an edge bias of `BIAS_STEP_PX`. What that changes
    # depends on the target, bright or dark, so the detector says it; None if it was not asked.
    less_bias: Detection | None = None
    is_confirmed: bool = False  # whether a person says that what is perhaps the target is it

    @property
    def is_usable(self) -> bool:
        """True if the target was found whole, or perhaps, and a person says that it is it."""
        return self.detection.is_whole if self.is_confirmed else self.detection.status is DetectionStatus.FOUND


class FocalLength(Struct, frozen=True, kw_only=True):
    """The focal length that one picture gives, and how well the camera model made from all fits it."""

    picture: str
    width_px: float
    height_px: float
    depth_m: float
    focal_px: float  # the focal length, with the edge bias of the model undone
    relative_sigma: float  # the standard deviation of the focal length, as a share of it
    off_axis_rad: float  # how far from the middle of the picture the target is
    residual_share: float  # what the model measures in this picture, less the known depth, as a share of that

    @property
    def reads(self) -> str:
        """The distance that the model measures in this picture, in words."""
        return f"reads {round(self.residual_share, 4) + 0.0:+.2%}"  # adding zero turns -0.0 into 0.0

    def __str__(self) -> str:
        """Return the figures as one line."""
        return (
            f"{self.picture}: {self.width_px:.2f} x {self.height_px:.2f} px at {self.depth_m:.4f} m, "
            f"F = {self.focal_px:.2f} px, {self.reads}"
        )


class Calibration(Struct, frozen=True, kw_only=True):
    """A camera model and what it came from."""

    camera_model: CameraModel
    pictures: tuple[FocalLength, ...]  # the focal length that each picture gives, in the order of the pictures
    fit: FocalFit
    one_distance: bool  # whether all pictures are at one distance, where an edge bias looks like another focal length


def calibrate(
    known: Sequence[KnownDistance], *, date: str, distance_relative_sigma: float = DISTANCE_RELATIVE_SIGMA
) -> Calibration:
    """Make a camera model: square pixels, and the optical axis through the middle of the picture.

    Args:
        known: One picture at least, all of one resolution. Those in which the target was not found whole are left out.
        date: ISO 8601 date of the calibration.
        distance_relative_sigma: Standard deviation of the known distances, as a share of each. Away from the middle of
            the picture, which way the tape was held adds to it.

    Raises:
        CalibrationError: No picture can be used, they differ in resolution, or they do not tell the focal length.
        ValueError: A depth is not a finite number above zero.
    """
    found = _pick_usable(known)
    plain = CameraModel.with_focal_length(float(found[0].width_px), found[0].width_px, found[0].height_px)
    estimates = [focal_estimate(each, plain, distance_relative_sigma) for each in found]
    fit = fit_focal_length(estimates)
    share = math.hypot(fit.focal_sigma_px / fit.focal_px, _lasting_share(found, plain))
    if share > FOCAL_SIGMA_MAX:
        raise CalibrationError(
            f"the pictures do not tell the focal length: {fit.focal_px:.0f} px ± {share:.0%}; check that what was "
            "found is the target (`stadimeter measure --annotate`), and the distances"
        )
    model = replace(
        plain,
        fx_px=fit.focal_px,
        fy_px=fit.focal_px,
        edge_bias_px=fit.edge_bias_px,
        edge_bias_sigma_px=fit.edge_bias_sigma_px if fit.bias_was_fitted else UNKNOWN_EDGE_BIAS_SIGMA_PX,
        focal_relative_sigma=share,
    )
    pictures = tuple(_focal_length(each, one, model) for each, one in zip(found, estimates, strict=True))
    return Calibration(
        camera_model=replace(model, provenance=_provenance(pictures, date)),
        pictures=pictures,
        fit=fit,
        one_distance=max(each.depth_m for each in found) < _ONE_DISTANCE * min(each.depth_m for each in found),
    )


def rough_model(known: Sequence[KnownDistance]) -> CameraModel:
    """Return a camera model of the median of what the pictures say, whatever single ones show: to look again through.

    Raises:
        CalibrationError: No picture can be used, or they differ in resolution.
    """
    found = _pick_usable(known)
    plain = CameraModel.with_focal_length(float(found[0].width_px), found[0].width_px, found[0].height_px)
    return _with_focal_length(plain, statistics.median(_focal_px(each, plain) for each in found))


def with_readings(made: Calibration, again: Sequence[KnownDistance]) -> Calibration:
    """Return a calibration with what its camera model reads in its pictures, in which it was found through that model.

    Until then the readings are computed from what was found before, through another model. Where an edge bias is large,
    or the edges are unsure, the detector finds other edges through this one.
    """
    pictures = tuple(
        replace(one, residual_share=measured_depth_m(each, made.camera_model) / each.depth_m - 1)
        for one, each in zip(made.pictures, again, strict=True)
    )
    model = replace(made.camera_model, provenance=_provenance(pictures, made.camera_model.provenance.date))
    return replace(made, pictures=pictures, camera_model=model)


def _pick_usable(known: Sequence[KnownDistance]) -> list[KnownDistance]:
    if not known:
        raise CalibrationError("there is no picture to calibrate from; give at least one at a known distance")
    found = [each for each in known if each.is_usable]
    if not found:
        reasons = "; ".join(f"{each.picture}: {each.detection.reason}" for each in known)
        raise CalibrationError(f"the target was found whole in none of the pictures: {reasons}")
    for each in found:
        _check(each, found[0])
    return found


def _check(known: KnownDistance, first: KnownDistance) -> None:
    if not (math.isfinite(known.depth_m) and known.depth_m > 0):
        raise ValueError(f"{known.picture}: depth_m = {known.depth_m} is not a finite number above zero")
    if (known.width_px, known.height_px) != (first.width_px, first.height_px):
        raise CalibrationError(
            f"{first.picture} has {first.width_px}x{first.height_px} px, {known.picture} has "
            f"{known.width_px}x{known.height_px}; calibrate from pictures of one resolution"
        )
    if known.depth_m <= known.size.limb_radius_m:
        raise CalibrationError(
            f"{known.picture}: a camera {known.depth_m:g} m from the centre of a {known.size.label} would be inside "
            "it; check the distance and the target's size"
        )


def focal_estimate(known: KnownDistance, plain: CameraModel, distance_relative_sigma: float) -> FocalEstimate:
    """Return the focal length that one picture gives; that of the plain model is a first guess."""
    focal_px = _focal_px(known, plain)
    with_it = _with_focal_length(plain, focal_px)
    noise_share, _ = depth_shares(known, with_it)
    # Independent: edges, tape, and which way the tape was held.
    share = math.hypot(noise_share, distance_relative_sigma, tape_share(off_axis_rad(known, with_it)))
    return FocalEstimate(focal_px=focal_px, sigma_px=focal_px * share, per_bias=_per_bias(known, plain, focal_px))


def _per_bias(known: KnownDistance, plain: CameraModel, focal_px: float) -> float:
    """Return by how much the focal length is too large for each pixel of edge bias; 0 where that is not known."""
    if known.less_bias is None or not known.less_bias.is_whole:
        return 0.0
    without_it_px = _focal_px(replace(known, detection=known.less_bias), plain)
    return (focal_px - without_it_px) / BIAS_STEP_PX


def _focal_px(known: KnownDistance, plain: CameraModel) -> float:
    """Return the focal length with which the known depth is measured: a larger one always gives a larger depth."""
    low_px = high_px = plain.fx_px
    # First enclose it between two focal lengths of which the larger measures too far, the smaller too near.
    for _ in range(_DOUBLINGS):
        if measured_depth_m(known, _with_focal_length(plain, high_px)) >= known.depth_m:
            break
        low_px, high_px = high_px, 2 * high_px
    for _ in range(_DOUBLINGS):
        if measured_depth_m(known, _with_focal_length(plain, low_px)) <= known.depth_m:
            break
        low_px, high_px = low_px / 2, low_px
    # The geometric mean, since a focal length is a scale: the relative error halves with each step.
    for _ in range(_HALVINGS):
        middle_px = math.sqrt(low_px * high_px)
        if measured_depth_m(known, _with_focal_length(plain, middle_px)) < known.depth_m:
            low_px = middle_px
        else:
            high_px = middle_px
    return math.sqrt(low_px * high_px)


def _with_focal_length(model: CameraModel, focal_px: float) -> CameraModel:
    return replace(model, fx_px=focal_px, fy_px=focal_px)


def measured_depth_m(known: KnownDistance, model: CameraModel) -> float:
    """Return the depth that a camera model measures in a picture in which the target was found whole.

    Raises:
        CalibrationError: There is none.
    """
    measured = measure(known.detection, known.size, model, 0.0)
    if measured.depth_m is None:
        raise CalibrationError(f"{known.picture}: the target cannot be measured: {measured.reason}")
    return measured.depth_m


def depth_shares(known: KnownDistance, model: CameraModel) -> tuple[float, float]:
    """Return the standard deviation of the distance as shares: what differs from frame to frame, and what stays."""
    measured = measure(known.detection, known.size, model, 0.0)
    distance_m, sigma_m, noise_m = measured.distance_m or math.inf, measured.sigma_m or 0.0, measured.noise_m or 0.0
    return noise_m / distance_m, math.sqrt(max(0.0, sigma_m**2 - noise_m**2)) / distance_m


def off_axis_rad(known: KnownDistance, model: CameraModel) -> float:
    """Return the angle between the optical axis and the line to the target's centre."""
    return math.atan(math.hypot(*model.direction(*known.detection.centre_px)))


def tape_share(off_axis_rad: float) -> float:
    """Return the uncertainty of which way the tape was held: half of what straight line and depth differ by."""
    return (1 / math.cos(off_axis_rad) - 1) / 2


def _lasting_share(known: Sequence[KnownDistance], model: CameraModel) -> float:
    """Return the share common to all pictures, such as an error of the target's size; more pictures do not help."""
    return max(depth_shares(each, model)[1] for each in known)


def _focal_length(known: KnownDistance, estimate: FocalEstimate, model: CameraModel) -> FocalLength:
    focal_px = estimate.focal_px - estimate.per_bias * model.edge_bias_px
    return FocalLength(
        picture=known.picture,
        width_px=known.detection.width_px,
        height_px=known.detection.height_px,
        depth_m=known.depth_m,
        focal_px=focal_px,
        relative_sigma=estimate.sigma_px / estimate.focal_px,
        off_axis_rad=off_axis_rad(known, model),
        residual_share=model.fx_px / focal_px - 1,
    )


def _provenance(pictures: Sequence[FocalLength], date: str) -> Provenance:
    method = "one picture at a known distance" if len(pictures) == 1 else f"{len(pictures)} pictures at known distances"
    return Provenance(method=method, date=date, notes=tuple(str(each) for each in pictures))


# Agreement of pictures at known distances: with each other on one focal length, and with a camera model ---------------
#
# Each picture gives a focal length, sure to within how well its distance and its edges are known (see
# `stadimeter.ranging.calibration`). An edge bias makes those of small, far targets differ from those of large, near
# ones. Two pictures fit any edge bias, so for this test it counts as what it mostly is: below 0.3 px. What remains
# is a mistake: a distance measured from another point, a focus that moved, another thing taken for the target.

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


def check_agreement(known: Sequence[KnownDistance], *, distance_relative_sigma: float) -> None:
    """Check that pictures of one resolution, in which the target was found whole, agree with each other.

    Args:
        distance_relative_sigma: Standard deviation of the known distances, as a share of each.

    Raises:
        CalibrationError: They do not. It names the two that contradict each other most, and the fewer than half, if
            there are such, that contradict the most others.
    """
    by_depth = sorted(known, key=lambda each: each.depth_m)
    # Any focal length will do to begin with: `focal_estimate` finds by bisection the one that measures the known depth.
    plain = CameraModel.with_focal_length(float(known[0].width_px), known[0].width_px, known[0].height_px)
    estimates = [(each, focal_estimate(each, plain, distance_relative_sigma)) for each in by_depth]
    pairs = list(itertools.combinations(estimates, 2))
    # The more pairs are compared, the farther apart two may be by chance: 3.0 standard deviations for one pair, 3.8
    # for fifteen (Bonferroni's correction).
    allowed_sigmas = NormalDist().inv_cdf(1 - _BY_CHANCE / 2 / max(len(pairs), 1))
    compared = [_compare(near, far, allowed_sigmas) for near, far in pairs]
    at_odds = [each for each in compared if abs(each.share) > each.allowed_share]
    if not at_odds:
        return
    worst = max(at_odds, key=lambda each: abs(each.share) / each.allowed_share)
    times = Counter(side.picture for each in at_odds for side in (each.nearer, each.farther))
    suspects = [name for name, count in times.items() if count == max(times.values())]
    words = f" Most at odds with the others: {', '.join(suspects)}." if 2 * len(suspects) < len(known) else ""
    raise CalibrationError(f"{worst}{words}")


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
