"""Knowledge of a target that stands on the floor, and of the camera above it."""

from __future__ import annotations

import math

from msgspec import Struct

# Standard deviations of the camera's height and tilt where the configuration states none: a tape measure along a robot,
# and a protractor on a small camera.
HEIGHT_SIGMA_M, TILT_SIGMA_RAD = 0.01, math.radians(1)


class Footing(Struct, frozen=True, kw_only=True):
    """The camera above a level floor, and what of a target is on it.

    Attributes:
        height_m: How high the camera is above the floor.
        tilt_rad: How far it looks up from level.
        tilt_sigma_rad: Standard deviation of the tilt, and of how level the camera is across.
        centre_m: How high the target's centre is above the floor, 0 of what lies flat on it; None for a target that
            stands upright on its lowest edge, or rests on it as a ball does.
    """

    height_m: float
    height_sigma_m: float = HEIGHT_SIGMA_M
    tilt_rad: float = 0.0
    tilt_sigma_rad: float = TILT_SIGMA_RAD
    centre_m: float | None = None
    centre_sigma_m: float = 0.0
