"""Every quantity of a target that conditions and ramps may be on, by the name that people write.

Places are in the camera frame: x to the right, y down, z forward along the optical axis, in metres. Their standard
deviations follow from that of the distance along the line of sight, and from the learnt noise of the angles across it.
What the configuration says of the camera's mounting counts as exact, and so does the middle of the picture.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from operator import mul
from typing import Literal, NamedTuple

from stadimeter.core.bounds import MAX_ANGLE_RAD, MAX_LENGTH_M, MAX_SPEED_MPS, MIN_QUANTITY
from stadimeter.core.conditions.figures import Uncertain, closing_of, direction_of, quantity_of
from stadimeter.core.conditions.leaf import UNKNOWN, Figure, RuleInputs
from stadimeter.core.transverse_motion import AskedMotion
from stadimeter.core.transverse_motion import direction_of as vector_of

QuantityName = Literal[
    "distance", "depth", "bearing", "elevation", "closing_speed", "x", "y", "z", "height", "height_above_camera",
    "sideways_speed", "speed", "size",
]  # fmt: skip

# The largest share of the picture's width that is taken: a target nearer than that is not seen whole.
MAX_SIZE = 10.0

# The unit of the size in the picture.
SIZE_UNIT = "of the width"


class Quantity(NamedTuple):
    """A quantity of a target."""

    unit: str
    """Its SI unit."""
    read: Callable[[RuleInputs, str], Uncertain | None]
    """Return it; None while there is no finite figure to act on."""
    needs_motion: bool = False
    """Whether it, or how sure it is, follows from the motion across the line of sight."""
    is_signed: bool = False
    """Whether it may be below zero."""

    @property
    def bounds(self) -> tuple[float, float]:
        """The least and the largest value that a threshold may have."""
        most = {"m": MAX_LENGTH_M, "m/s": MAX_SPEED_MPS, "rad": MAX_ANGLE_RAD, SIZE_UNIT: MAX_SIZE}[self.unit]
        return -most if self.is_signed else MIN_QUANTITY, most


def uncertain_of(inputs: RuleInputs, target: str, quantity: QuantityName) -> Uncertain | None:
    """Return a quantity of a target, in its SI unit; None while there is no finite figure to act on."""
    return QUANTITIES[quantity].read(inputs, target)


def quantity_figure(target: str, quantity: QuantityName) -> Figure:
    """Return the figure of a quantity of a target."""
    motions = (AskedMotion(target),) if QUANTITIES[quantity].needs_motion else ()
    return Figure(_value, (target, quantity), motions)


def noun_of(quantity: QuantityName) -> str:
    """Return a quantity in words, such as ``sideways speed``."""
    return "size in the picture" if quantity == "size" else quantity.replace("_", " ")


def difference_of(first: Uncertain, second: Uncertain, common_share: float) -> Uncertain:
    """Return the difference of one quantity of two targets.

    An error of the scale that both have in common changes both values by the same share, and so the difference by that
    share of itself. Noise does not cancel, nor does what is left of the errors that last, such as those of the sizes.

    Args:
        common_share: Standard deviation of the common error of the scale, as a share.
    """
    own: list[float] = []
    common = 0.0
    for sign, (value, sigma, noise) in ((1, first), (-1, second)):
        lasting = max(0.0, sigma * sigma - noise * noise)
        shared = min(math.sqrt(lasting), common_share * abs(value))
        common += sign * math.copysign(shared, value)
        own.append(math.sqrt(max(0.0, lasting - shared * shared)))
    noise = math.hypot(first[2], second[2])
    return first[0] - second[0], math.hypot(noise, *own, common), noise


def _value(inputs: RuleInputs, target: str, quantity: QuantityName) -> float:
    figures = uncertain_of(inputs, target, quantity)
    return UNKNOWN if figures is None else figures[0]


def _of_track(quantity: Literal["distance", "depth"], inputs: RuleInputs, target: str) -> Uncertain | None:
    return quantity_of(inputs.tracks[target], quantity)


def _closing(inputs: RuleInputs, target: str) -> Uncertain | None:
    return closing_of(inputs.tracks[target])


def _angle(quantity: Literal["bearing", "elevation"], inputs: RuleInputs, target: str) -> Uncertain | None:
    figures, motion = direction_of(inputs.tracks[target], quantity), inputs.motions.get(target)
    if figures is None or motion is None:
        return figures
    return figures[0], motion.angle_noise_rad, motion.angle_noise_rad


def _along(axis: tuple[float, float, float], inputs: RuleInputs, target: str) -> Uncertain | None:
    """Return how far a target is from the camera along an axis of the camera frame."""
    distance = quantity_of(inputs.tracks[target], "distance")
    bearing, elevation = _angle("bearing", inputs, target), _angle("elevation", inputs, target)
    if distance is None or bearing is None or elevation is None:
        return None
    (distance_m, sigma_m, noise_m), (b, angle_sigma, _), (e, _, _) = distance, bearing, elevation
    share = sum(map(mul, axis, vector_of(b, e)))
    by_bearing = math.cos(e) * (axis[0] * math.cos(b) - axis[2] * math.sin(b))
    by_elevation = sum(map(mul, axis, (-math.sin(e) * math.sin(b), -math.cos(e), -math.sin(e) * math.cos(b))))
    across_m = distance_m * angle_sigma * math.hypot(by_bearing, by_elevation)
    return distance_m * share, math.hypot(share * sigma_m, across_m), math.hypot(share * noise_m, across_m)


def _above_camera(inputs: RuleInputs, target: str) -> Uncertain | None:
    tilt_rad = inputs.viewpoint.tilt_rad + ((inputs.base.camera_tilt_rad or 0.0) if inputs.base is not None else 0.0)
    return _along((0.0, -math.cos(tilt_rad), math.sin(tilt_rad)), inputs, target)


def _height(inputs: RuleInputs, target: str) -> Uncertain | None:
    figures, camera_m = _above_camera(inputs, target), inputs.viewpoint.height_m
    return None if figures is None or camera_m is None else (figures[0] + camera_m, *figures[1:])


def _velocity(inputs: RuleInputs, target: str) -> tuple[Uncertain, Uncertain, Uncertain] | None:
    """Return the speed away from the camera, to the right and upwards, each as seen along the line of sight."""
    track, motion = inputs.tracks[target], inputs.motions.get(target)
    closing, distance = closing_of(track), quantity_of(track, "distance")
    if closing is None or distance is None or motion is None or track.elevation_rad is None:
        return None
    if motion.bearing is None or motion.elevation is None:
        return None
    distance_m, sigma_m, _ = distance
    across: list[Uncertain] = []
    for angle, lever in ((motion.bearing, math.cos(track.elevation_rad)), (motion.elevation, 1.0)):
        rate, noise = lever * angle.rate_radps, lever * distance_m * math.sqrt(angle.var_rate)
        across.append((distance_m * rate, math.hypot(noise, sigma_m * rate), noise))
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


QUANTITIES: dict[QuantityName, Quantity] = {
    "distance": Quantity("m", partial(_of_track, "distance")),
    "depth": Quantity("m", partial(_of_track, "depth")),
    "bearing": Quantity("rad", partial(_angle, "bearing"), True, True),
    "elevation": Quantity("rad", partial(_angle, "elevation"), True, True),
    "closing_speed": Quantity("m/s", _closing, False, True),
    "x": Quantity("m", partial(_along, (1.0, 0.0, 0.0)), True, True),
    "y": Quantity("m", partial(_along, (0.0, 1.0, 0.0)), True, True),
    "z": Quantity("m", partial(_along, (0.0, 0.0, 1.0)), True, True),
    "height": Quantity("m", _height, True, True),
    "height_above_camera": Quantity("m", _above_camera, True, True),
    "sideways_speed": Quantity("m/s", _sideways_speed, True, True),
    "speed": Quantity("m/s", _speed, True, False),
    "size": Quantity(SIZE_UNIT, _size),
}
