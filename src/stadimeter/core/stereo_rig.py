"""Two cameras that are fixed to each other: their lenses, where the right one is, and how well all that is known."""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.core.camera_model import PARAMETERS, CameraModel, LensUncertainty, Provenance
from stadimeter.core.detection import Values
from stadimeter.core.frame import Frame
from stadimeter.errors import CalibrationError

# The unknowns of two cameras, in the order of the covariance: of the left lens, of the right one, and the pose.
OF_LENS = len(PARAMETERS)
OF_POSE = slice(2 * OF_LENS, 2 * OF_LENS + 6)
UNKNOWNS = 2 * OF_LENS + 6

Triple = tuple[float, float, float]


class StereoRig(Struct, frozen=True, kw_only=True, eq=False):  # noqa: PLW1641 - it is no key
    """Two cameras that are fixed to each other.

    A point p of the right camera's frame is at ``place + R p`` in that of the left one, x to the right, y down, z
    forward, where R is the rotation by `turn_rad`.

    Attributes:
        turn_rad: How the right camera is turned, as a rotation vector: an axis times the angle.
        place_m: Where the right camera is in the left one's frame.
        covariance: That of the parameters of the left lens, of the right lens, `turn_rad` and `place_m` together, shape
            ``(24, 24)``. An error of a lens and one of the turn mostly cancel, since both come from the same pictures.
    """

    left: CameraModel
    right: CameraModel
    turn_rad: Triple
    place_m: Triple
    covariance: Values
    provenance: Provenance = field(default_factory=Provenance)

    def __eq__(self, other: object) -> bool:
        """Check whether all figures are the same."""
        return isinstance(other, StereoRig) and all(
            np.array_equal(getattr(self, name), getattr(other, name)) for name in self.__struct_fields__
        )

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.turn_rad, *self.place_m))) or not self.baseline_m > 0:
            raise CalibrationError("the two cameras are in one place, so nothing can be triangulated", "place_m")

    @property
    def baseline_m(self) -> float:
        """Distance between the cameras."""
        return math.hypot(*self.place_m)

    @property
    def baseline_sigma_m(self) -> float:
        """Standard deviation of the baseline."""
        along = np.array(self.place_m) / self.baseline_m
        return math.sqrt(max(float(along @ self.covariance[-3:, -3:] @ along), 0.0))

    def for_frames(self, left: Frame, right: Frame) -> StereoRig:
        """Return the rig at the resolutions of two frames; `CalibrationError` if a lens does not fit its frame."""
        scale = np.ones(UNKNOWNS)
        lenses = []
        for side, (name, lens, frame) in enumerate((("left", self.left, left), ("right", self.right, right))):
            try:
                lenses.append(lens.for_frame(frame))
            except CalibrationError as error:
                raise CalibrationError(f"the {name} camera of the stereo file: {error}") from error
            ratio = frame.width_px / lens.width_px, frame.height_px / lens.height_px
            scale[side * OF_LENS : side * OF_LENS + 4] = (*ratio, *ratio)
        covariance = self.covariance * np.outer(scale, scale)
        return replace(self, left=lenses[0], right=lenses[1], covariance=covariance)


def with_uncertainties(rig: StereoRig) -> StereoRig:
    """Return a rig whose lenses know their own part of the covariance, as a camera file has it."""
    lenses = []
    for side, lens in enumerate((rig.left, rig.right)):
        own = slice(side * OF_LENS, (side + 1) * OF_LENS)
        covariance = rig.covariance[own, own]
        share = math.sqrt(max(covariance[0, 0] / lens.fx_px**2, covariance[1, 1] / lens.fy_px**2))
        lenses.append(replace(lens, uncertainty=LensUncertainty.of(covariance), focal_relative_sigma=share))
    return replace(rig, left=lenses[0], right=lenses[1])
