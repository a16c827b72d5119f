"""An actuator, a button and a range sensor without hardware."""

from __future__ import annotations

import math
from typing import ClassVar

from msgspec.structs import replace
from pydantic import BaseModel, ConfigDict, Field

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Angle, Duration, Length
from stadimeter.core.command import LevelCommand
from stadimeter.errors import DeviceClosedError, LinkLostError
from stadimeter.sensors.protocol import Echo
from stadimeter.simulation.world import shared_world


class SimulatedActuatorOptions(DriverOptions):
    """The table of a simulated actuator in the configuration."""

    steps: int | None = Field(default=None, ge=1)
    """How many levels above off the device can do; None for any. 1 makes it a switch."""

    def build(self, context: DriverContext) -> SimulatedActuator:
        """Return the actuator."""
        return SimulatedActuator(self, context)

    def is_simulated(self) -> bool:
        """Return True."""
        return True


class SimulatedActuator:
    """An actuator that remembers its level."""

    def __init__(self, options: SimulatedActuatorOptions, context: DriverContext) -> None:
        self.level = 0.0  # the level that it acts with
        self._steps = options.steps
        self._name = context.name
        self.is_open = False

    def open(self) -> None:
        """Be ready, switched off. Does nothing when open."""
        self.is_open = True

    def apply(self, command: LevelCommand) -> LevelCommand:
        """Act as commanded, and return the command with the level rounded to the nearest of the device's steps."""
        self._check_open()
        self.level = round(command.level * self._steps) / self._steps if self._steps else command.level
        return command if self.level == command.level else replace(command, level=self.level)

    def tick(self, now_s: float) -> None:  # noqa: ARG002 -- the protocol has it; this device has no patterns
        """Do nothing: it has no patterns."""
        self._check_open()

    def stop(self) -> None:
        """Switch off at once. Does nothing when closed."""
        if self.is_open:
            self.level = 0.0

    def close(self) -> None:
        """Switch off and be closed. May be called any number of times."""
        self.stop()
        self.is_open = False

    def _check_open(self) -> None:
        if not self.is_open:
            raise DeviceClosedError(f"the simulated actuator '{self._name}' is not open")


# A push button that is pressed by the clock -------------------------------------------------------


class PressTable(BaseModel):
    """A press."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    at: Duration
    """In seconds; when it goes down, after the button was first opened."""
    lasting: Duration = Field(default=0.2, alias="for")
    """In seconds; how long it stays down."""


class SimulatedButtonOptions(DriverOptions):
    """The table of a simulated button in the configuration."""

    presses: tuple[PressTable, ...] = ()
    """When it is pressed."""

    def build(self, context: DriverContext) -> SimulatedButton:
        """Return the button."""
        return SimulatedButton(self, context)

    def is_simulated(self) -> bool:
        """Return True."""
        return True


class SimulatedButton:
    """A button without hardware.

    Attributes:
        is_down: The knob: whether it is held down, besides the presses of its table.
    """

    def __init__(self, options: SimulatedButtonOptions, context: DriverContext) -> None:
        self.is_down = False
        self.is_open = False
        self._presses = options.presses
        self._name = context.name
        self._clock = context.clock
        self._began_s: float | None = None

    def open(self) -> None:
        """Be ready. The presses of its table count from the first time."""
        self.is_open = True
        if self._began_s is None:
            self._began_s = self._clock.now_s()

    def is_pressed(self) -> bool:
        """Check whether it is down."""
        if not self.is_open or self._began_s is None:
            raise DeviceClosedError(f"the simulated button '{self._name}' is not open")
        since_s = self._clock.now_s() - self._began_s
        return self.is_down or any(press.at <= since_s < press.at + press.lasting for press in self._presses)

    def close(self) -> None:
        """Be closed. May be called any number of times."""
        self.is_open = False


# A range sensor in the simulated world: it sees the ball, and nothing else ------------------------


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
