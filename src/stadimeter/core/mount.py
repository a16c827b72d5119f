"""The place of a camera on a robot, and of what it sees from there, in the axes of REP-103."""

from __future__ import annotations

import math

from msgspec import Struct

Place = tuple[float, float, float]


class Mount(Struct, frozen=True, kw_only=True):
    """A camera on a robot, whose frame has x ahead, y to the left and z up, from the floor below its middle.

    Source: ROS Enhancement Proposal 103. A camera that is mounted nowhere is straight above the middle and looks ahead.

    Attributes:
        x_m: How far the lens is ahead of the middle of the robot.
        y_m: How far it is to the left of it.
        z_m: How high it is above the floor; 0 if that is not known, so that heights are those above the camera.
        yaw_rad: How far it is turned to the left.
        tilt_rad: How far it looks up from level.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    yaw_rad: float = 0.0
    tilt_rad: float = 0.0

    def axes(self, tilt_rad: float) -> tuple[Place, Place, Place]:
        """Return the robot's axes in the camera frame (x right, y down, z forward) at a tilt.

        Looking up by t, the camera has level ahead at ``(0, sin t, cos t)``, the left at ``(-1, 0, 0)`` and up at
        ``(0, -cos t, sin t)``. Turned to the left by ψ, the robot's x is ``cos ψ`` ahead and ``-sin ψ`` left.
        """
        up, level = math.sin(tilt_rad), math.cos(tilt_rad)
        turned, straight = math.sin(self.yaw_rad), math.cos(self.yaw_rad)
        return (turned, straight * up, straight * level), (-straight, turned * up, turned * level), (0.0, -level, up)

    def in_robot(self, position_m: Place) -> Place:
        """Return a place in the robot's frame from one in the camera frame."""
        x, y, z = (sum(a * p for a, p in zip(axis, position_m, strict=True)) for axis in self.axes(self.tilt_rad))
        return self.x_m + x, self.y_m + y, self.z_m + z
