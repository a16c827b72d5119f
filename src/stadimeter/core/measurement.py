"""The distance of a target, for one frame."""

from __future__ import annotations

import math
from enum import StrEnum

from msgspec import Struct


class MeasurementStatus(StrEnum):
    """Result of measuring a target in one frame."""

    MEASURED = "measured"
    PERHAPS = "perhaps"
    """Measured, but it may be another thing; see `stadimeter.core.detection.DetectionStatus`."""
    NOT_FOUND = "not_found"
    TRUNCATED = "truncated"
    ERROR = "error"


class Measurement(Struct, frozen=True, kw_only=True):
    """The distance to one target in one frame, or why there is none.

    Distances and angles are None unless the status is ``measured`` or ``perhaps``.

    Attributes:
        captured_at_s: When the frame was taken, on the run's monotonic clock.
        distance_m: Length of the straight line from the camera to the target's centre.
        depth_m: The part of that line along the optical axis.
        sigma_m: Standard deviation of the distance, all known causes included.
        noise_m: The part of the standard deviation that differs from frame to frame; a filter can reduce this part
            and no other.
        bearing_rad: Angle from the optical axis, positive to the right.
        elevation_rad: Angle from the optical axis, positive upwards.
        tilt_rad: Of something flat, the angle between its normal and the line of sight, 0 for face on; None for a ball.
        ambiguity: Of something flat, how far it is from certain which of two mirrored poses it has: 0 for certain, 1
            for no idea; None for a ball.
        reason: Why there is no distance, or why it is perhaps that of another thing. With a distance it is mostly
            empty; there it is a remark, such as that size and floor contradict each other.
        size_share: Its larger extent in the picture, as a share of the picture's width; None for what was not seen in
            one.
    """

    target: str
    status: MeasurementStatus
    captured_at_s: float
    distance_m: float | None = None
    depth_m: float | None = None
    sigma_m: float | None = None
    noise_m: float | None = None
    bearing_rad: float | None = None
    elevation_rad: float | None = None
    tilt_rad: float | None = None
    ambiguity: float | None = None
    reason: str = ""
    size_share: float | None = None

    @property
    def position_m(self) -> tuple[float, float, float] | None:
        """Position of the target's centre in the camera frame: x right, y down, z forward."""
        if self.depth_m is None or self.bearing_rad is None or self.elevation_rad is None:
            return None
        x = self.depth_m * math.tan(self.bearing_rad)
        y = -math.hypot(self.depth_m, x) * math.tan(self.elevation_rad)
        return (x, y, self.depth_m)


class Sighting(Struct, frozen=True, kw_only=True):
    """A measurement that may be used: every figure is there and not beyond all sense.

    Attributes:
        at_s: Capture time.
        distance_m: The distance.
        noise_m: The part of the standard deviation that differs from frame to frame, as stated.
        scale_sigma: The part of the standard deviation that no filter can reduce, as a share of the distance.
        depth_share: Depth divided by distance.
        bearing_rad: The bearing.
        elevation_rad: The elevation.
        size_share: As in `Measurement`.
        remark: The reason of that.
        is_perhaps: Whether it may be of another thing.
    """

    at_s: float
    distance_m: float
    noise_m: float
    scale_sigma: float
    depth_share: float
    bearing_rad: float
    elevation_rad: float
    size_share: float | None = None
    remark: str = ""
    is_perhaps: bool = False
