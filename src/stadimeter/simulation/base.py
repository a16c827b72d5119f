"""A robot base without a serial port: it drives the simulated robot."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

from msgspec.structs import replace
from pydantic import Field

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Duration, Speed
from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.errors import DeviceClosedError, DeviceOpenError, LinkLostError
from stadimeter.simulation.world import shared_world


class SimulatedBaseOptions(DriverOptions):
    """The table of a simulated base in the configuration."""

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
