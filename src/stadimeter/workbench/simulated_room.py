"""A simulated room before a camera that is not there, so that everything can be tried without one."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from stadimeter.app.capture import capture_for
from stadimeter.app.clock import MonotonicClock
from stadimeter.config.driver_tables import WORLD
from stadimeter.config.plugins import DriverChoice, DriverContext, Shared, load_driver
from stadimeter.config.units import parse_length
from stadimeter.core.camera_model import CameraModel
from stadimeter.errors import ConfigError

if TYPE_CHECKING:  # no command loads a driver that nobody named
    from stadimeter.simulation.protocol import StagedWorld

BALL = "20 cm"
"""The diameter of the ball in the room."""

CAMERA_HEIGHT = "25 cm"

MAX_DISTANCE_M = 8.0
"""Beyond this nothing is put: the ball would be a few pixels."""

_LENS = CameraModel.with_focal_length(600.0, 640, 480)


class SimulatedRoom:
    """A room with a ball, and a camera in it whose pictures come at their own pace."""

    def __init__(self, camera: DriverChoice) -> None:
        clock, shared = MonotonicClock(), Shared()
        # At the height of the camera, so that a distance is one along the floor.
        options = load_driver(WORLD.group, WORLD.default).model_validate(
            {"ball_diameter": BALL, "ball_height": CAMERA_HEIGHT, "camera_height": CAMERA_HEIGHT}
        )
        context = DriverContext(name="world", clock=clock, camera_model=_LENS, shared=shared)
        self._world: StagedWorld = options.build(context)
        self._radius_m = parse_length(BALL) / 2
        self.capture = capture_for(camera.options.build(context), clock)
        self.place(1.0 + self._radius_m, 0.0)

    def place(self, x_m: float, y_m: float) -> None:
        """Put the middle of the ball so far ahead of the camera, and to its left; a `ConfigError` if it cannot be."""
        if not (math.hypot(x_m, y_m) <= MAX_DISTANCE_M and x_m > self._radius_m):
            raise ConfigError(
                f"the ball can be {self._radius_m:g} to {MAX_DISTANCE_M:g} m before the camera, "
                f"not at {x_m:g}, {y_m:g} m"
            )
        self._world.place_target(x_m, y_m)
        self._place_m = x_m, y_m

    def where(self) -> dict[str, float]:
        """Return where the ball was put: its middle, and how far away its nearest point is, as by a tape."""
        x_m, y_m = self._place_m
        return {"x_m": x_m, "y_m": y_m, "distance_m": math.hypot(x_m, y_m) - self._radius_m}
