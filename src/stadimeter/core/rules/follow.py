"""Follow a target with a base: what it drives by, and what it does without its target, on a tether, near a second one.

The law is `follow_twist`. All figures are as of the moment at which a command acts: the base's own motion since the
picture is taken out of them, see `step_target_motion`.
"""

from __future__ import annotations

import math
from typing import Literal

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.alarms.alarm import OPEN, Gate, GatedStep
from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.core.conditions.leaf import RuleInputs, describe_unseen
from stadimeter.core.conditions.quantities import quantity_of
from stadimeter.core.decision import Event, EventKind, RuleStatus, RuleTrace, SafetyMode, Severity
from stadimeter.core.measurement import Sighting, Track
from stadimeter.core.plan import BaseOutput
from stadimeter.core.rule import FollowRule, Search, TwistRequest, trace_of
from stadimeter.core.words import duration, metres

# The motion of a base, by dead reckoning, and of its target over the floor.

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
    along, (near, speed) = _fused(along, along_m, along_off_m)
    across, (aside, drift) = _fused(across, across_m, across_off_m)
    foretold_m = before.height_m + before.vz_mps * for_s
    up, (higher, climb) = _fused(_later(before.up, for_s), up_m, height_m - foretold_m)
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


def _fused(covariance: Covariance, noise_m: float, off_m: float) -> tuple[Covariance, tuple[float, float]]:
    """Return the covariance after a measurement, and the corrections of position and speed."""
    place, both, speed = covariance
    total = place + noise_m**2
    gain, speed_gain = place / total, both / total
    after = (place * (1 - gain), both * (1 - gain), max(0.0, speed - speed_gain * both))
    return after, (gain * off_m, speed_gain * off_m)


# Keep a base at a distance from its target, and pointed at it ---------------------------------------------------------
#
# With the distance d, the one to keep d₀, and the bearing β, positive to the right:
#
#     v = (u + s(d − d₀)) · max(0, cos β)        ω = −k_β β + (u_left − v sin β) / d
#
# A camera that tilts does so by the same law as the base turns, with the elevation in place of −β.
#
# u and u_left are the target's own speeds, away and across: fed forward, they leave no lag behind a target that
# walks. s(e) is k·e near the goal and √(2 a (|e| − a/2k²)) further away: the speed from which the base, braking at
# a, comes to rest there. The cosine slows the base while it still has to turn.
#
# A picture is late, and a late loop with too much gain swings: with the delay D from the picture to the wheels, k D
# must stay well below 1 (simulated: 0.37 overshoots by 1 %, 0.5 by 10 %, 1.0 by 67 %). So k is 0.35 / D, at most
# `MAX_GAIN_PER_S`.

# Gain times delay: 0 to 1 % overshoot in the table above. A gain that is stated may be this much at most.
GAIN_SHARE, MAX_GAIN_SHARE = 0.35, 1.0

# With an acceleration of 0.5 m/s² a gain of 2 overshoots by 12 to 22 % however short the delay is: what limits it
# then is how soon the base can brake. It grows with the root of the acceleration.
MAX_GAIN_PER_S, AT_ACCELERATION_MPS2 = 1.5, 0.5
MAX_TURN_GAIN_PER_S = 3.0

# It plans to brake with this share of its acceleration; the rest is for what it could not foresee.
BRAKE_SHARE = 0.8

# A base that stands sets off for a target that moves by itself at this speed, within the deadband too; one that moves
# comes to rest below these. Slower than that few wheels turn.
SET_OFF_MPS, SET_OFF_RADPS = 0.05, 0.08
REST_MPS, REST_RADPS = 0.02, 0.03

# Nearer than this share of the distance to keep, it stops as hard as it can, and does not ease.
TOO_NEAR = 0.5


class Law(Struct, frozen=True, kw_only=True):
    """The gains of a follow rule for the delay that there is.

    Attributes:
        gain_per_s: Speed for each metre.
        turn_gain_per_s: Rate of turn for each radian.
        brake_mps2: How hard it plans to brake.
    """

    gain_per_s: float = MAX_GAIN_PER_S
    turn_gain_per_s: float = MAX_GAIN_PER_S
    brake_mps2: float = BRAKE_SHARE * AT_ACCELERATION_MPS2


def law_of(rule: FollowRule, delay_s: float, acceleration_mps2: float) -> Law:
    """Return the gains for a delay from the picture to the wheels."""

    def gain(stated: float | None, largest: float) -> float:
        if stated is not None:
            return min(stated, MAX_GAIN_SHARE / delay_s)
        return min(GAIN_SHARE / delay_s, largest)

    largest = MAX_GAIN_PER_S * math.sqrt(acceleration_mps2 / AT_ACCELERATION_MPS2)
    return Law(
        gain_per_s=gain(rule.gain_per_s, largest),
        turn_gain_per_s=gain(rule.turn_gain_per_s, MAX_TURN_GAIN_PER_S),
        brake_mps2=BRAKE_SHARE * acceleration_mps2,
    )


def follow_twist(rule: FollowRule, seen: RelativeTarget, law: Law, before: Twist = AT_REST) -> Twist:
    """Return the speed forwards in m/s and the rate of turn in rad/s, positive to the left, within the rule's limits.

    Args:
        before: The command of the cycle before; a base that moves stays in motion nearer to its goal than one that
            stands is set in motion.
    """
    linear_mps = _linear_mps(rule, seen, law, is_moving=before[0] != 0.0)
    angular_radps = _angular_radps(rule, seen, law, before)
    return linear_mps + 0.0, angular_radps + 0.0  # adding zero makes -0.0 an ordinary zero


def _linear_mps(rule: FollowRule, seen: RelativeTarget, law: Law, *, is_moving: bool) -> float:
    error_m = seen.distance_m - rule.distance_m
    is_near = abs(error_m) <= rule.deadband_m
    wanted_mps = (seen.away_mps + closing_speed_mps(error_m, law)) * max(0.0, math.cos(seen.bearing_rad))
    if is_near and (abs(wanted_mps) < REST_MPS if is_moving else abs(seen.away_mps) < SET_OFF_MPS):
        return 0.0
    return min(max(wanted_mps, -rule.reverse_max_mps), rule.linear_max_mps)


def _angular_radps(rule: FollowRule, seen: RelativeTarget, law: Law, before: Twist) -> float:
    # The line of sight turns as the target crosses it, and as the base drives past the target.
    across_mps = seen.left_mps - before[0] * math.sin(seen.bearing_rad)
    return _turn_radps(rule, seen, law, (-seen.bearing_rad, across_mps), is_turning=before[1] != 0.0)


def tilt_rate_radps(rule: FollowRule, seen: RelativeTarget, law: Law, before_radps: float) -> float:
    """Return the tilt rate of a camera, positive upwards, within the rule's limit; it tilted at some rate before."""
    return _turn_radps(rule, seen, law, (seen.elevation_rad, seen.rising_mps), is_turning=before_radps != 0.0) + 0.0


def _turn_radps(
    rule: FollowRule, seen: RelativeTarget, law: Law, off: tuple[float, float], *, is_turning: bool
) -> float:
    """Return a rate for a target that is off by an angle, and moves across the line of sight in that direction."""
    off_rad, across_mps = off
    ahead_radps = across_mps / max(seen.distance_m, rule.distance_m * TOO_NEAR)
    wanted_radps = ahead_radps + law.turn_gain_per_s * off_rad
    is_near = abs(off_rad) <= rule.deadband_rad
    if is_near and (abs(wanted_radps) < REST_RADPS if is_turning else abs(ahead_radps) < SET_OFF_RADPS):
        return 0.0
    return min(max(wanted_radps, -rule.angular_max_radps), rule.angular_max_radps)


def closing_speed_mps(error_m: float, law: Law) -> float:
    """Return the speed towards the distance to keep from which the base can still come to rest there."""
    bend_m = law.brake_mps2 / law.gain_per_s**2 if law.gain_per_s > 0 else math.inf
    if abs(error_m) <= bend_m:
        return law.gain_per_s * error_m
    return math.copysign(math.sqrt(2 * law.brake_mps2 * (abs(error_m) - bend_m / 2)), error_m)


# Looking for a target that a base has lost: it turns in place, in steps, to the side where the target was last ---
#
# ::
#
#     wait ──hidden_s──▶ turn ──a step──▶ look ──look_s──▶ turn … ──angle or time used up──▶ ended     (only if it
# was lost in the middle of the view)
#
# A base that spins shows a ball for seven or eight frames only, and blurred. So it stands between two steps, for as
# long as a target takes to be confirmed. It never drives: the camera does not see what is beside the base. A camera
# that tilts stays tilted as it was when it lost its target.

# A target nearer than this to the middle of the view was hidden by something; it cannot have left a camera's view,
# which is 40° wide at least.
HIDDEN_RAD = math.radians(15)

# The first turn goes to where the target may be by now, but no further than this: most of what a camera sees.
MAX_FIRST_STEP_RAD = math.radians(45)

# It has turned when it is this near to where it shall be.
ARRIVED_RAD = math.radians(3)

# A base that does not get there in this many times the usual time is hindered: it looks where it is.
HINDERED_TIMES, HINDERED_S = 2.0, 0.5


class SearchStep(Struct, frozen=True, kw_only=True):
    """State of a search.

    Attributes:
        side: 1 for turning to the left, −1 to the right.
        goal_rad: The heading that it turns to.
        turned_rad: How far it will have turned then.
        phase_s: For how long the phase has lasted.
        spent_s: For how long it has searched; time in which outputs may not act does not count.
    """

    phase: Literal["wait", "turn", "look", "ended"]
    side: int
    goal_rad: float
    turned_rad: float = 0.0
    phase_s: float = 0.0
    spent_s: float = 0.0


def begin_search(settings: Search, heading_rad: float, bearing_rad: float) -> SearchStep:
    """Begin to look for a target.

    Args:
        heading_rad: Where the base points, counter-clockwise.
        bearing_rad: Where the target must be by now as it moved, positive to the right.
    """
    side = -1 if bearing_rad > 0 else 1
    if abs(bearing_rad) < HIDDEN_RAD:
        return SearchStep(phase="wait", side=side, goal_rad=heading_rad)
    first_rad = min(max(abs(bearing_rad), settings.step_rad), MAX_FIRST_STEP_RAD, settings.angle_rad)
    return SearchStep(phase="turn", side=side, goal_rad=heading_rad + side * first_rad, turned_rad=first_rad)


def step_search(
    search: SearchStep, settings: Search, heading_rad: float, will_be_rad: float, for_s: float
) -> tuple[SearchStep, float]:
    """Go on searching; return the search and the rate of turn in rad/s, positive to the left.

    Args:
        heading_rad: Where the base points.
        will_be_rad: Where it will point if it is stopped now: wheels run on for a moment.
        for_s: Since the cycle before.
    """
    search = replace(search, phase_s=search.phase_s + for_s, spent_s=search.spent_s + for_s)
    if search.phase != "ended" and search.spent_s > settings.for_s:
        search = replace(search, phase="ended")
    if search.phase == "turn" and not _is_there(search, settings, will_be_rad):
        return search, search.side * settings.rate_radps
    if search.phase == "turn":
        search = replace(search, phase="look", phase_s=0.0)
    wait_s = settings.hidden_s if search.phase == "wait" else settings.look_s
    if search.phase in {"wait", "look"} and search.phase_s >= wait_s:
        return _next_turn(search, settings, heading_rad), 0.0
    return search, 0.0


def _is_there(search: SearchStep, settings: Search, will_be_rad: float) -> bool:
    left_rad = search.side * (search.goal_rad - will_be_rad)
    usual_s = MAX_FIRST_STEP_RAD / settings.rate_radps
    return left_rad <= ARRIVED_RAD or search.phase_s > HINDERED_TIMES * usual_s + HINDERED_S


def _next_turn(search: SearchStep, settings: Search, heading_rad: float) -> SearchStep:
    step_rad = min(settings.step_rad, settings.angle_rad - search.turned_rad)
    if step_rad <= ARRIVED_RAD:
        return replace(search, phase="ended", phase_s=0.0)
    return replace(
        search,
        phase="turn",
        phase_s=0.0,
        goal_rad=heading_rad + search.side * step_rad,
        turned_rad=search.turned_rad + step_rad,
    )


# The rule: one step of following --------------------------------------------------------------------------------------

# A base does not drive by a distance whose standard deviation is more than this share of it.
UNSURE_SHARE = 0.3

# A tether counts as reached this near to its end, and as left this far before it.
TETHER_END_M, TETHER_LEFT_M = 0.03, 0.2

# The age of frames is averaged over about this many.
AGE_FRAMES = 10.0

# A target that was lost is taken to have gone on for this long as it moved last.
MAX_FORETOLD_S = 1.0

# Of a longer time between two cycles, no more counts as searched.
MAX_CYCLE_S = 0.2

KEEPS = "keeps"


class FollowStep(GatedStep, frozen=True, kw_only=True):
    """The memory of a follow rule.

    Attributes:
        own: The way of the base.
        target: The target on the floor; None before it was seen.
        age_s: How old frames are when they are acted on, on average; None before the first.
        search: The search that goes on or has ended; None while the target is in sight or none was begun.
        origin: Where the base began, for the tether.
        is_tethered: Whether it is at the end of its tether.
        slow_at: Where on the floor the target was last near which it is slow; None before it was seen.
        does: `KEEPS`, the phase of the search, or nothing.
        brakes_until_s: It slows down gently for no longer than this, since its gate closed; None for no such thing.
    """

    own: OwnMotion | None = None
    target: TargetMotion | None = None
    age_s: float | None = None
    search: SearchStep | None = None
    origin: FloorPose | None = None
    is_tethered: bool = False
    slow_at: tuple[float, float] | None = None
    does: str = ""
    brakes_until_s: float | None = None


def new_follow(rule: FollowRule) -> FollowStep:
    """Return a follow rule at the start of a run."""
    return FollowStep(trace=trace_of(rule, RuleStatus.UNKNOWN))


def step_follow(
    rule: FollowRule, before: FollowStep, inputs: RuleInputs, base: BaseOutput | None, gate: Gate = OPEN
) -> tuple[FollowStep, tuple[Event, ...]]:
    """Judge a follow rule for one cycle; return what it does, and what happened."""
    if base is None:
        trace = trace_of(rule, RuleStatus.UNKNOWN, before.trace)
        return FollowStep(trace=trace, record=gate.record or before.record, is_open=gate.is_open), gate.events
    commanded = _commanded(inputs, base.name)
    now, own = _take_in(rule, before, inputs, base, commanded)
    if gate is not OPEN or not before.is_open:
        now = replace(now, record=gate.record or before.record, is_open=gate.is_open, held=gate.held)
    if not gate.lets_move:
        return _kept_still(rule, before, now, base, commanded, gate), gate.events
    twist: Twist | None = None
    tilt_radps, is_gentle, does = 0.0, False, ""
    search = None
    if now.target is not None and _drivable_sighting(inputs.tracks[rule.target]) is not None:
        seen = now.target.seen_from(own.ahead(_response_s(rule, now), commanded))
        law = _law(rule, now, base)
        twist = _follow(rule, now, seen, law, commanded)
        tilt_radps = tilt_rate_radps(rule, seen, law, _commanded_tilt_radps(inputs, base.name)) if base.tilts else 0.0
        is_gentle, does = seen.distance_m >= TOO_NEAR * rule.distance_m, KEEPS
    else:  # without a search the twist stays None: no request, and so `core.outputs` has the base stand still
        search, twist = _search(rule, now, own, inputs)
        does = "" if search is None else search.phase
    if twist is not None and now.origin is not None:
        twist = _on_tether(rule, now.origin, own.place, base, twist)
    after = replace(
        now,
        trace=_trace(rule, before, twist, tilt_radps, gate, is_known=does == KEEPS),
        requests=() if gate.inhibits else _requests(rule, base, twist, tilt_radps, is_gentle=is_gentle),
        search=search,
        is_tethered=_is_tethered(rule, before, now.origin, own.place),
        does=does,
        brakes_until_s=None,
    )
    return after, gate.events + _events(rule, before, after, inputs.now_s)


def _kept_still(
    rule: FollowRule, before: FollowStep, now: FollowStep, base: BaseOutput, commanded: Twist, gate: Gate
) -> FollowStep:
    """Return the step of a rule that its gate keeps from driving: it slows down gently, or stands still.

    Where its gate is not known, and for safety, it stands at once: nothing moves by guess.
    """
    at_s, until_s = now.own.newest.at_s if now.own else 0.0, before.brakes_until_s
    if until_s is None and before.requests:
        ramp_s = base.linear_accel_mps2 / base.linear_jerk_mps3 if base.linear_jerk_mps3 > 0 else 0.0
        turn_s = abs(commanded[1]) / base.angular_accel_radps2
        until_s = at_s + max(abs(commanded[0]) / base.linear_accel_mps2, turn_s) + 2 * ramp_s
    is_over = commanded == AT_REST or until_s is None or at_s > until_s or not before.requests
    is_at_once = gate.lets_move is None or rule.severity is Severity.SAFETY
    requests = () if is_over or is_at_once else _requests(rule, base, AT_REST, 0.0, is_gentle=True)
    status = RuleStatus.UNKNOWN if gate.lets_move is None else RuleStatus.IDLE
    return replace(
        now,
        trace=trace_of(rule, status, before.trace, gate.inhibits),
        requests=requests,
        search=None,
        does="",
        brakes_until_s=until_s if requests else None,
    )


def _commanded(inputs: RuleInputs, output: str) -> Twist:
    command = inputs.commands.get(output)
    return (command.linear_mps, command.angular_radps) if isinstance(command, TwistCommand) else AT_REST


def _commanded_tilt_radps(inputs: RuleInputs, output: str) -> float:
    command = inputs.commands.get(output)
    return command.tilt_radps if isinstance(command, TwistCommand) else 0.0


def _take_in(
    rule: FollowRule, before: FollowStep, inputs: RuleInputs, base: BaseOutput, commanded: Twist
) -> tuple[FollowStep, OwnMotion]:
    """Gather what is known by now of the way of the base and of the target on the floor."""
    own = step_own_motion(before.own, inputs.now_s, commanded, inputs.base, base.track_width_m)
    target, age_s, origin = before.target, before.age_s, before.origin or own.place
    if inputs.safety is SafetyMode.DISARMED or inputs.safety is SafetyMode.STOPPED:
        # A person has it in hand, and may carry it elsewhere: what was seen before says nothing of where it is then.
        target, origin = None, own.place
    sighting, track = inputs.sightings.get(rule.target), inputs.tracks[rule.target]
    if sighting is not None and track.is_valid and (target is None or sighting.at_s > target.at_s):
        now_age_s = max(0.0, inputs.now_s - sighting.at_s)
        age_s = now_age_s if age_s is None else age_s + (now_age_s - age_s) / AGE_FRAMES
        pose = own.at(sighting.at_s)
        target = step_target_motion(target, sighting, pose, own.speeds[1], track.noise_factor)
    slow_at = _place_of_slow(rule, before, inputs, own)
    return replace(before, own=own, target=target, age_s=age_s, origin=origin, slow_at=slow_at), own


def _response_s(rule: FollowRule, now: FollowStep) -> float:
    """Return the time that the wheels take to obey: what is stated beyond the age of the frames, or what is usual."""
    return RESPONSE_S if rule.delay_s is None else max(0.0, rule.delay_s - (now.age_s or 0.0))


def _law(rule: FollowRule, now: FollowStep, base: BaseOutput) -> Law:
    return law_of(rule, rule.delay_s or (now.age_s or 0.0) + RESPONSE_S, base.linear_accel_mps2)


def _follow(rule: FollowRule, now: FollowStep, seen: RelativeTarget, law: Law, commanded: Twist) -> Twist:
    linear_mps, angular_radps = follow_twist(rule, seen, law, commanded)
    if rule.slow is not None and now.slow_at is not None and now.own is not None:
        pose = now.own.newest
        away_m = math.hypot(now.slow_at[0] - pose.x_m, now.slow_at[1] - pose.y_m)
        share = (away_m - rule.slow.full_m) / (rule.slow.start_m - rule.slow.full_m)
        linear_mps = min(linear_mps, rule.linear_max_mps * min(max(share, 0.0), 1.0))
    return linear_mps, angular_radps


def _place_of_slow(
    rule: FollowRule, before: FollowStep, inputs: RuleInputs, own: OwnMotion
) -> tuple[float, float] | None:
    """Return where the target is that it is slow near. Out of sight it is taken to stay where it was."""
    track = None if rule.slow is None else inputs.tracks.get(rule.slow.target)
    if track is None or not track.is_valid or track.distance_m is None or track.bearing_rad is None:
        return before.slow_at
    pose = own.at(inputs.now_s if track.as_of_s is None else track.as_of_s)
    away_rad = pose.heading_rad - track.bearing_rad
    place = pose.x_m + track.distance_m * math.cos(away_rad), pose.y_m + track.distance_m * math.sin(away_rad)
    return place if math.isfinite(place[0] + place[1]) else before.slow_at


# Search


def _search(
    rule: FollowRule, now: FollowStep, own: OwnMotion, inputs: RuleInputs
) -> tuple[SearchStep | None, Twist | None]:
    """Return where a search is, and what the base shall do; None for standing still."""
    settings = rule.search
    if settings is None or now.target is None or rule.angular_max_radps == 0.0 or inputs.tracks[rule.target].is_valid:
        return None, None
    if inputs.safety is not SafetyMode.ACTIVE or now.is_tethered or _is_hindered(inputs.base):
        return now.search, None
    will_be = own.ahead(RESPONSE_S, AT_REST)
    if now.search is None:
        seen = now.target.seen_from(replace(will_be, at_s=min(will_be.at_s, now.target.at_s + MAX_FORETOLD_S)))
        return begin_search(settings, own.newest.heading_rad, seen.bearing_rad), None
    for_s = own.poses[-1].at_s - own.poses[max(0, len(own.poses) - 2)].at_s
    search, turn_radps = step_search(
        now.search, settings, own.newest.heading_rad, will_be.heading_rad, min(for_s, MAX_CYCLE_S)
    )
    turn_radps = min(max(turn_radps, -rule.angular_max_radps), rule.angular_max_radps)
    return search, (0.0, turn_radps) if turn_radps else None


def _is_hindered(report: BaseReport | None) -> bool:
    """Check whether a base touches something or hangs over an edge: then it does not turn without sight."""
    return report is not None and bool(report.is_bumped or report.is_at_cliff)


# Tether


def _on_tether(rule: FollowRule, origin: FloorPose, pose: FloorPose, base: BaseOutput, twist: Twist) -> Twist:
    """Return a twist that ends on the tether: away from the origin no faster than the base can brake there."""
    if rule.tether_m is None:
        return twist
    east_m, north_m = pose.x_m - origin.x_m, pose.y_m - origin.y_m
    outward = east_m * math.cos(pose.heading_rad) + north_m * math.sin(pose.heading_rad)
    if outward * twist[0] < 0.0:
        return twist  # it leads back
    left_m = rule.tether_m - math.hypot(east_m, north_m) - abs(twist[0]) * RESPONSE_S
    most_mps = math.sqrt(2 * BRAKE_SHARE * base.linear_accel_mps2 * max(0.0, left_m))
    return min(max(twist[0], -most_mps), most_mps) + 0.0, twist[1]


def _is_tethered(rule: FollowRule, before: FollowStep, origin: FloorPose | None, pose: FloorPose) -> bool:
    if rule.tether_m is None or origin is None:
        return False
    left_m = rule.tether_m - math.hypot(pose.x_m - origin.x_m, pose.y_m - origin.y_m)
    return left_m <= (TETHER_LEFT_M if before.is_tethered else TETHER_END_M)


# What others see of it


def _trace(
    rule: FollowRule, before: FollowStep, twist: Twist | None, tilt_radps: float, gate: Gate, *, is_known: bool
) -> RuleTrace:
    status = RuleStatus.ACTIVE if twist != AT_REST or tilt_radps else RuleStatus.IDLE
    if not is_known and twist is None:
        status = RuleStatus.UNKNOWN
    return trace_of(rule, status, before.trace, gate.inhibits)


def _requests(
    rule: FollowRule, base: BaseOutput, twist: Twist | None, tilt_radps: float, *, is_gentle: bool
) -> tuple[TwistRequest, ...]:
    if twist is None:
        return ()
    request = TwistRequest(
        rule=rule.name,
        output=base.name,
        priority=rule.priority,
        linear_mps=twist[0],
        angular_radps=twist[1],
        tilt_radps=tilt_radps,
        is_gentle=is_gentle,
    )
    return (request,)


def _events(rule: FollowRule, before: FollowStep, after: FollowStep, now_s: float) -> tuple[Event, ...]:
    found: list[tuple[EventKind, Severity, str]] = []
    if after.search is not None and rule.search is not None:
        was, phase = before.search.phase if before.search else "wait", after.search.phase
        if was == "wait" and phase == "turn":
            found.append((EventKind.SEARCH_BEGUN, Severity.INFO, _turning(after.search)))
        if phase == "ended" and was != "ended":
            words = f"not found within {duration(after.search.spent_s)}: it stands still until it sees its target"
            found.append((EventKind.SEARCH_ENDED, rule.severity, words))
    if after.is_tethered and not before.is_tethered:
        words = f"it is {rule.tether_m:.2f} m from where it began, as far as its tether lets it"
        found.append((EventKind.TETHERED, rule.severity, words))
    return tuple(
        Event(kind=kind, source=rule.name, at_s=now_s, severity=severity, reason=words, notify=not rule.observe)
        for kind, severity, words in found
    )


def _turning(search: SearchStep) -> str:
    return f"turns to the {'left' if search.side > 0 else 'right'} in search of its target"


def describe_follow(rule: FollowRule, step: FollowStep, track: Track) -> str:
    """Return why a follow rule does what it does, in words with figures."""
    figures = _drivable_sighting(track)
    if figures is None:
        distance = quantity_of(track, "distance")
        unseen = f"{metres(*distance[:2])} is too unsure to drive by" if distance else describe_unseen(track)
        return unseen + _searching(rule, step)
    distance_m, sigma_m, bearing_rad = figures
    where = f"{metres(distance_m, sigma_m)} at {round(math.degrees(bearing_rad)):+d}°"
    tether = ", at the end of its tether" if step.is_tethered else ""
    return f"{where}, to keep {rule.distance_m:.2f} m ahead{tether}"


def _searching(rule: FollowRule, step: FollowStep) -> str:
    if step.search is None or rule.search is None:
        return ""
    match step.search.phase:
        case "wait":
            return f"; it waits {duration(rule.search.hidden_s)} before it searches"
        case "ended":
            return f"; it has searched for {duration(step.search.spent_s)} and stands still"
        case _:
            return f"; it {_turning(step.search)}: {math.degrees(step.search.turned_rad):.0f}° so far"


def _drivable_sighting(track: Track) -> tuple[float, float, float] | None:
    """Return distance, its standard deviation and bearing; None while they cannot be acted on."""
    figures = quantity_of(track, "distance")
    if figures is None or track.bearing_rad is None or not math.isfinite(track.bearing_rad):
        return None
    distance_m, sigma_m, _ = figures
    return None if sigma_m > UNSURE_SHARE * distance_m else (distance_m, sigma_m, track.bearing_rad)
