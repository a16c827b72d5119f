"""Parts that the emulated firmware of every base shares: wheels, time-out, and its place in the simulated world.

An emulator is one file: a class derived from `EmulatedFirmware`, and one derived from `EmulatedBoardOptions` that names
it, with its entry ``emulated-…`` in ``stadimeter.ports``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import ClassVar

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.core.clock import Clock
from stadimeter.errors import DeviceOpenError
from stadimeter.simulation.emulated_port import SERVED_EVERY_S, EmulatedPort
from stadimeter.simulation.world import World, shared_world

# Under this name a run keeps its emulated board, so that its faults can be reached.
SHARED_NAME = "emulated port"

TIME_CONSTANT_S = 0.1

_NO_LAG_MPS = 1e-6


class EmulatedWheel:
    """A wheel with an encoder, which approaches the speed that it is driven at."""

    def __init__(self) -> None:
        self.driven_mps = 0.0  # the speed that its motor is driven at
        self.speed_mps = 0.0  # the speed that it has
        self.rolled_m = 0.0

    def turn(self, seconds: float, time_constant_s: float = TIME_CONSTANT_S) -> None:
        """Turn for that long: the exact solution of a first-order lag under a constant drive."""
        kept = math.exp(-seconds / time_constant_s)
        lag_mps = self.speed_mps - self.driven_mps
        self.rolled_m += self.driven_mps * seconds + lag_mps * time_constant_s * (1 - kept)
        self.speed_mps = self.driven_mps + (lag_mps * kept if abs(lag_mps) > _NO_LAG_MPS else 0.0)


class EmulatedFirmware:
    """The program of a board with two wheels, as a function of bytes and time.

    A subclass says what bytes do, in `_take`, and calls `_drive` for a command to the motors.

    Attributes:
        silent: Fault: bytes from the host are lost, and nothing is sent. Motors and the time-out work on.
        timeout_s: The motors stop when no command came for this long; infinity for never.
        battery_v: The voltage that it reports.
        left, right: The wheels.
        served_every_s: How often the board looks at its line.
        takes_timeout: Whether a command sets the time-out; else it is built in.
    """

    served_every_s: ClassVar[float] = SERVED_EVERY_S
    takes_timeout: ClassVar[bool] = False

    def __init__(self, started_s: float = 0.0, ticks_per_metre: float = 4000.0) -> None:
        self.silent = False
        self.timeout_s = math.inf
        self.battery_v = 12.0
        self.left = EmulatedWheel()
        self.right = EmulatedWheel()
        self.ticks_per_metre = ticks_per_metre
        self._now_s = started_s
        self._times_out_s = math.inf

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the host, which may be none, and return what the board sends."""
        self.step(now_s)
        if self.silent:
            return b""
        return self._take(data) + self._unasked()

    def step(self, now_s: float) -> None:
        """Live until that time: turn the wheels, stop by itself."""
        if self._times_out_s <= now_s:
            self._turn_until(self._times_out_s)
            self._time_out()
        self._turn_until(now_s)

    def _take(self, data: bytes) -> bytes:
        """Return the answers to bytes from the host."""
        raise NotImplementedError(f"{type(self).__name__} takes no bytes")

    def _unasked(self) -> bytes:
        """Return the bytes the board sends by itself by now."""
        return b""

    def _drive(self, left_mps: float, right_mps: float) -> None:
        """Drive the motors, and let the time-out begin anew."""
        self.left.driven_mps, self.right.driven_mps = left_mps, right_mps
        self._feed_timeout()

    def _feed_timeout(self) -> None:
        self._times_out_s = self._now_s + self.timeout_s

    def _time_out(self) -> None:
        self.left.driven_mps = self.right.driven_mps = 0.0
        self._times_out_s = math.inf

    def _turn_until(self, time_s: float) -> None:
        seconds = max(0.0, time_s - self._now_s)
        for wheel in (self.left, self.right):
            wheel.turn(seconds)
        self._now_s += seconds


# Makes a firmware that starts at a time, for a robot whose encoders count so many ticks on a metre.
MakeFirmware = Callable[[float, float], EmulatedFirmware]


class EmulatedBoard:
    """The emulated board in the simulated world: its motors turn the robot's wheels, its cable can be pulled.

    Raises:
        DeviceOpenError: The system has no pseudo-terminal left.
    """

    def __init__(self, make_firmware: MakeFirmware, world: World, clock: Clock) -> None:
        self._world = world
        # The board, with its own knobs for faults. The cable's is ``world.faults.base_unplugged``.
        self.firmware = make_firmware(clock.now_s(), world.robot.ticks_per_metre)
        try:
            # Where a driver finds it.
            self.port = EmulatedPort(
                self.firmware, clock, self._is_plugged, self._turn_wheels, every_s=self.firmware.served_every_s
            )
        except OSError as error:
            raise DeviceOpenError(f"no pseudo-terminal for the emulated base: {error}") from error

    def _is_plugged(self) -> bool:
        return not self._world.faults.base_unplugged

    def _turn_wheels(self) -> None:
        self._world.robot.drive_wheels(self.firmware.left.speed_mps, self.firmware.right.speed_mps)


class EmulatedBoardOptions(DriverOptions):
    """An emulated port has no table in the configuration: a base names it as its port."""

    firmware: ClassVar[MakeFirmware]

    @classmethod
    def board(cls, context: DriverContext) -> EmulatedBoard:
        """Return the run's emulated board, which the run closes; the first to ask connects it to the world's robot.

        Raises:
            ConfigError: The run has no world.
            DeviceOpenError: The system has no pseudo-terminal left.
        """

        def connect() -> EmulatedBoard:
            board = EmulatedBoard(cls.firmware, shared_world(context), context.clock)
            context.at_end(board.port.close)
            return board

        return context.share(SHARED_NAME, connect)

    def build(self, context: DriverContext) -> str:
        """Return the path of the pseudo-terminal."""
        return self.board(context).port.path
