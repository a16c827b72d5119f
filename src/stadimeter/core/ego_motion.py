"""The robot's motion of late: by its wheels where they report, else as it was commanded."""

from __future__ import annotations

import bisect
import math

from msgspec import Struct
from msgspec.structs import astuple

from stadimeter.core.command import BaseReport, TwistCommand

# Motion is remembered for this long: the oldest picture that a newer one is compared with, and the lag before it.
REMEMBERED_S = 25.6

# A way back may be longer or shorter than one forth that measures the same, by twice this share: motors, floors, slip.
DOUBT_SHARE = 0.15

# A robot that has turned by more than this may have turned right round: its track may be a third narrower than stated,
# and its turn as much greater.
MAX_TURN_RAD = 4.0

# A wheel that seems to have run faster was counted anew: its base was opened again.
MAX_WHEEL_MPS = 3.0

# Bases report their wheels 5 to 50 times a second. One that has said nothing new for longer stands, as far as is known.
REPORTED_S = 0.5

# Without reports from the wheels slower commands are not taken to move anything: motors have a dead zone.
MIN_COMMAND_MPS = 0.05
MIN_COMMAND_RADPS = 0.2

# The wheels of a robot for rooms are no further apart, so it has turned by what they differ in, over this, at least.
MAX_TRACK_WIDTH_M = 0.6

# How much later than the path says the picture may show a motion: the delay of the serial line and of the camera, and
# without reports from the wheels the time that motors take to follow a command.
LAGS_S = (0.0, 0.05, 0.1)
COMMAND_LAGS_S = (0.0, 0.1, 0.2)


class RobotPose(Struct, frozen=True, kw_only=True):
    """The robot's place at a time, relative to where it began: x forward, y to the left, counter-clockwise.

    Attributes:
        travel_m: How far it had driven by then, less what it drove back.
        turned_rad: By how much it had turned by then, at least, as a camera sees it that looks up or down: less, with
            the cosine of its tilt. The heading is the best guess.
        doubt_m: How much it may have driven besides, or less, all that it was wrong by added up.
        doubt_rad: The same of its turn.
        tilt_rad: How far its camera was tilted up. How far that makes the picture flow is not foretold: the flow is
            measured from what changes sideways.
    """

    at_s: float
    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    travel_m: float = 0.0
    turned_rad: float = 0.0
    doubt_m: float = 0.0
    doubt_rad: float = 0.0
    tilt_rad: float = 0.0


class EgoMotion(Struct, frozen=True, kw_only=True):
    """The path of the robot in the last `REMEMBERED_S`, oldest first.

    Attributes:
        report: What the base reported last of its wheels; None for a base that does not.
        wheels_mps: The mean speeds of the left and the right wheel between its last two reports.
    """

    path: tuple[RobotPose, ...] = ()
    report: BaseReport | None = None
    wheels_mps: tuple[float, float] = (0.0, 0.0)

    def step(self, now_s: float, command: TwistCommand | None, report: BaseReport | None) -> EgoMotion:
        """Return the motion up to now.

        Args:
            command: What the base was commanded to do since the cycle before; None for nothing.
            report: What the base reported last.
        """
        last = self.path[-1] if self.path else RobotPose(at_s=now_s)
        step_s = max(0.0, now_s - last.at_s)
        linear_mps, angular_radps = (command.linear_mps, command.angular_radps) if command is not None else (0.0, 0.0)
        told_rad = None if report is None else report.camera_tilt_rad
        tilt_rad = told_rad if told_rad is not None and math.isfinite(told_rad) else last.tilt_rad
        report, wheels_mps = self._read(report)
        possible_mps, possible_radps = abs(linear_mps), abs(angular_radps)
        if report is None:
            linear_mps = linear_mps if abs(linear_mps) >= MIN_COMMAND_MPS else 0.0
            least_radps = angular_radps if abs(angular_radps) >= MIN_COMMAND_RADPS else 0.0
        else:
            left_mps, right_mps = wheels_mps if now_s - report.at_s <= REPORTED_S else (0.0, 0.0)
            possible_mps = abs(left_mps + right_mps) / 2
            possible_radps = abs(right_mps - left_mps) / MAX_TRACK_WIDTH_M
            # The distance between the wheels is the driver's affair, so the best guess of a turn is the commanded one.
            angular_radps = angular_radps if left_mps or right_mps else 0.0
            linear_mps = _lesser(linear_mps, (left_mps + right_mps) / 2)
            least_radps = _lesser(angular_radps, (right_mps - left_mps) / MAX_TRACK_WIDTH_M)
        along_rad = last.heading_rad + angular_radps * step_s / 2
        point = RobotPose(
            at_s=now_s,
            x_m=last.x_m + linear_mps * step_s * math.cos(along_rad),
            y_m=last.y_m + linear_mps * step_s * math.sin(along_rad),
            heading_rad=last.heading_rad + angular_radps * step_s,
            travel_m=last.travel_m + linear_mps * step_s,
            turned_rad=last.turned_rad + least_radps * step_s * math.cos(tilt_rad),
            doubt_m=last.doubt_m + _doubt(linear_mps, possible_mps) * step_s,
            doubt_rad=last.doubt_rad + _doubt(least_radps, possible_radps) * step_s,
            tilt_rad=tilt_rad,
        )
        first = bisect.bisect_left(self.path, now_s - REMEMBERED_S, key=lambda each: each.at_s)
        return EgoMotion(path=(*self.path[first:], point), report=report, wheels_mps=wheels_mps)

    def _read(self, report: BaseReport | None) -> tuple[BaseReport | None, tuple[float, float]]:
        """Return the newest report of the wheels, and their speeds since the one before."""
        before = self.report
        if report is None or not _is_of_wheels(report):
            return None, (0.0, 0.0)
        if before is None or report.at_s <= before.at_s:
            return report, self.wheels_mps
        since_s = report.at_s - before.at_s
        now_m, before_m = (report.left_m or 0.0, report.right_m or 0.0), (before.left_m or 0.0, before.right_m or 0.0)
        left_mps, right_mps = ((now - then) / since_s for now, then in zip(now_m, before_m, strict=True))
        is_anew = max(abs(left_mps), abs(right_mps)) > MAX_WHEEL_MPS
        return report, (0.0, 0.0) if is_anew else (left_mps, right_mps)

    def least_since(self, since_s: float, until_s: float) -> tuple[float, float]:
        """Return by how much it drove, in metres, and turned, in radians, between two times, at least.

        Both are above 0 whichever the direction. Of every lag that is possible the one with the least motion counts.
        """
        lags_s = COMMAND_LAGS_S if self.report is None else LAGS_S
        ends = [(self.at(since_s - lag_s), self.at(until_s - lag_s)) for lag_s in lags_s]
        return (
            min(abs(end.travel_m - begin.travel_m) for begin, end in ends),
            min(abs(end.turned_rad - begin.turned_rad) for begin, end in ends),
        )

    def apart_since(self, since_s: float, until_s: float) -> tuple[float, float]:
        """Return by how much it was, at two times long apart, in other places and directions, at least.

        Unlike in `least_since` a way to and fro may be longer there than back, and it may have turned right round.
        """
        travel_m, turn_rad = self.least_since(since_s, until_s)
        begin, end = self.at(since_s), self.at(until_s)
        if abs(end.heading_rad - begin.heading_rad) > MAX_TURN_RAD:
            return 0.0, 0.0
        doubt_m, doubt_rad = end.doubt_m - begin.doubt_m, end.doubt_rad - begin.doubt_rad
        return max(0.0, travel_m - doubt_m), max(0.0, turn_rad - doubt_rad)

    def at(self, time_s: float) -> RobotPose:
        """Return where it was at a time, between the points of its path; before the path, where that begins."""
        index = bisect.bisect_right(self.path, time_s, key=lambda each: each.at_s)
        if index == 0 or index == len(self.path):
            return self.path[0] if index == 0 else self.path[-1]
        begin, end = self.path[index - 1], self.path[index]
        share = (time_s - begin.at_s) / (end.at_s - begin.at_s)
        values = zip(astuple(begin), astuple(end), strict=True)
        return RobotPose(
            **dict(zip(RobotPose.__struct_fields__, (a + share * (b - a) for a, b in values), strict=True))
        )


def _is_of_wheels(report: BaseReport) -> bool:
    return all(value is not None and math.isfinite(value) for value in (report.left_m, report.right_m))


def _doubt(least: float, possible: float) -> float:
    """Return by how much a speed may be wrong that was taken for the least that is possible."""
    return DOUBT_SHARE * abs(least) + max(0.0, possible - abs(least))


def _lesser(commanded: float, reported: float) -> float:
    """Return the slower of two speeds; 0 if they have not the same direction."""
    return math.copysign(min(abs(commanded), abs(reported)), commanded) if commanded * reported > 0 else 0.0
