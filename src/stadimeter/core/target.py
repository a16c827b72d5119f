"""Shapes of targets: the known size that turns pixels into metres.

A shape is all that the rest of the program knows of a kind of target. A detector brings it along as its `target_shape`;
`stadimeter.ranging` has those of the built-in detectors, and a package of others adds its own by implementing
`TargetShape`.
"""

from __future__ import annotations

from typing import Protocol

from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection


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
