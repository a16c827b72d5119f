"""How wrong a camera model is, from new pictures of a target at known distances."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from stadimeter.core.camera_model import CameraModel
from stadimeter.errors import CalibrationError
from stadimeter.ranging.calibration import KnownDistance, depth_shares, measured_depth_m, off_axis_rad, tape_share

PICTURE_LIMIT_SIGMAS = 3.0
"""An error beyond this many standard deviations comes by chance in 1 of 370 pictures."""

MEAN_LIMIT_SIGMAS = 2.5
"""A mean error beyond this many standard deviations comes by chance in 1 of 80 checks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DistanceError:
    """How wrong the distance of one picture is."""

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
        """Whether the error is more than the standard deviation allows."""
        return abs(self.sigmas) > PICTURE_LIMIT_SIGMAS


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationCheck:
    """What new pictures say about a camera model."""

    pictures: tuple[DistanceError, ...]  # one for each picture, in their order
    bias_share: float  # the mean error, as a share of the distance
    bias_sigma_share: float  # the standard deviation that the mean may have, what all pictures have in common included

    @property
    def bias_is_outside(self) -> bool:
        """Whether the mean error is more than its standard deviation allows."""
        return abs(self.bias_share) > MEAN_LIMIT_SIGMAS * self.bias_sigma_share

    @property
    def is_sound(self) -> bool:
        """Whether all errors are within what the standard deviations allow."""
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
