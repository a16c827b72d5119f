"""Liveness by motion: a camera that rides on the base must see that it moves.

A picture can be new in every frame and show nothing of what is: a clock that runs over a frozen sensor, a frozen
picture with noise. What no such picture can show is the robot's own motion. So while the wheels turn, the blocks of
the picture must flow (`PictureFlow`), by as much as the way and the turn since the earlier picture make at least.

The flow that is expected at least, in pixels, is that of a turn, or of a drive towards walls `ROOM_DEPTH_M` away:
``f · Δψ`` or ``x · Δs / Z``. The picture stands still, for one frame, if the measured flow is below `STILL_SHARE` of
this. How sure that is, in standard deviations, is added up over the frames (E. S. Page, "Continuous inspection
schemes", 1954); a frame that flows takes off as much. Below `MIN_FLOW_PX` nothing is claimed. In rooms too plain for
this, the target is the second line: see `TargetInnovation`.

With a picture that is found to stand still, everything stops until the run is armed again: the camera is frozen, or the
robot pushes against something while its wheels slip; neither is a reason to drive on.

Old pictures that come again flow as they once did. So the newest picture is also compared with those of the last 25 s
that it looks like: if it stands still beside one that was taken elsewhere, it is that picture, whatever has been drawn
over it or become of it. Where the robot has not moved on since, nothing is claimed: views come again there by right. A
scrolled picture is found in the same way, once it is slid back: no drive is left in it.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Mapping, Sequence

from msgspec import Struct, field
from msgspec.structs import astuple, replace

from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.core.decision import Event, EventKind, Severity
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.core.observation import FlowSince, Observation, PictureFlow

# The robot's motion of late: by its wheels where they report, else as it was commanded --------------------------------

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


# A test of normalised innovation, whether a target appears where it must, given how the robot has turned and
# driven.
#
# This is the second line of liveness, for rooms too plain for the first: a frozen picture shows the target in the
# same direction and at the same distance for ever, so a robot that turns towards it turns for ever. Taken for true,
# such a target would run around the robot in a circle.
#
# Each sighting is put on the map by the robot's own motion, and a filter of constant velocity predicts the next, a
# quarter of a second later (Y. Bar-Shalom, "Estimation with Applications to Tracking and Navigation", 2001, section
# 5.4). The innovation, over its standard deviation, has two coordinates of variance 1 if the target is alive, and
# each is new. In the frame of the camera a target that is frozen in the picture errs to the same side each time. So
# k innovations are added up in that frame, and the square of their sum over k has the chi-square distribution with
# 2 degrees of freedom. A target may run and bounce as it likes: only sightings over which it stayed where it was in
# the picture count, and each for no more than `MAX_SIGMAS`.
#
# What is driven straight on proves nothing in this way: a person may well walk ahead at the robot's speed.

# From one sighting that is judged to the next; in a quarter of a second a robot turns by far more than is measured.
STEP_S = 0.25

# After a longer pause the target is a new one.
MAX_PAUSE_S = 0.6

# Standard deviations of a target's acceleration, and of its speed when it is first seen: a person who walks on at 1 m/s
# in a circle of 2 m accelerates by 0.5 m/s². Starts and stops are faster, and move the target in the picture.
ACCELERATION_MPS2 = 0.5
SPEED_MPS = 1.0

# What a place on the map is off by, as a share of the distance: the bearing, and the robot's own turn.
PLACE_SHARE = 0.01

# A target that moved by more than this in the picture was seen to move, so the picture lives.
STILL_BEARING_RAD = 0.03
STILL_INNOVATION_SHARE = 0.05

# One sighting counts for no more: a ball that bounces once is no frozen picture.
MAX_SIGMAS = 4.0

# Innovations that are added up at least and at most, and the probability of a false alarm for each sum.
MIN_STEPS = 4
MAX_STEPS = 12
FALSE_ALARM = 1e-6


class TargetInnovation(Struct, frozen=True, kw_only=True):
    """The test's memory of one target.

    Attributes:
        at_s: The capture time of the last sighting that was judged.
        place_m: Where the target was on the map of the robot's path.
        velocity_mps: Its velocity there.
        covariance: Of place and velocity along one axis: of the place, of both, of the velocity.
        seen: The bearing and the distance from which it has not moved in the picture.
        innovations: The normalised innovations since then, oldest first, ahead and to the left of the camera.
    """

    at_s: float
    place_m: tuple[float, float]
    velocity_mps: tuple[float, float] = (0.0, 0.0)
    covariance: tuple[float, float, float]
    seen: tuple[float, float]
    innovations: tuple[tuple[float, float], ...] = ()

    @property
    def false_alarm(self) -> float:
        """The probability that a live target is as far from its predictions as this one: 1 for too few sightings."""
        count = len(self.innovations)
        if count < MIN_STEPS:
            return 1.0
        square = sum(sum(axis) ** 2 for axis in zip(*self.innovations, strict=True)) / count
        return math.exp(-square / 2)


def step_innovation(before: TargetInnovation | None, seen: Measurement, ego: EgoMotion) -> TargetInnovation | None:
    """Take in a sighting of a target; None while it is not measured."""
    if seen.status is not MeasurementStatus.MEASURED or seen.position_m is None or seen.distance_m is None:
        return before
    if before is not None and seen.captured_at_s - before.at_s < STEP_S:
        return before
    place_m, variance = _on_map(seen.position_m, ego, seen.captured_at_s), (PLACE_SHARE * seen.distance_m) ** 2
    variance += (seen.noise_m or 0.0) ** 2
    looks = (seen.bearing_rad or 0.0, seen.distance_m)
    if before is None or seen.captured_at_s - before.at_s > MAX_PAUSE_S:
        covariance = (variance, 0.0, SPEED_MPS**2)
        return TargetInnovation(at_s=seen.captured_at_s, place_m=place_m, covariance=covariance, seen=looks)
    return _filter(before, seen.captured_at_s, place_m, variance, looks, ego.at(seen.captured_at_s).heading_rad)


def _filter(
    before: TargetInnovation,
    at_s: float,
    place_m: tuple[float, float],
    variance: float,
    looks: tuple[float, float],
    heading_rad: float,
) -> TargetInnovation:
    """Predict with constant velocity, and correct by what was seen: a Kalman filter of two axes with one covariance."""
    step_s = at_s - before.at_s
    place, both, velocity = before.covariance
    acceleration = ACCELERATION_MPS2**2
    place += 2 * step_s * both + step_s**2 * velocity + acceleration * step_s**4 / 4
    both += step_s * velocity + acceleration * step_s**3 / 2
    velocity += acceleration * step_s**2
    predicted_m = [p + step_s * v for p, v in zip(before.place_m, before.velocity_mps, strict=True)]
    innovation_m = [seen - p for seen, p in zip(place_m, predicted_m, strict=True)]
    total = place + variance
    gain, gain_per_s = place / total, both / total
    is_still = (
        abs(looks[0] - before.seen[0]) <= STILL_BEARING_RAD
        and abs(looks[1] - before.seen[1]) <= STILL_INNOVATION_SHARE * before.seen[1]
    )
    return TargetInnovation(
        at_s=at_s,
        place_m=(predicted_m[0] + gain * innovation_m[0], predicted_m[1] + gain * innovation_m[1]),
        velocity_mps=(
            before.velocity_mps[0] + gain_per_s * innovation_m[0],
            before.velocity_mps[1] + gain_per_s * innovation_m[1],
        ),
        covariance=((1 - gain) * place, (1 - gain) * both, velocity - gain_per_s * both),
        seen=before.seen if is_still else looks,
        innovations=(*before.innovations[1 - MAX_STEPS :], _in_camera(innovation_m, total**0.5, heading_rad))
        if is_still
        else (),
    )


def _in_camera(innovation_m: Sequence[float], sigma_m: float, heading_rad: float) -> tuple[float, float]:
    """Return an innovation on the map over its standard deviation, ahead and to the left, at most `MAX_SIGMAS` long."""
    east, north = (each / sigma_m for each in innovation_m)
    share = MAX_SIGMAS / max(MAX_SIGMAS, math.hypot(east, north))
    cos, sin = share * math.cos(heading_rad), share * math.sin(heading_rad)
    return (east * cos + north * sin, north * cos - east * sin)


def _on_map(position_m: tuple[float, float, float], ego: EgoMotion, at_s: float) -> tuple[float, float]:
    """Return where a place in the camera frame, x right and z forward, was on the map of the robot's path."""
    right_m, down_m, forward_m = position_m
    robot = ego.at(at_s)
    forward_m = forward_m * math.cos(robot.tilt_rad) + down_m * math.sin(robot.tilt_rad)
    cos, sin = math.cos(robot.heading_rad), math.sin(robot.heading_rad)
    return (robot.x_m + forward_m * cos + right_m * sin, robot.y_m + forward_m * sin - right_m * cos)


# What is seen in a room is this far away at most, as a median over the picture. In larger halls, and out of doors,
# liveness cannot be judged by driving straight on.
ROOM_DEPTH_M = 5.0

# A flow below this, in pixels of a picture reduced to 160, does not differ from none: 3 cm of driving, 0.1° of turning.
MIN_FLOW_PX = 0.2

# Larger shifts are measured too small, but never as less than about a pixel.
MAX_FLOW_PX = 1.0

# A picture stands still if it flows by less than this share of what is expected: depths differ, motors are slow.
STILL_SHARE = 0.4

# A picture that has come again was taken elsewhere if it would have flowed since by this at least: after 6 cm of a way
# in a room, or 0.2° of a turn. What would have flowed by the greater one may be shifted by a pixel as well.
MIN_APART_PX = 0.4
MAX_APART_PX = 2.0

# It stands still if three quarters of its blocks flow by less than this share of that. Those of live pictures flowed by
# twice the share and more, in 20 min of walks through rooms.
AGAIN_SHARE = 0.6

# That it has come again is believed after three clear looks, or more that are less clear.
AGAIN_SCORE = 7.5

# A look that could not tell standing from flowing by this many standard deviations says nothing.
MIN_SIGMAS = 2.0

# A look counts while the view turns by no more than this from one picture to the next: textures of two pixels and more
# are still the same then.
MAX_STEP_PX = 3.0

# One frame counts for no more than this many standard deviations, less the drift; the sum that stops the robot is that
# of two clear frames, or of more that are less clear.
MAX_SCORE = 3.0
DRIFT = 0.5
STOP_SCORE = 5.0

# With less texture, as a share of the picture's blocks, a room is too plain to tell.
MIN_TEXTURED = 0.15


class LivenessState(Struct, frozen=True, kw_only=True):
    """The state that liveness remembers.

    Attributes:
        ego: How the robot has moved.
        score: How sure it is that the picture stands still although the wheels turn, 0 and more.
        again_scores: How sure it is that pictures have come again that were taken elsewhere, 0 and more: as they were,
            and slid.
        targets: How each target appeared, against the robot's motion.
        may_act: Whether outputs might act in the cycle before.
    """

    ego: EgoMotion = EgoMotion()
    score: float = 0.0
    again_scores: tuple[float, float] = (0.0, 0.0)
    targets: Mapping[str, TargetInnovation] = field(default_factory=dict)
    may_act: bool = False


def step_liveness(
    state: LivenessState, observation: Observation, command: TwistCommand | None, *, is_new: bool
) -> tuple[LivenessState, str]:
    """Judge one cycle; return also why the picture is not believed, in words, or an empty string.

    Args:
        command: What the base was commanded to do in the cycle before; None without a base.
        is_new: Whether the frame is a new one, with a sound stamp.
    """
    if command is None:
        return state, ""
    state = replace(state, ego=state.ego.step(observation.now_s, command, observation.base))
    if not is_new or observation.flow is None or observation.frame is None:
        return state, ""
    score, still = _step_score(state, observation.flow, observation.frame.captured_at_s)
    again_scores, again = _step_again(state, observation.flow, observation.frame.captured_at_s)
    # Range sensors measure at times of their own, and show what stands before the robot wherever it turns.
    at_s = observation.frame.captured_at_s
    of_camera = tuple([seen for seen in observation.measurements if seen.captured_at_s == at_s])
    targets, unmoved = _step_targets(state, of_camera)
    # What was found is found anew after the run is armed again, and not from what was before.
    if cause := still or again or unmoved:
        return replace(state, score=0.0, again_scores=(0.0, 0.0), targets={}), cause
    return replace(state, score=score, again_scores=again_scores, targets=targets), ""


def _step_score(state: LivenessState, picture: PictureFlow, at_s: float) -> tuple[float, str]:
    """Judge the youngest look that can tell; return the score, and why the picture is not believed."""
    for flow in picture.since:
        travel_m, turn_rad = state.ego.least_since(flow.since_s, at_s)
        expected_px = _expected_px(flow, travel_m, turn_rad)
        step_px = flow.focal_px * turn_rad * flow.step_s / max(at_s - flow.since_s, flow.step_s)
        if expected_px < MIN_FLOW_PX or step_px > MAX_STEP_PX:
            continue
        if (sigmas := _still_sigmas(flow, STILL_SHARE * min(expected_px, MAX_FLOW_PX))) is None:
            continue
        score = _added(state.score, sigmas)
        way = f"{1e2 * travel_m:.0f} cm and {turn_rad:.2f} rad in {at_s - flow.since_s:.2f} s"
        cause = f"the picture stands still while the wheels turn ({way}): it is frozen, or the wheels slip"
        return score, cause if score >= STOP_SCORE else ""
    return state.score, ""


def _step_again(state: LivenessState, picture: PictureFlow, at_s: float) -> tuple[tuple[float, float], str]:
    """Judge the picture of long ago that the newest looks like; return the scores, and why it is not believed."""
    as_it_was, slid = state.again_scores
    for flow in picture.again:
        travel_m, turn_rad = state.ego.apart_since(flow.since_s, at_s)
        expected_px = min(_expected_px(flow, travel_m, turn_rad), MAX_APART_PX)
        if expected_px < MIN_APART_PX or (sigmas := _still_sigmas(flow, AGAIN_SHARE * expected_px)) is None:
            continue
        if flow.is_slid:
            slid = score = _added(slid, sigmas)
        else:
            as_it_was = score = _added(as_it_was, sigmas)
        if score >= AGAIN_SCORE:
            way = f"{at_s - flow.since_s:.1f} s ago, and {1e2 * travel_m:.0f} cm and {turn_rad:.2f} rad from here"
            return (as_it_was, slid), f"old pictures have come again: this one is of {way} at least"
    return (as_it_was, slid), ""


def _added(score: float, sigmas: float) -> float:
    return max(0.0, score + max(-MAX_SCORE, min(MAX_SCORE, sigmas)) - DRIFT)


def _step_targets(
    state: LivenessState, measurements: tuple[Measurement, ...]
) -> tuple[Mapping[str, TargetInnovation], str]:
    """Take in what was measured; return also which target is not where the robot's motion must make it appear."""
    targets = dict(state.targets)
    for seen in measurements:
        innovation = step_innovation(targets.get(seen.target), seen, state.ego)
        if innovation is not None:
            targets[seen.target] = innovation
            if innovation.false_alarm <= FALSE_ALARM:
                return (
                    targets,
                    f"'{seen.target}' stays in its place in the picture, however the robot turns: it is frozen",
                )
    return targets, ""


def _expected_px(flow: FlowSince, travel_m: float, turn_rad: float) -> float:
    """Return by how much a picture flows at least when the robot has driven and turned."""
    of_turn_px = 0.0 if flow.is_slid else flow.focal_px * turn_rad
    return max(of_turn_px, flow.aside_px * travel_m / ROOM_DEPTH_M)


def _still_sigmas(flow: FlowSince, still_px: float) -> float | None:
    """Return the certainty that a picture flows by less than this, in standard deviations; below 0 if by more.

    None if this look does not say so, for too much noise.
    """
    still_px2 = still_px**2
    # Pictures that are equal to the last bit scatter by nothing at all.
    sigma_px2 = max(flow.sigma_px2, 1e-6)
    is_clear = still_px2 >= MIN_SIGMAS * sigma_px2 or flow.shift2_px2 >= still_px2
    return (still_px2 - flow.shift2_px2) / sigma_px2 if is_clear else None


def tell_plain_room(
    state: LivenessState, observation: Observation, *, may_act: bool
) -> tuple[LivenessState, tuple[Event, ...]]:
    """Return an event if outputs may act from now on, and the room is too plain to tell a frozen picture.

    Args:
        may_act: Whether outputs may act in this cycle.
    """
    flow = observation.flow
    if flow is None or may_act is state.may_act:
        return state, ()
    state = replace(state, may_act=may_act)
    if not may_act or flow.textured >= MIN_TEXTURED:
        return state, ()
    reason = (
        f"only {100 * flow.textured:.0f} % of the picture has texture, {100 * MIN_TEXTURED:.0f} % are needed: here a "
        "frozen picture looks like a live one, also while the robot drives"
    )
    event = Event(
        kind=EventKind.LIVENESS_UNKNOWN,
        source="camera",
        at_s=observation.now_s,
        severity=Severity.WARNING,
        reason=reason,
    )
    return state, (event,)
