"""The motion of a followed target itself over the floor, whatever the base does meanwhile.

The track's closing speed is that of the two together, and it lags behind a base that speeds up: fed forward, it would
drive the base by its own motion. So each sighting is placed on the floor, from the pose that the base had when the
picture was taken, and Kalman filters of constant velocity run there: along the line of sight, where the distance is
unsure, across it, where only the bearing is, and upwards, for cameras that tilt. (Bar-Shalom, Li, Kirubarajan,
"Estimation with Applications to Tracking and Navigation", Wiley 2001, section 6.2: white-noise acceleration.)
"""

from __future__ import annotations

import math

from msgspec import Struct

from stadimeter.core.measurement import Sighting
from stadimeter.core.rules.own_motion import FloorPose

# Power of the target's random acceleration in m²/s³. With 0.5 cm of noise the speed then follows within 0.1 s, and is
# sure to 0.1 m/s. From 0.04 to 0.2 little changes (tests/benchmarks/following_walks.py): the gap to a swaying ball
# errs by 4 to 5 cm at a latency of 30 ms.
ACCELERATION_M2PS3 = 0.06

# Measurements of neighbouring frames err alike (autocorrelation 0.6): as noise of every frame by itself they count as
# √((1 + 0.6) / (1 − 0.6)) = 2 times as large.
NOISE_TIMES = 2.0

# Standard deviation of a bearing. The picture knows it to 0.002; what is not known is where the base pointed then: how
# soon wheels obey differs by 0.1 s from base to base. With less, a base that obeys at once and sees late steers by its
# own turning, and swings by 8°, until it loses the target.
BEARING_SIGMA_RAD = 0.02

# How well it is known when a picture was taken: a base that turns meanwhile sees the target elsewhere.
TIMING_SIGMA_S = 0.02

# Its speed when it is first seen.
SPEED_SIGMA_MPS = 0.5

# A sighting this many standard deviations, and this far, from where it is expected is a leap: it begins anew.
LEAP_SIGMAS, LEAP_M = 6.0, 0.3

# So it does when it was out of sight for this long.
FORGOTTEN_S = 1.0

Covariance = tuple[float, float, float]
"""Of position and speed along one axis: m², m²/s, m²/s²."""


class TargetMotion(Struct, frozen=True, kw_only=True):
    """Place and motion of a target on the floor, in the frame of the base's way.

    Attributes:
        at_s: Capture time of the newest sighting.
        height_m: How much higher than the camera it is.
        along: Covariance along the line of sight.
        across: Covariance across it, to the left.
        up: Covariance upwards.
    """

    at_s: float
    x_m: float
    y_m: float
    height_m: float
    vx_mps: float = 0.0
    vy_mps: float = 0.0
    vz_mps: float = 0.0
    along: Covariance = (0.0, 0.0, SPEED_SIGMA_MPS**2)
    across: Covariance = (0.0, 0.0, SPEED_SIGMA_MPS**2)
    up: Covariance = (0.0, 0.0, SPEED_SIGMA_MPS**2)

    def seen_from(self, pose: FloorPose) -> RelativeTarget:
        """Return where it will be for a base in some pose, at the time of that pose."""
        for_s = max(0.0, pose.at_s - self.at_s)
        x_m = self.x_m + self.vx_mps * for_s - pose.x_m
        y_m = self.y_m + self.vy_mps * for_s - pose.y_m
        away_rad = math.atan2(y_m, x_m)
        cos, sin = math.cos(away_rad), math.sin(away_rad)
        away_mps = _sure_part(self.vx_mps * cos + self.vy_mps * sin, self.along[2])
        height_m = self.height_m + self.vz_mps * for_s
        up_rad = math.atan2(height_m, math.hypot(x_m, y_m))
        return RelativeTarget(
            distance_m=math.sqrt(x_m * x_m + y_m * y_m + self.height_m**2),
            bearing_rad=math.remainder(pose.heading_rad - away_rad, 2 * math.pi),
            elevation_rad=up_rad - pose.tilt_rad,
            away_mps=away_mps,
            left_mps=_sure_part(self.vy_mps * cos - self.vx_mps * sin, self.across[2]),
            rising_mps=_sure_part(self.vz_mps, self.up[2]) * math.cos(up_rad) - away_mps * math.sin(up_rad),
        )


class RelativeTarget(Struct, frozen=True, kw_only=True):
    """Place of a target relative to a base, and how it moves by itself.

    Attributes:
        distance_m: Along the straight line from the camera.
        bearing_rad: Positive to the right.
        elevation_rad: From where the camera points, positive upwards.
        away_mps: Its speed along the line of sight, away from the base, as far as that is sure.
        left_mps: Its speed across that, to the left.
        rising_mps: Its speed across the line of sight, upwards.
    """

    distance_m: float
    bearing_rad: float
    elevation_rad: float = 0.0
    away_mps: float = 0.0
    left_mps: float = 0.0
    rising_mps: float = 0.0


def _sure_part(speed_mps: float, variance: float) -> float:
    """Return a speed without what may be noise: the estimate of least error where nothing else is known of it."""
    square = speed_mps * speed_mps
    return speed_mps * square / (square + variance) if square else 0.0


def step_target_motion(
    before: TargetMotion | None, sighting: Sighting, pose: FloorPose, turn_radps: float, noise_factor: float
) -> TargetMotion:
    """Take in a sighting.

    Args:
        pose: Where the base was when the picture was taken.
        turn_radps: How fast it turned then.
        noise_factor: How many times noisier than stated the target was found to be.
    """
    on_floor_m, bearing_rad, height_m = _levelled(sighting, pose.tilt_rad)
    away_rad = pose.heading_rad - bearing_rad
    cos, sin = math.cos(away_rad), math.sin(away_rad)
    x_m, y_m = pose.x_m + on_floor_m * cos, pose.y_m + on_floor_m * sin
    along_m = NOISE_TIMES * noise_factor * sighting.noise_m
    up_m = sighting.distance_m * BEARING_SIGMA_RAD
    across_m = on_floor_m * math.hypot(BEARING_SIGMA_RAD, TIMING_SIGMA_S * turn_radps)
    anew = TargetMotion(
        at_s=sighting.at_s,
        x_m=x_m,
        y_m=y_m,
        height_m=height_m,
        along=(along_m**2, 0.0, SPEED_SIGMA_MPS**2),
        across=(across_m**2, 0.0, SPEED_SIGMA_MPS**2),
        up=(up_m**2, 0.0, SPEED_SIGMA_MPS**2),
    )
    if before is None or not 0.0 < sighting.at_s - before.at_s <= FORGOTTEN_S:
        return anew
    for_s = sighting.at_s - before.at_s
    along, across = _later(before.along, for_s), _later(before.across, for_s)
    dx_m = x_m - (before.x_m + before.vx_mps * for_s)
    dy_m = y_m - (before.y_m + before.vy_mps * for_s)
    along_off_m, across_off_m = dx_m * cos + dy_m * sin, dy_m * cos - dx_m * sin
    if math.hypot(along_off_m, across_off_m) > LEAP_M and (
        along_off_m**2 > LEAP_SIGMAS**2 * (along[0] + along_m**2)
        or across_off_m**2 > LEAP_SIGMAS**2 * (across[0] + across_m**2)
    ):
        return anew
    along, (near, speed) = _take_in(along, along_m, along_off_m)
    across, (aside, drift) = _take_in(across, across_m, across_off_m)
    foretold_m = before.height_m + before.vz_mps * for_s
    up, (higher, climb) = _take_in(_later(before.up, for_s), up_m, height_m - foretold_m)
    return TargetMotion(
        at_s=sighting.at_s,
        x_m=x_m - dx_m + near * cos - aside * sin,
        y_m=y_m - dy_m + near * sin + aside * cos,
        height_m=foretold_m + higher,
        vx_mps=before.vx_mps + speed * cos - drift * sin,
        vy_mps=before.vy_mps + speed * sin + drift * cos,
        vz_mps=before.vz_mps + climb,
        along=along,
        across=across,
        up=up,
    )


def _levelled(sighting: Sighting, tilt_rad: float) -> tuple[float, float, float]:
    """Return the distance over the floor, bearing and height at which a level camera would have seen a target."""
    flat_m = sighting.distance_m * math.cos(sighting.elevation_rad)
    up_m = sighting.distance_m * math.sin(sighting.elevation_rad)
    cos, sin = math.cos(tilt_rad), math.sin(tilt_rad)
    ahead_m, right_m = flat_m * math.cos(sighting.bearing_rad), flat_m * math.sin(sighting.bearing_rad)
    forward_m = ahead_m * cos - up_m * sin
    return math.hypot(forward_m, right_m), math.atan2(right_m, forward_m), up_m * cos + ahead_m * sin


def _later(covariance: Covariance, for_s: float) -> Covariance:
    """Return the covariance after some time of constant velocity under a random acceleration."""
    place, both, speed = covariance
    grown = ACCELERATION_M2PS3 * for_s
    return (
        place + 2 * both * for_s + speed * for_s**2 + grown * for_s**2 / 3,
        both + speed * for_s + grown * for_s / 2,
        speed + grown,
    )


def _take_in(covariance: Covariance, noise_m: float, off_m: float) -> tuple[Covariance, tuple[float, float]]:
    """Return the covariance after a measurement, and the corrections of position and speed."""
    place, both, speed = covariance
    total = place + noise_m**2
    gain, speed_gain = place / total, both / total
    after = (place * (1 - gain), both * (1 - gain), max(0.0, speed - speed_gain * both))
    return after, (gain * off_m, speed_gain * off_m)
