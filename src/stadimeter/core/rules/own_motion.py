"""The motion of a base, by dead reckoning, and of its target over the floor."""

from __future__ import annotations

import math

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.command import BaseReport
from stadimeter.core.measurement import Sighting

# The way of a base: dead reckoning, from its commands and from its wheels' encoders -----------------------------------
#
# A picture is old when it is acted on, and the base has driven and turned since. What is wanted is its pose at the
# moment of the picture, and a little ahead, when the command that is decided now will act. Errors that grow with
# the way do not matter for that: only differences over a second or so are used.
#
# The poses go by the commands. Reports of wheels come up to 0.2 s apart and are of unknown age: corrected by them,
# the poses leapt, and the gap to a swaying ball erred by 0.15 to 0.18 m in place of 0.10. How far the base is from
# where it began, which a tether asks, is measured by the wheels where they are reported.
#
# Frame: where the base was when the rule began; x forward, y to the left, headings counter-clockwise (ROS REP 103).

# Time constant with which wheels approach the commanded speed, where it is not measured: between that of a servo, which
# obeys at once, and small geared motors under speed control (ros_arduino_bridge: 0.1 s, and a frame of
# 33 ms). Both are followed with it as well as with their own.
RESPONSE_S = 0.07

# Poses are remembered for this long: longer than any frame may be old that moves a base.
REMEMBERED_S = 2.0

# A base reports its wheels anew since it was opened: a leap beyond this speed is no way that it went.
MAX_ODOMETRY_MPS = 3.0

Twist = tuple[float, float]
"""Speed forwards in m/s and rate of turn in rad/s, positive to the left."""

AT_REST: Twist = (0.0, 0.0)


class FloorPose(Struct, frozen=True):
    """Place of a base at a time, and how far its camera is tilted up, as it reports; 0 where it does not."""

    at_s: float
    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    tilt_rad: float = 0.0


class Wheels(Struct, frozen=True):
    """The report of a base's encoders: when, and how far each wheel has rolled."""

    at_s: float
    left_m: float
    right_m: float


class OwnMotion(Struct, frozen=True, kw_only=True):
    """Knowledge of the way of a base.

    Attributes:
        poses: Its newest poses, oldest first; at least one.
        speeds: How fast it moves at the newest of them.
        anchor: Its pose at the newest report of its wheels.
        wheels: That report; None without encoders.
    """

    poses: tuple[FloorPose, ...]
    speeds: Twist = AT_REST
    anchor: FloorPose = FloorPose(at_s=0.0)
    wheels: Wheels | None = None

    @property
    def newest(self) -> FloorPose:
        """The pose in the newest cycle."""
        return self.poses[-1]

    @property
    def place(self) -> FloorPose:
        """The pose by which its way is measured: by its wheels where it reports them, else by its commands."""
        return self.newest if self.wheels is None else self.anchor

    def at(self, at_s: float) -> FloorPose:
        """Return the pose at a time of the past, between two that are remembered in proportion."""
        after = next((index for index, pose in enumerate(self.poses) if pose.at_s >= at_s), len(self.poses) - 1)
        late, early = self.poses[after], self.poses[max(0, after - 1)]
        span_s = late.at_s - early.at_s
        share = min(max((at_s - early.at_s) / span_s, 0.0), 1.0) if span_s > 0 else 1.0
        return FloorPose(
            at_s=at_s,
            x_m=early.x_m + share * (late.x_m - early.x_m),
            y_m=early.y_m + share * (late.y_m - early.y_m),
            heading_rad=early.heading_rad + share * (late.heading_rad - early.heading_rad),
            tilt_rad=early.tilt_rad + share * (late.tilt_rad - early.tilt_rad),
        )

    def ahead(self, for_s: float, twist: Twist) -> FloorPose:
        """Return the pose after some more time under a command."""
        return _advance(self.newest, self.speeds, twist, for_s)[0]


def step_own_motion(
    before: OwnMotion | None, now_s: float, twist: Twist, report: BaseReport | None, track_width_m: float | None
) -> OwnMotion:
    """Return where a base has gone by now.

    Args:
        twist: What it was commanded in the cycle before.
        report: What it reported last; None for a base that reports nothing.
        track_width_m: Distance between its wheels; None where it is not known: then it turns as it was commanded.
    """
    wheels = _wheels(report)
    if before is None:
        pose = FloorPose(at_s=now_s)
        return OwnMotion(poses=(pose,), anchor=pose, wheels=wheels)
    newest, speeds = _advance(before.newest, before.speeds, twist, max(0.0, now_s - before.newest.at_s))
    if report is not None and report.camera_tilt_rad is not None and math.isfinite(report.camera_tilt_rad):
        newest = replace(newest, tilt_rad=report.camera_tilt_rad)
    anchor, last = before.anchor, before.wheels
    if wheels is not None and last is None:
        anchor = replace(newest, at_s=wheels.at_s)
    elif wheels is not None and last is not None and wheels.at_s > last.at_s:
        command_rad = before.at(wheels.at_s).heading_rad - before.at(last.at_s).heading_rad
        anchor = _by_wheels(anchor, last, wheels, track_width_m, command_rad)
    kept = [pose for pose in before.poses if pose.at_s >= now_s - REMEMBERED_S]
    return OwnMotion(poses=(*kept, newest), speeds=speeds, anchor=anchor, wheels=wheels or last)


def _wheels(report: BaseReport | None) -> Wheels | None:
    if report is None or report.left_m is None or report.right_m is None:
        return None
    return Wheels(report.at_s, report.left_m, report.right_m)


def _by_wheels(
    anchor: FloorPose, last: Wheels, now: Wheels, track_width_m: float | None, command_rad: float
) -> FloorPose:
    """Return the pose at a report of the wheels.

    Args:
        anchor: The pose at the report before.
        command_rad: How far it turned meanwhile by its commands; counts where the distance of the wheels is not known.
    """
    left_m, right_m, for_s = now.left_m - last.left_m, now.right_m - last.right_m, now.at_s - last.at_s
    if not max(abs(left_m), abs(right_m)) <= MAX_ODOMETRY_MPS * for_s:  # counts from zero again, or is no number
        return replace(anchor, at_s=now.at_s)
    turned_rad = (right_m - left_m) / track_width_m if track_width_m else command_rad
    return _moved(anchor, (left_m + right_m) / 2, turned_rad, now.at_s)


def _advance(pose: FloorPose, speeds: Twist, twist: Twist, for_s: float) -> tuple[FloorPose, Twist]:
    """Drive on under a command: each speed approaches it as a first-order lag does, exactly."""
    kept = math.exp(-for_s / RESPONSE_S)
    linear, angular = ((goal, speed - goal) for speed, goal in zip(speeds, twist, strict=True))
    forward_m, turned_rad = (goal * for_s + lag * RESPONSE_S * (1 - kept) for goal, lag in (linear, angular))
    after = linear[0] + linear[1] * kept, angular[0] + angular[1] * kept
    return _moved(pose, forward_m, turned_rad, pose.at_s + for_s), after


def _moved(pose: FloorPose, forward_m: float, turned_rad: float, at_s: float) -> FloorPose:
    along_rad = pose.heading_rad + turned_rad / 2
    return FloorPose(
        at_s=at_s,
        x_m=pose.x_m + forward_m * math.cos(along_rad),
        y_m=pose.y_m + forward_m * math.sin(along_rad),
        heading_rad=pose.heading_rad + turned_rad,
        tilt_rad=pose.tilt_rad,
    )


# The motion of a followed target itself over the floor, whatever the base does meanwhile ------------------------------
#
# The track's closing speed is that of the two together, and it lags behind a base that speeds up: fed forward, it
# would drive the base by its own motion. So each sighting is placed on the floor, from the pose that the base had
# when the picture was taken, and Kalman filters of constant velocity run there: along the line of sight, where the
# distance is unsure, across it, where only the bearing is, and upwards, for cameras that tilt. (Bar-Shalom, Li,
# Kirubarajan, "Estimation with Applications to Tracking and Navigation", Wiley 2001, section 6.2: white-noise
# acceleration.)

# Power of the target's random acceleration in m²/s³. With 0.5 cm of noise the speed then follows within 0.1 s, and is
# sure to 0.1 m/s. From 0.04 to 0.2 little changes (measured once): the gap to a swaying ball
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
