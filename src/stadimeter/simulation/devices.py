"""A robot base, an actuator, a button and a range sensor without hardware; the base drives the simulated robot."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

from msgspec.structs import replace
from pydantic import BaseModel, ConfigDict, Field

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Angle, Duration, Length, Speed
from stadimeter.core.command import BaseReport, LevelCommand, TwistCommand
from stadimeter.errors import DeviceClosedError, DeviceOpenError, LinkLostError
from stadimeter.sensors.protocol import Echo
from stadimeter.simulation.world import shared_world


class SimulatedBaseOptions(DriverOptions):
    """The options of a simulated base."""

    needs_world: ClassVar = True

    max_wheel_speed: Annotated[Speed, Field(gt=0)] = 0.5
    """No wheel runs faster."""
    auto_stop: Duration = 2.0
    """The wheels stop when no command came for this long, as firmware does; 0 for never."""

    def build(self, context: DriverContext) -> SimulatedBase:
        """Return the base."""
        return SimulatedBase(self, context)

    def is_simulated(self) -> bool:
        """Return True."""
        return True


class SimulatedBase:
    """A base that drives the simulated robot.

    **It stops by itself** ``auto_stop`` after the last command. It honours the knob ``base_unplugged``: the link is
    then lost until the base is opened again, and the wheels run on until they stop by themselves.

    Raises:
        ConfigError: The run has no world.
    """

    def __init__(self, options: SimulatedBaseOptions, context: DriverContext) -> None:
        self._name = context.name
        self._clock = context.clock
        self._world = shared_world(context)
        self._max_wheel_mps = options.max_wheel_speed
        self._auto_stop_s = options.auto_stop or math.inf
        self._is_open = False
        self._is_lost = False

    def open(self) -> None:
        """Connect, and make the robot stand; a `DeviceOpenError` if the base is unplugged. Does nothing when open."""
        if self._is_open:
            return
        if self._world.faults.base_unplugged:
            raise DeviceOpenError(f"the simulated base '{self._name}' is unplugged")
        self._is_open, self._is_lost = True, False
        self._drive(0.0, 0.0)

    def apply(self, command: TwistCommand) -> TwistCommand:
        """Move as commanded; return the motion, slowed down along the same curve if a wheel would run too fast.

        Raises:
            LinkLostError: The base was unplugged.
        """
        self._check_link()
        half_track_m = self._world.robot.track_width_m / 2
        left_mps = command.linear_mps - command.angular_radps * half_track_m
        right_mps = command.linear_mps + command.angular_radps * half_track_m
        share = min(1.0, self._max_wheel_mps / max(abs(left_mps), abs(right_mps), self._max_wheel_mps))
        self._drive(left_mps * share, right_mps * share)
        return replace(
            command, linear_mps=command.linear_mps * share, angular_radps=command.angular_radps * share, tilt_radps=0.0
        )

    def tick(self, now_s: float) -> None:  # noqa: ARG002 -- the protocol has it; the world's clock is the same
        """Raise a `LinkLostError` if the base was unplugged."""
        self._check_link()

    def report(self) -> BaseReport | None:
        """Report how far the wheels have rolled, and whether the bumper is pressed; None before the base is open."""
        if not self._is_open:
            return None
        robot = self._world.robot
        left_m, right_m = (ticks / robot.ticks_per_metre for ticks in robot.ticks)
        bumped = self._world.faults.bumper_pressed
        return BaseReport(at_s=self._clock.now_s(), is_bumped=bumped, left_m=left_m, right_m=right_m)

    def stop(self) -> None:
        """Stand still at once, if open; a `LinkLostError` if the base was unplugged: it stops only by itself."""
        if self._is_open:
            self._check_link()
            self._drive(0.0, 0.0)

    def close(self) -> None:
        """Stop and disconnect, any number of times; a `LinkLostError` for an unplugged base, which is closed too."""
        try:
            self.stop()
        finally:
            self._is_open = False

    def _drive(self, left_mps: float, right_mps: float) -> None:
        self._world.robot.drive_wheels(left_mps, right_mps, self._clock.now_s() + self._auto_stop_s)

    def _check_link(self) -> None:
        if not self._is_open:
            raise DeviceClosedError(f"the simulated base '{self._name}' is not open")
        self._is_lost = self._is_lost or self._world.faults.base_unplugged
        if self._is_lost:
            raise LinkLostError(f"the simulated base '{self._name}' no longer answers: it was unplugged")


# The range sensors, actuators and buttons -----------------------------------------------------------------------------


class SimulatedActuatorOptions(DriverOptions):
    """The options of a simulated actuator."""

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
    """The options of a simulated button."""

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
    """The options of a simulated range sensor."""

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
