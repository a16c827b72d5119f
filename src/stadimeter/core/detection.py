"""The place of a target in the picture, or the reason why it is not there; and its shape, the size that is known."""

from __future__ import annotations

from enum import StrEnum
from typing import Protocol

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel

# The place of a target in the picture, or the reason why it is not there ----------------------------------------------

Points = NDArray[np.float64]

# Other arrays that detectors and ranging pass: of numbers, of truths, of indices, of light, and of 8 bits.
Values = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]
Profiles = NDArray[np.float32]
Plane = NDArray[np.uint8]


def no_points() -> Points:
    """Return an outline of nothing, shape ``(0, 2)``."""
    return np.empty((0, 2))


class DetectionStatus(StrEnum):
    """Result of looking for a target."""

    FOUND = "found"
    TRUNCATED = "truncated"
    """Found, but cut off by the border of the picture, so its size is not known."""
    PERHAPS = "perhaps"
    """Whole, and the best explanation of the picture, but so weakly seen that it may be another thing: people are told
    its distance. It moves and raises nothing until it has been the same thing over several frames (see
    `stadimeter.core.tracking`), or a person says that it is the target."""
    NOT_FOUND = "not_found"


class RejectedCandidate(Struct, frozen=True, kw_only=True):
    """Something in the picture that was looked at, and is not the target.

    Attributes:
        centre_px: Where it is, x and y.
        size_px: How large it is: the diameter of something round, the longer side of something flat.
        reason: The test that it failed, with the figure and the limit: ``edge scatters by 2.1 px, limit 1.0 px``.
        corners_px: Of something with corners, these in order around it; empty for the rest.
    """

    centre_px: tuple[float, float]
    size_px: float
    reason: str
    corners_px: tuple[tuple[float, float], ...] = ()

    @property
    def test(self) -> str:
        """The test that it failed, without the limit: ``edge scatters by 2.1 px``."""
        return self.reason.partition(", limit")[0]


class Detection(Struct, frozen=True, kw_only=True, eq=False):
    """The place of one target in one picture. Pixel coordinates have (0, 0) at the centre of the top left pixel.

    Attributes:
        reason: Why it was not found or is not whole, or may be another thing, in words with figures. With a target that
            was found it is mostly empty; there it is a remark, such as that of several tags in view the largest was
            taken.
        outline_px: Its outline, shape ``(n, 2)``, x and y in pixels: the four corners of a sheet in order around it,
            or points on the limb of a ball. Empty if it was not found.
        centre_px: The centre as x, y; meaningless if it was not found.
        width_px: The apparent width: of a sheet the mean of its two more horizontal sides, of a ball the smaller
            diameter of its outline, which gives the depth wherever in the picture the ball is.
        height_px: The apparent height: of a sheet the mean of its two more vertical sides, of a ball as the width.
        size_sigma_px: The standard deviation of the apparent size.
        quality: From 0, barely a candidate, to 1, as it should look.
        rejected: What else was looked at in the picture and is not the target, the most like it first.
        number: Which one of its kind it is, such as the number of a tag; None where they are all alike.
        measured_with: The camera model that it was measured with, if the detector has one: centre and size then say
            all that the outline does, for that camera.
    """

    target: str
    status: DetectionStatus
    reason: str = ""
    outline_px: Points = field(default_factory=no_points)
    centre_px: tuple[float, float] = (0.0, 0.0)
    width_px: float = 0.0
    height_px: float = 0.0
    size_sigma_px: float = 0.0
    quality: float = 0.0
    rejected: tuple[RejectedCandidate, ...] = ()
    number: int | None = None
    measured_with: CameraModel | None = None

    @property
    def is_whole(self) -> bool:
        """True if it is seen whole, so that it has a size: found, or perhaps."""
        return self.status in (DetectionStatus.FOUND, DetectionStatus.PERHAPS)


class Prediction(Struct, frozen=True, kw_only=True):
    """The place where a target is expected to be in the next picture.

    Attributes:
        size_px: Its apparent size: of a ball the diameter, of a flat target its longer side.
        sigma_px: Standard deviation of the centre and of the size.
        outline_px: Of a target with corners, where these are expected if it is turned as it was when it was last seen,
            shape ``(n, 2)``; None where that is not known.
    """

    centre_px: tuple[float, float]
    size_px: float
    sigma_px: float
    outline_px: Points | None = None


# Shapes of targets: the known size that turns pixels into metres ------------------------------------------------------
#
# A shape is all that the rest of the program knows of a kind of target. A detector brings it along as its
# `target_shape`; `stadimeter.ranging` has those of the built-in detectors, and a package of others adds its own by
# implementing `TargetShape`.


class Reading(Struct, frozen=True, kw_only=True):
    """Position of a target's centre, as its shape works it out from one detection.

    Attributes:
        position_m: In the camera frame: x to the right, y down, z along the optical axis.
        noise_share: Standard deviation of the distance that differs from frame to frame, as a share of the distance.
        systematic_share: The part that stays from frame to frame, without those of the focal length and of the size.
        tilt_rad: Of something flat, the angle between its normal and the line of sight, 0 for face on; else None.
        ambiguity: Of something flat, how far it is from certain which of two mirrored poses it has: 0 for certain, 1
            for no idea; else None.
    """

    position_m: tuple[float, float, float]
    noise_share: float
    systematic_share: float = 0.0
    tilt_rad: float | None = None
    ambiguity: float | None = None


class TargetShape(Protocol):
    """The size and form of a target.

    Facing the camera at the depth Z it appears ``extent / sqrt(Z² - r²)`` large per unit of depth, r being its
    `limb_radius_m`: so prediction and feasibility need no more than three lengths.
    """

    @property
    def label(self) -> str:
        """Its kind and size, for messages: ``ball of 0.064 m``."""
        ...

    @property
    def relative_sigma(self) -> float:
        """Standard deviation of its size, as a share: how well it is known."""
        ...

    @property
    def longest_m(self) -> float:
        """Its largest extent as it faces the camera."""
        ...

    @property
    def shortest_m(self) -> float:
        """Its smallest extent as it faces the camera, which limits from how far it can be found."""
        ...

    @property
    def limb_radius_m(self) -> float:
        """Radius of the sphere whose limb is its outline; 0 of something flat, whose outline is its rim."""
        ...

    @property
    def has_corners(self) -> bool:
        """True if the outline of a detection is its corners in order around it, False if points on a smooth rim."""
        ...

    def size_sigma_px(self, size_px: float) -> float:
        """Return the standard deviation of its apparent size in a sharp, evenly lit picture: the best to hope for.

        Args:
            size_px: How large its smallest extent appears.
        """
        ...

    def locate(self, detection: Detection, camera: CameraModel) -> Reading:
        """Return where its centre is.

        Args:
            detection: A target of this shape that was found whole, of finite width and height above zero.
            camera: The camera model at the picture's resolution.
        """
        ...
