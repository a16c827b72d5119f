"""The focal length of a camera, from pictures of a target at known distances.

The known distance is taken as the target's depth, the part of the distance along the optical axis: what a tape shows
that is held square to the wall with the sheet, and what F = P · D / W asks for. For a target in the middle of the
picture it is the straight line as well, so that is where to put it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from stadimeter.core.camera_model import CameraModel, Provenance
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.target import BallSize, TargetSize
from stadimeter.errors import CalibrationError
from stadimeter.ranging.apparent_size import ApparentSize, apparent_size
from stadimeter.ranging.similar_triangles import focal_length_px

DISTANCE_RELATIVE_SIGMA = 0.01
"""How well a distance is known that a person measures with a tape, as a share of it: 6 mm at 60 cm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownDistance:
    """A picture of a target at a known distance.

    Attributes:
        picture: The picture's name, for messages and notes.
        width_px: Width of the picture.
        height_px: Height of the picture.
        detection: Where the target is in it.
        size: The target's size.
        depth_m: How far the target's centre is from the camera, along the optical axis.
    """

    picture: str
    width_px: int
    height_px: int
    detection: Detection
    size: TargetSize
    depth_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FocalLength:
    """The focal length that one picture gives.

    Attributes:
        picture: The picture's name.
        apparent_px: How large the target appears, P.
        side: Which length of the target that is, such as ``longer side``.
        depth_m: How far away it is, D.
        size_m: How large it is, W.
        focal_px: The focal length, F.
        off_axis_rad: How far from the middle of the picture the target is.
        relative_sigma: The standard deviation of the focal length, as a share of it.
    """

    picture: str
    apparent_px: float
    side: str
    depth_m: float
    size_m: float
    focal_px: float
    off_axis_rad: float
    relative_sigma: float

    def __str__(self) -> str:
        """Return the figures as one line."""
        return (
            f"{self.picture}: P = {self.apparent_px:.2f} px, D = {self.depth_m:.4f} m, "
            f"W = {self.size_m:.4f} m ({self.side}), F = {self.focal_px:.2f} px"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """A camera model and what it came from.

    Attributes:
        camera_model: The model.
        pictures: The focal length that each picture gives, in the order of the pictures.
    """

    camera_model: CameraModel
    pictures: tuple[FocalLength, ...]


def calibrate(
    known: Sequence[KnownDistance], *, date: str, distance_relative_sigma: float = DISTANCE_RELATIVE_SIGMA
) -> Calibration:
    """Make a camera model: square pixels, and the optical axis through the middle of the picture.

    The focal length is the mean of what the pictures give, weighted by how sure each is of it. Its standard deviation
    is what follows from theirs, or from how far they differ if that is more.

    Args:
        known: One picture at least, all of one resolution. Those in which the target was not found whole are left out.
        date: ISO 8601 date of the calibration.
        distance_relative_sigma: Standard deviation of the known distances, as a share of each. Away from the middle of
            the picture, which way the tape was held adds to it.

    Returns:
        The model and the figures that it came from.

    Raises:
        CalibrationError: No picture can be used, or they differ in resolution.
    """
    if not known:
        raise CalibrationError("there is no picture to calibrate from; give at least one at a known distance")
    found = [each for each in known if each.detection.status is DetectionStatus.FOUND]
    if not found:
        reasons = "; ".join(f"{each.picture}: {each.detection.reason}" for each in known)
        raise CalibrationError(f"the target was found whole in none of the pictures: {reasons}")
    _check_resolutions(found)
    lengths = tuple(_focal_length(each, distance_relative_sigma) for each in found)
    focal_px, relative_sigma = _combined(lengths)
    model = CameraModel.with_focal_length(focal_px, found[0].width_px, found[0].height_px)
    method = "one picture at a known distance" if len(lengths) == 1 else f"{len(lengths)} pictures at known distances"
    provenance = Provenance(method=method, date=date, notes=tuple(str(each) for each in lengths))
    return Calibration(
        camera_model=replace(model, focal_relative_sigma=relative_sigma, provenance=provenance), pictures=lengths
    )


def _check_resolutions(known: Sequence[KnownDistance]) -> None:
    first = known[0]
    for other in known[1:]:
        if (other.width_px, other.height_px) != (first.width_px, first.height_px):
            raise CalibrationError(
                f"{first.picture} has {first.width_px}x{first.height_px} px, {other.picture} has "
                f"{other.width_px}x{other.height_px}; calibrate from pictures of one resolution"
            )


def _focal_length(known: KnownDistance, distance_relative_sigma: float) -> FocalLength:
    side = apparent_size(known.detection, known.size)
    focal_px = _focal_px(known, side)
    x, y = known.detection.centre_px
    off_axis_rad = math.atan(math.hypot(x - (known.width_px - 1) / 2, y - (known.height_px - 1) / 2) / focal_px)
    pixel_share = known.detection.size_sigma_px / side.apparent
    return FocalLength(
        picture=known.picture,
        apparent_px=side.apparent,
        side=side.name,
        depth_m=known.depth_m,
        size_m=side.size_m,
        focal_px=focal_px,
        off_axis_rad=off_axis_rad,
        relative_sigma=math.hypot(pixel_share, distance_relative_sigma, _tape_share(off_axis_rad)),
    )


def _focal_px(known: KnownDistance, side: ApparentSize) -> float:
    """Return F = P · D / W; of a ball, with the depth at which its outline, rather than its centre, is that large.

    The latter turns ``Z² = (W F / P)² + (W / 2)²`` around, see `stadimeter.ranging.measure`.
    """
    if not isinstance(known.size, BallSize):
        return focal_length_px(side.apparent, known.depth_m, side.size_m)
    radius_m = side.size_m / 2
    if known.depth_m <= radius_m:
        raise CalibrationError(
            f"{known.picture}: a camera {known.depth_m:g} m from the centre of a ball of {side.size_m:g} m would be "
            "inside it; check the distance and the ball's size"
        )
    return focal_length_px(side.apparent, math.sqrt(known.depth_m**2 - radius_m**2), side.size_m)


def _tape_share(off_axis_rad: float) -> float:
    """Return how uncertain it is which way the tape was held: half of what straight line and depth differ by."""
    return (1 / math.cos(off_axis_rad) - 1) / 2


def _combined(lengths: Sequence[FocalLength]) -> tuple[float, float]:
    """Return the weighted mean and its standard deviation as a share of it."""
    weights = [1 / max(each.focal_px * each.relative_sigma, 1e-9) ** 2 for each in lengths]
    total = sum(weights)
    mean = sum(weight * each.focal_px for weight, each in zip(weights, lengths, strict=True)) / total
    sigma = 1 / math.sqrt(total)
    if len(lengths) > 1:
        spread = math.sqrt(sum((each.focal_px - mean) ** 2 for each in lengths) / (len(lengths) - 1))
        sigma = max(sigma, spread / math.sqrt(len(lengths)))
    return mean, sigma / mean
