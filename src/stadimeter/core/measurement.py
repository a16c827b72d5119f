"""The distance of a target: for one frame, and over time."""

from __future__ import annotations

import math
from enum import StrEnum

from msgspec import Struct

# The distance of a target, for one frame ------------------------------------------------------------------------------


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


# A target over time ---------------------------------------------------------------------------------------------------


class TrackStatus(StrEnum):
    """Stage of a target in its life."""

    SEARCHING = "searching"
    """It has not been seen yet."""
    TRACKING = "tracking"
    """It was measured in the newest frame, or is confirmed and was measured a moment ago."""
    COASTING = "coasting"
    """It was not measured in the newest frames; its distance is a prediction, less sure with each frame."""
    LOST = "lost"
    """It has not been measured for too long. Its figures are the last ones known and move nothing."""


class Track(Struct, frozen=True, kw_only=True):
    """The filtered distance to one target. Figures are None until the target was seen.

    Attributes:
        status: Where it is in its life.
        distance_m: Filtered distance, at `as_of_s`.
        depth_m: The part of it along the optical axis.
        closing_mps: Speed of approach, positive when the distance shrinks.
        sigma_m: Standard deviation of the distance, all known causes included.
        noise_m: The part of it that differs from frame to frame, after the filter; None if it is not known apart.
        closing_sigma_mps: Standard deviation of the speed of approach.
        bearing_rad: Bearing of the newest sighting, positive to the right.
        elevation_rad: Elevation of the newest sighting, positive upwards.
        as_of_s: The capture time that the figures are for.
        measured_at_s: The capture time of the last measurement that was accepted.
        rejected: How many measurements in a row were refused as outliers.
        reason: Why it is not tracked, why the newest measurement was refused, or a remark on it.
        since_s: Since when it has been in sight, or out of sight, without a break; None before the first cycle.
        closing_cov_m2ps: Covariance of the distance and the speed of approach; None until the target was seen.
        noise_factor: How many times larger than stated its noise was found to be; see `core.tracking.motion`.
    """

    target: str
    status: TrackStatus = TrackStatus.SEARCHING
    distance_m: float | None = None
    depth_m: float | None = None
    closing_mps: float | None = None
    sigma_m: float | None = None
    noise_m: float | None = None
    closing_sigma_mps: float | None = None
    bearing_rad: float | None = None
    elevation_rad: float | None = None
    as_of_s: float | None = None
    measured_at_s: float | None = None
    rejected: int = 0
    reason: str = ""
    since_s: float | None = None
    closing_cov_m2ps: float | None = None
    noise_factor: float = 1.0

    @property
    def is_valid(self) -> bool:
        """True if the figures may be acted on: tracked now, or coasting for a moment."""
        return self.status is TrackStatus.TRACKING or self.status is TrackStatus.COASTING
