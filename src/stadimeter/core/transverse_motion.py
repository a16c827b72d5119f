"""How a target moves across the line of sight, and since when it stands still; and from where the camera looks."""

from __future__ import annotations

import math
from typing import NamedTuple

from msgspec import Struct


class Viewpoint(Struct, frozen=True, kw_only=True):
    """From where the camera looks, as far as the configuration says, and what its lens does to every target alike.

    Attributes:
        height_m: How high the camera is above the floor; None if that is not known.
        tilt_rad: How far it looks up from level where its mounting does not move.
        focal_sigma: Standard deviation of the focal length, as a share: all distances are wrong by it together.
    """

    height_m: float | None = None
    tilt_rad: float = 0.0
    focal_sigma: float = 0.0


class AskedMotion(NamedTuple):
    """A target whose motion across the line of sight is asked for."""

    target: str
    within_m: float | None = None
    """The distance that counts as standing still; None where that is not asked."""


class AngleEstimate(NamedTuple):
    """What is known of one angle, bearing or elevation. A tuple, because two are made for each frame.

    Attributes:
        at_s: The capture time of the newest sighting that was taken in.
        seen_rad: The angle in it.
        earlier_s: The capture time of the one before it; None for none.
        earlier_rad: The angle in that.
        angle_rad: The angle.
        rate_radps: Its rate of change.
        var_rad2: Variance of the angle.
        cov_rad2ps: Covariance of angle and rate.
        var_rate: Variance of the rate, in (rad/s)².
        noise_rad2: Variance of a sighting's noise, as it was learnt.
        doubt: 1 or -1 if the newest sighting was unexpectedly far to one side, else 0.
    """

    at_s: float
    seen_rad: float
    earlier_s: float | None
    earlier_rad: float
    angle_rad: float
    rate_radps: float
    var_rad2: float
    cov_rad2ps: float
    var_rate: float
    noise_rad2: float
    doubt: int = 0


class Standing(NamedTuple):
    """Since when a target has stood, to within a distance of where it began to."""

    within_m: float
    place_m: tuple[float, float, float]
    """Where it began to stand, in the camera frame: the mean of its first moments there."""
    since_s: float
    frames: int = 1
    """In how many frames it was seen in these moments."""


class TransverseMotion(Struct, frozen=True, kw_only=True):
    """A target's motion across the line of sight. Both angles are None until it was seen.

    Attributes:
        withins_m: The distances that count as standing still, one for each condition that asks.
        seen_at_s: The capture time of the newest sighting.
        standing: Since when it has stood, for each of `withins_m`; empty until it was seen.
    """

    target: str
    withins_m: tuple[float, ...] = ()
    bearing: AngleEstimate | None = None
    elevation: AngleEstimate | None = None
    seen_at_s: float | None = None
    standing: tuple[Standing, ...] = ()

    @property
    def angle_noise_rad(self) -> float:
        """The standard deviation of a sighting's angles, as it was learnt; 0 while nothing is known of it."""
        angles = (self.bearing, self.elevation)
        return math.sqrt(max([each.noise_rad2 for each in angles if each is not None], default=0.0))

    def still_since_s(self, within_m: float) -> float | None:
        """Return since when it has stood to within a distance; None if it was not seen."""
        return next((each.since_s for each in self.standing if each.within_m == within_m), None)


def direction_of(bearing_rad: float, elevation_rad: float) -> tuple[float, float, float]:
    """Return a vector of length 1 in the camera frame: x right, y down, z forward."""
    level = math.cos(elevation_rad)
    return (level * math.sin(bearing_rad), -math.sin(elevation_rad), level * math.cos(bearing_rad))
