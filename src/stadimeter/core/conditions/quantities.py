"""Every quantity of a target that conditions and ramps may be on, by the name that people write.

Places are in the camera frame: x to the right, y down, z forward along the optical axis, in metres; `ahead` and `left`
are in the robot's frame. Their standard
deviations follow from that of the distance along the line of sight, and from the noise of the angles across it.
What the configuration says of the camera's mounting counts as exact, and so does the middle of the picture.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from operator import mul
from typing import Literal, NamedTuple, get_args

from stadimeter.core.bounds import MIN_QUANTITY, SIZE_UNIT
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.tracking.transverse import AskedMotion
from stadimeter.core.tracking.transverse import direction_of as vector_of

# The figures of tracks that rules are judged by, and their standard deviations ----------------------------------------
#
# A figure is known only while its target is in sight and every number behind it is finite.

DistanceKind = Literal["distance", "depth"]
Direction = Literal["bearing", "elevation"]

# A value, its standard deviation, and the part of that which differs from frame to frame (noise).
Uncertain = tuple[float, float, float]

_TRACKING, _COASTING = TrackStatus.TRACKING, TrackStatus.COASTING
_ROOT_2 = math.sqrt(2)


def quantity_of(track: Track, quantity: DistanceKind) -> Uncertain | None:
    """Return the distance or the depth of a target, in metres; None while there is no finite figure to act on.

    Where the noise is not known apart, the whole standard deviation is taken for noise.
    """
    status = track.status
    if status is not _TRACKING and status is not _COASTING:
        return None
    figure_m = track.distance_m if quantity == "distance" else track.depth_m
    sigma_m, noise_m = track.sigma_m, track.noise_m
    if figure_m is None or sigma_m is None:
        return None
    if noise_m is None:
        noise_m = sigma_m
    return (figure_m, sigma_m, noise_m) if math.isfinite(figure_m + sigma_m + noise_m) else None


def closing_of(track: Track) -> Uncertain | None:
    """Return the closing speed of a target in m/s, all of whose standard deviation is noise; None if not known."""
    return _finite(track, track.closing_mps, track.closing_sigma_mps)


def direction_of(track: Track, quantity: Direction) -> Uncertain | None:
    """Return a direction in radians, its standard deviation, which is unknown, as 0; None if it is not known."""
    return _finite(track, track.bearing_rad if quantity == "bearing" else track.elevation_rad, 0.0)


def separation_of(first: Track, second: Track) -> Uncertain | None:
    """Return the distance of two targets from each other in metres; None if not known.

    The standard deviations follow from those of the two distances, taken as independent, along the line between the
    targets. Those of the directions are not known, and do not count.
    """
    here, there = _sight(first), _sight(second)
    if here is None or there is None:
        return None
    (ax, ay, az), (here_m, sigma_here_m, noise_here_m) = here
    (bx, by, bz), (there_m, sigma_there_m, noise_there_m) = there
    x, y, z = ax * here_m - bx * there_m, ay * here_m - by * there_m, az * here_m - bz * there_m
    apart_m = math.sqrt(x * x + y * y + z * z)
    if apart_m == 0:
        return 0.0, math.hypot(sigma_here_m, sigma_there_m), math.hypot(noise_here_m, noise_there_m)
    share_here, share_there = (ax * x + ay * y + az * z) / apart_m, (bx * x + by * y + bz * z) / apart_m
    sigma_m = math.hypot(share_here * sigma_here_m, share_there * sigma_there_m)
    return apart_m, sigma_m, math.hypot(share_here * noise_here_m, share_there * noise_there_m)


def probability_between(low: float, high: float, value: float, sigma: float) -> float:
    """Return the probability that a normally distributed value is between two thresholds, which may be infinite."""
    return probability_below(high, value, sigma) - probability_below(low, value, sigma)


def probability_below(threshold: float, value: float, sigma: float) -> float:
    """Return the probability that a normally distributed value is below a threshold, which may be infinite."""
    if math.isinf(threshold):
        return 1.0 if threshold > 0 else 0.0
    if sigma <= 0:
        return 1.0 if value < threshold else 0.0
    return 0.5 * math.erfc((value - threshold) / (sigma * _ROOT_2))


def _finite(track: Track, value: float | None, sigma: float | None) -> Uncertain | None:
    status = track.status
    if (status is not _TRACKING and status is not _COASTING) or value is None or sigma is None:
        return None
    return (value, sigma, sigma) if math.isfinite(value + sigma) else None


def _sight(track: Track) -> tuple[tuple[float, float, float], Uncertain] | None:
    """Return the direction to a target as a vector of length 1 (x right, y down, z forward), and its distance."""
    distance = quantity_of(track, "distance")
    bearing, elevation = direction_of(track, "bearing"), direction_of(track, "elevation")
    if distance is None or bearing is None or elevation is None:
        return None
    level = math.cos(elevation[0])
    towards = (level * math.sin(bearing[0]), -math.sin(elevation[0]), level * math.cos(bearing[0]))
    return towards, distance


# Every quantity by its name ------------------------------------------------------------------------------------------

QuantityName = Literal[
    "distance", "depth", "bearing", "elevation", "closing_speed", "x", "y", "z", "ahead", "left", "height",
    "height_above_camera", "sideways_speed", "speed", "size", "still",
]  # fmt: skip

# Those that are a place along one axis.
Axis = Literal["x", "y", "z", "ahead", "left", "height", "height_above_camera"]
AXES: tuple[str, ...] = get_args(Axis)

# The quantity that two targets have together; of the others they have a difference.
OF_TWO = "separation"

# A target that stands must be this far, at least, from where it began to stand to have moved.
STILL_WITHIN_M = 0.1


class Quantity(NamedTuple):
    """A quantity of a target."""

    unit: str
    """Its SI unit."""
    read: Callable[[RuleInputs, str], Uncertain | None]
    """Return it; None while there is no finite figure to act on."""
    is_signed: bool = False
    """Whether it may be below zero."""
    takes_motion: bool = False
    """Whether it follows from the motion across the line of sight."""


def uncertain_of(
    inputs: RuleInputs, target: str, quantity: str, other: str = "", within_m: float = STILL_WITHIN_M
) -> Uncertain | None:
    """Return a quantity of a target, in its SI unit; None while there is no finite figure to act on.

    Args:
        other: The target whose quantity is subtracted, or which the quantity is of too; empty for none.
        within_m: Of standing still, how far from where it began to stand a target still counts as there.
    """
    read = QUANTITIES[quantity].read
    if not other:
        return _still_s(inputs, target, within_m) if quantity == "still" else read(inputs, target)
    if quantity == OF_TWO:
        return separation_of(inputs.tracks[target], inputs.tracks[other])
    first, second, lens = read(inputs, target), read(inputs, other), inputs.viewpoint.lens
    if first is None or second is None:
        return None
    return difference_of(first, second, lens.focal_relative_sigma if lens is not None else 0.0)


def motion_of(target: str, quantity: str, within_m: float = STILL_WITHIN_M) -> AskedMotion | None:
    """Return the motion across the line of sight that a quantity of a target takes; None for none."""
    if not QUANTITIES[quantity].takes_motion:
        return None
    return target, (within_m if quantity == "still" else None)


def noun_of(quantity: str) -> str:
    """Return a quantity in words, such as ``sideways speed``."""
    return {"size": "size in the picture", "still": "time without motion"}.get(quantity, quantity.replace("_", " "))


def difference_of(first: Uncertain, second: Uncertain, common_share: float) -> Uncertain:
    """Return the difference of one quantity of two targets.

    An error of the scale that both have in common changes both values by the same share, and so the difference by that
    share of itself. Noise does not cancel, nor does what is left of the errors that last, such as those of the sizes.

    Args:
        common_share: Standard deviation of the common error of the scale, as a share.
    """
    common = common_share
    for value, sigma, noise in (first, second):
        common = min(common, math.sqrt(max(0.0, sigma * sigma - noise * noise)) / max(abs(value), MIN_QUANTITY))
    variance = first[1] ** 2 + second[1] ** 2 - 2 * common * common * first[0] * second[0]
    return first[0] - second[0], math.sqrt(max(0.0, variance)), math.hypot(first[2], second[2])


def _still_s(inputs: RuleInputs, target: str, within_m: float = STILL_WITHIN_M) -> Uncertain | None:
    motion = inputs.motions.get(target)
    if motion is None or not inputs.tracks[target].is_valid:
        return None
    since_s = next((each.since_s for each in motion.standing if each.within_m == within_m), None)
    return None if since_s is None else (inputs.now_s - since_s, 0.0, 0.0)


def _angle(quantity: Literal["bearing", "elevation"], inputs: RuleInputs, target: str) -> Uncertain | None:
    figures = direction_of(inputs.tracks[target], quantity)
    noise_rad = inputs.viewpoint.angle_noise_rad(inputs.tracks[target], inputs.sightings.get(target))
    return None if figures is None else (figures[0], noise_rad, noise_rad)


def _along(axis: tuple[float, float, float], inputs: RuleInputs, target: str) -> Uncertain | None:
    """Return the distance of a target from the camera along an axis of the camera frame."""
    distance = quantity_of(inputs.tracks[target], "distance")
    bearing, elevation = _angle("bearing", inputs, target), _angle("elevation", inputs, target)
    if distance is None or bearing is None or elevation is None:
        return None
    (distance_m, sigma_m, noise_m), noise_rad = distance, bearing[1]
    share = sum(map(mul, axis, vector_of(bearing[0], elevation[0])))
    across_m = distance_m * noise_rad * math.sqrt(max(0.0, 1.0 - share * share))
    return distance_m * share, math.hypot(share * sigma_m, across_m), math.hypot(share * noise_m, across_m)


def _tilt_rad(inputs: RuleInputs) -> float:
    return inputs.viewpoint.tilt_rad + ((inputs.base.camera_tilt_rad or 0.0) if inputs.base is not None else 0.0)


def _in_robot(axis: Literal[0, 1], inputs: RuleInputs, target: str) -> Uncertain | None:
    """Return the distance of a target ahead of the middle of the robot, or to the left of it."""
    mount = inputs.viewpoint.mount
    figures = _along(mount.axes(_tilt_rad(inputs))[axis], inputs, target)
    return None if figures is None else (figures[0] + (mount.x_m, mount.y_m)[axis], *figures[1:])


def _above_camera(inputs: RuleInputs, target: str) -> Uncertain | None:
    tilt_rad = _tilt_rad(inputs)
    return _along((0.0, -math.cos(tilt_rad), math.sin(tilt_rad)), inputs, target)


def _height(inputs: RuleInputs, target: str) -> Uncertain | None:
    figures, camera_m = _above_camera(inputs, target), inputs.viewpoint.height_m
    return None if figures is None or camera_m is None else (figures[0] + camera_m, *figures[1:])


def _velocity(inputs: RuleInputs, target: str) -> tuple[Uncertain, Uncertain, Uncertain] | None:
    """Return the speed away from the camera, to the right and upwards, each as seen along the line of sight."""
    track, motion = inputs.tracks[target], inputs.motions.get(target)
    closing, distance = closing_of(track), quantity_of(track, "distance")
    if closing is None or distance is None or motion is None or motion.angles is None:
        return None
    across: list[Uncertain] = []
    for angle, lever in zip(motion.angles, (math.cos(track.elevation_rad or 0.0), 1.0), strict=True):
        known, arm_m = angle.estimate(), lever * distance[0]  # in rad and rad/s
        noise, scale = arm_m * math.sqrt(known.var_rate_m2ps2), lever * distance[1] * known.rate_mps
        across.append((arm_m * known.rate_mps, math.hypot(noise, scale), noise))
    return (-closing[0], *closing[1:]), across[0], across[1]


def _sideways_speed(inputs: RuleInputs, target: str) -> Uncertain | None:
    velocity = _velocity(inputs, target)
    return None if velocity is None else velocity[1]


def _speed(inputs: RuleInputs, target: str) -> Uncertain | None:
    """Return the speed in all directions; its standard deviations are those along the direction of motion."""
    velocity = _velocity(inputs, target)
    if velocity is None:
        return None
    speed = math.hypot(*[each[0] for each in velocity])
    shares = [each[0] / speed if speed else 1.0 for each in velocity]
    sigma, noise = (
        math.hypot(*[share * each[part] for share, each in zip(shares, velocity, strict=True)]) for part in (1, 2)
    )
    return speed, sigma, noise


def _size(inputs: RuleInputs, target: str) -> Uncertain | None:
    """Return the larger extent in the picture as a share of its width: as it was seen, moved to the track's distance.

    It has the share of the noise of the distance. Errors of the focal length and of the target's size do not matter.
    """
    distance, sighting = quantity_of(inputs.tracks[target], "distance"), inputs.sightings.get(target)
    if distance is None or distance[0] <= 0 or sighting is None or sighting.size_share is None:
        return None
    size = sighting.size_share * sighting.distance_m / distance[0]
    noise = size * distance[2] / distance[0]
    return (size, noise, noise) if math.isfinite(size + noise) else None


QUANTITIES: dict[str, Quantity] = {
    "distance": Quantity("m", lambda inputs, target: quantity_of(inputs.tracks[target], "distance")),
    "depth": Quantity("m", lambda inputs, target: quantity_of(inputs.tracks[target], "depth")),
    "bearing": Quantity("rad", partial(_angle, "bearing"), is_signed=True),
    "elevation": Quantity("rad", partial(_angle, "elevation"), is_signed=True),
    "closing_speed": Quantity("m/s", lambda inputs, target: closing_of(inputs.tracks[target]), is_signed=True),
    "x": Quantity("m", partial(_along, (1.0, 0.0, 0.0)), is_signed=True),
    "y": Quantity("m", partial(_along, (0.0, 1.0, 0.0)), is_signed=True),
    "z": Quantity("m", partial(_along, (0.0, 0.0, 1.0)), is_signed=True),
    "ahead": Quantity("m", partial(_in_robot, 0), is_signed=True),
    "left": Quantity("m", partial(_in_robot, 1), is_signed=True),
    "height": Quantity("m", _height, is_signed=True),
    "height_above_camera": Quantity("m", _above_camera, is_signed=True),
    "sideways_speed": Quantity("m/s", _sideways_speed, is_signed=True, takes_motion=True),
    "speed": Quantity("m/s", _speed, takes_motion=True),
    "size": Quantity(SIZE_UNIT, _size),
    "still": Quantity("s", _still_s, takes_motion=True),
    "separation": Quantity("m", lambda *_: None),
}
