"""A simulated room before a camera that is not there, so that everything can be tried without one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stadimeter.app.capture import capture_for
from stadimeter.app.clock import MonotonicClock
from stadimeter.config.driver_tables import WORLD
from stadimeter.config.plugins import DriverChoice, DriverContext, Shared, load_plugin
from stadimeter.core.camera_model import CameraModel

BALL = "20 cm"
"""The diameter of the ball in the room."""

_PLACE = {"x": "1.1 m", "y": "0 m"}

_LENS = CameraModel.with_focal_length(600.0, 640, 480)


def world_table(ball: str = BALL, place: Mapping[str, str] = _PLACE) -> dict[str, Any]:
    """Return the table ``[world]`` of a room in which a ball lies still.

    Args:
        ball: Its diameter.
        place: Where it lies: ``x`` before the camera and ``y`` to the left.
    """
    return {"ball_diameter": ball, "path": [{"at": "0 s", **place}], "loop": False}


class SimulatedRoom:
    """A room with a ball, and a camera in it whose pictures come at their own pace."""

    def __init__(self, camera: DriverChoice) -> None:
        clock, shared = MonotonicClock(), Shared()
        plugin = load_plugin(WORLD.group, WORLD.default)
        options = plugin.options.model_validate(world_table())
        context = DriverContext(name="world", clock=clock, camera_model=_LENS, shared=shared)
        self.world = plugin.build(options, context)
        self.capture = capture_for(camera.plugin.build(camera.options, context), clock)
