"""A range sensor in the simulated world: it sees the ball, and nothing else."""

from __future__ import annotations

import math
from typing import ClassVar

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Angle, Length
from stadimeter.errors import DeviceClosedError, LinkLostError
from stadimeter.sensors.protocol import Echo
from stadimeter.simulation.world import shared_world


class SimulatedRangeSensorOptions(DriverOptions):
    """The table of a simulated range sensor in the configuration."""

    needs_world: ClassVar = True

    beam: Angle = math.radians(15)
    """The full width of its beam; what is beside it is not seen."""
    max_range: Length = 4.0
    """In metres; what is further away counts as nothing."""
    sigma: Length = 0.01
    """In metres; the standard deviation that it states. It measures the truth."""

    def build(self, context: DriverContext) -> SimulatedRangeSensor:
        """Return the sensor."""
        return SimulatedRangeSensor(self, context)

    def is_simulated(self) -> bool:
        """Return True."""
        return True


class SimulatedRangeSensor:
    """A `RangeSensor` at the camera, which looks along its axis. The knob ``sensors_silent`` has it answer nothing."""

    period_s: ClassVar = 0.05

    def __init__(self, options: SimulatedRangeSensorOptions, context: DriverContext) -> None:
        self._options = options
        self._name = context.name
        self._clock = context.clock
        self._world = shared_world(context)
        self._is_open = False

    def open(self) -> None:
        """Begin to measure."""
        self._is_open = True

    def read(self) -> Echo | None:
        """Measure how far the surface of the ball is, if it is within the beam and shown."""
        if not self._is_open:
            raise DeviceClosedError(f"the simulated sensor '{self._name}' is not open")
        if self._world.faults.sensors_silent:
            raise LinkLostError(f"the simulated sensor '{self._name}' does not answer")
        x_m, _, z_m = self._world.target_in_camera()
        distance_m = self._world.distance_m() - self._world.ball.diameter_m / 2
        is_seen = not self._world.faults.target_hidden and abs(math.atan2(x_m, z_m)) <= self._options.beam / 2
        if not is_seen or distance_m > self._options.max_range:
            distance_m = math.inf
        return Echo(at_s=self._clock.now_s(), distance_m=distance_m, sigma_m=self._options.sigma)

    def close(self) -> None:
        """Cease to measure."""
        self._is_open = False
