"""A test of normalised innovation, whether a target appears where it must, given how the robot has turned and driven.

This is the second line of liveness, for rooms too plain for the first: a frozen picture shows the target in the same
direction and at the same distance for ever, so a robot that turns towards it turns for ever. Taken for true, such a
target would run around the robot in a circle.

Each sighting is put on the map by the robot's own motion, and a filter of constant velocity predicts the next, a
quarter of a second later (Y. Bar-Shalom, "Estimation with Applications to Tracking and Navigation", 2001, section
5.4). The innovation, over its standard deviation, has two coordinates of variance 1 if the target is alive, and each
is new. In the frame of the camera a target that is frozen in the picture errs to the same side each time. So k
innovations are added up in that frame, and the square of their sum over k has the chi-square distribution with 2
degrees of freedom. A target may run and bounce as it likes: only sightings over which it stayed where it was in the
picture count, and each for no more than `MAX_SIGMAS`.

What is driven straight on proves nothing in this way: a person may well walk ahead at the robot's speed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from msgspec import Struct

from stadimeter.core.ego_motion import EgoMotion
from stadimeter.core.measurement import Measurement, MeasurementStatus

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
STILL_SHARE = 0.05

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
        and abs(looks[1] - before.seen[1]) <= STILL_SHARE * before.seen[1]
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
