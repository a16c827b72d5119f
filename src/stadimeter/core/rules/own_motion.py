"""The way of a base: dead reckoning, from its commands and from its wheels' encoders.

A picture is old when it is acted on, and the base has driven and turned since. What is wanted is its pose at the moment
of the picture, and a little ahead, when the command that is decided now will act. Errors that grow with the way do not
matter for that: only differences over a second or so are used.

The poses go by the commands. Reports of wheels come up to 0.2 s apart and are of unknown age: corrected by them, the
poses leapt, and the gap to a swaying ball erred by 0.15 to 0.18 m in place of 0.10. How far the base is from where it
began, which a tether asks, is measured by the wheels where they are reported.

Frame: where the base was when the rule began; x forward, y to the left, headings counter-clockwise (ROS REP 103).
"""

from __future__ import annotations

import math

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.base_report import BaseReport

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
