"""A target over time."""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct


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
        noise_factor: How many times larger than stated its noise was found to be; see `core.tracking.noise_level`.
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
