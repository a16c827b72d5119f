"""An Arduino that runs ros_arduino_bridge, emulated down to the bytes, with wheels that take time to turn.

What is as in the sketch: how it collects a command, its answers, its motor speeds in ticks per frame, its stop 2 s
after the last motor command. What is simpler: its PID loop is replaced by wheels that follow their target with a time
constant. Source: ``ROSArduinoBridge.ino`` and ``diff_controller.h`` of hbrobotics/ros_arduino_bridge.
"""

from __future__ import annotations

import math
import re

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.core.clock import Clock
from stadimeter.errors import DeviceOpenError
from stadimeter.simulation.emulated_port import EmulatedPort
from stadimeter.simulation.world import World, shared_world

# Under this name a run keeps its emulated board, so that its faults can be reached.
SHARED_NAME = "emulated port"

AUTO_STOP_S = 2.0
FRAME_S = 0.033
ARGUMENT_BYTES = 16
TIME_CONSTANT_S = 0.1

_CR = 0x0D
_NO_LAG_TPS = 1e-3
_LEADING_INTEGER = re.compile(rb"\s*([+-]?\d+)")


class CommandLine:
    """The sketch's command parser: one letter, two arguments after spaces, ended by a carriage return only."""

    def __init__(self) -> None:
        # Whether an argument was written past its 16 bytes. What a real board does then is undefined.
        self.overrun = False
        self._letter = b""
        self._arguments = (bytearray(), bytearray())
        self._position = 0

    def take(self, byte: int) -> tuple[bytes, int, int] | None:
        """Take one byte; return the letter and both arguments if it completes a command.

        Arguments that are no numbers are 0, as ``atoi`` has it.
        """
        if byte == _CR:
            command = (self._letter, _atoi(self._arguments[0]), _atoi(self._arguments[1]))
            self._clear()
            return command
        if byte == 0x20:
            self._position = min(self._position + 1, 2)
        elif self._position == 0:
            self._letter = bytes([byte])  # the last byte before the space wins; so a line feed does no harm here
        else:
            self._append(byte)
        return None

    def _append(self, byte: int) -> None:
        argument = self._arguments[self._position - 1]
        argument.append(byte)
        self.overrun = self.overrun or len(argument) > ARGUMENT_BYTES

    def _clear(self) -> None:
        self._letter = b""
        self._arguments = (bytearray(), bytearray())
        self._position = 0


def _atoi(text: bytearray) -> int:
    match = _LEADING_INTEGER.match(text)
    value = int(match[1]) if match else 0
    return (value + 0x8000) % 0x10000 - 0x8000  # an int of an AVR has 16 bits


class Wheel:
    """A wheel with an encoder, which approaches the speed that it is driven at."""

    def __init__(self) -> None:
        self.driven_tps = 0.0  # the speed that its motor is driven at, in encoder ticks per second
        self.speed_tps = 0.0  # the speed that it has
        self.ticks = 0.0  # what its encoder has counted

    def turn(self, seconds: float) -> None:
        """Turn for that long: the exact solution of a first-order lag under a constant drive."""
        kept = math.exp(-seconds / TIME_CONSTANT_S)
        lag_tps = self.speed_tps - self.driven_tps
        self.ticks += self.driven_tps * seconds + lag_tps * TIME_CONSTANT_S * (1 - kept)
        self.speed_tps = self.driven_tps + (lag_tps * kept if abs(lag_tps) > _NO_LAG_TPS else 0.0)


class RosArduinoFirmware:
    """The sketch, as a function of bytes and time."""

    def __init__(self, started_s: float = 0.0) -> None:
        # Fault: bytes from the host are lost, and nothing is answered. Motors and the automatic stop work on.
        self.silent = False
        self.use_base_off = False  # fault: the sketch was built without ``USE_BASE`` and knows no motor commands
        self.left = Wheel()
        self.right = Wheel()
        self._now_s = started_s
        self.reset()

    def reset(self, boot_s: float = 0.0) -> None:
        """Start again, motors off, as a real board does when a host opens its port.

        For `boot_s` from now the boot loader eats what the host sends.
        """
        self._runs_from_s = self._now_s + boot_s
        self._next_frame_s = self._runs_from_s + FRAME_S
        self._targets = (0, 0)
        self._line = CommandLine()
        self._stand()

    @property
    def hung(self) -> bool:
        """Whether an argument was too long. The emulated board then hangs with its motors as they are."""
        return self._line.overrun

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the host."""
        self.step(now_s)
        answer = b""
        for byte in data:
            if self.silent or self.hung or now_s < self._runs_from_s:
                continue
            command = self._line.take(byte)
            if command:
                answer += self._run(*command) + b"\r\n"
        return answer

    def step(self, now_s: float) -> None:
        """Live until that time: turn the wheels, run the frames of the speed control, stop by itself."""
        while not self.hung and (due_s := min(self._next_frame_s, self._auto_stop_s)) <= now_s:
            self._turn_until(due_s)
            if due_s == self._auto_stop_s:
                self._stand()
            else:
                self._next_frame_s += FRAME_S
                self._run_frame()
        self._turn_until(now_s)

    def _turn_until(self, time_s: float) -> None:
        seconds = max(0.0, time_s - self._now_s)
        for wheel in (self.left, self.right):
            wheel.turn(seconds)
        self._now_s += seconds

    def _run_frame(self) -> None:
        if self._moving:
            self.left.driven_tps, self.right.driven_tps = (target / FRAME_S for target in self._targets)

    def _stand(self) -> None:
        self.left.driven_tps = self.right.driven_tps = 0.0
        self._moving = False
        self._auto_stop_s = math.inf

    def _run(self, letter: bytes, first: int, second: int) -> bytes:
        if letter == b"b":
            return b"57600"
        if self.use_base_off:
            return b"Invalid Command"
        match letter:
            case b"e":
                return b"%d %d" % (int(self.left.ticks), int(self.right.ticks))
            case b"r":
                return self._reset_encoders()
            case b"m":
                return self._set_motor_speeds(first, second)
        return b"Invalid Command"

    def _reset_encoders(self) -> bytes:
        self.left.ticks = self.right.ticks = 0.0
        self._targets = (0, 0)
        return b"OK"

    def _set_motor_speeds(self, left: int, right: int) -> bytes:
        self._targets = (left, right)
        if self._targets == (0, 0):
            self._stand()
        else:
            self._moving = True
            self._auto_stop_s = self._now_s + AUTO_STOP_S
        return b"OK"


class EmulatedRosArduino:
    """The emulated board in the simulated world: its motors turn the robot's wheels, its cable can be pulled.

    Raises:
        DeviceOpenError: The system has no pseudo-terminal left.
    """

    def __init__(self, world: World, clock: Clock) -> None:
        self._world = world
        # The board, with its own knobs for faults. The cable's is ``world.faults.base_unplugged``.
        self.firmware = RosArduinoFirmware(started_s=clock.now_s())
        try:
            # Where a driver finds it.
            self.port = EmulatedPort(self.firmware, clock, self._is_plugged, self._turn_wheels)
        except OSError as error:
            raise DeviceOpenError(f"no pseudo-terminal for the emulated base: {error}") from error

    def _is_plugged(self) -> bool:
        return not self._world.faults.base_unplugged

    def _turn_wheels(self) -> None:
        robot, board = self._world.robot, self.firmware
        robot.drive_wheels(board.left.speed_tps / robot.ticks_per_metre, board.right.speed_tps / robot.ticks_per_metre)


def emulated_ros_arduino(context: DriverContext) -> EmulatedRosArduino:
    """Return the run's emulated board, which the run closes; the first to ask connects it to the world's robot.

    Raises:
        ConfigError: The run has no world.
        DeviceOpenError: The system has no pseudo-terminal left.
    """

    def connect() -> EmulatedRosArduino:
        board = EmulatedRosArduino(shared_world(context), context.clock)
        context.at_end(board.port.close)
        return board

    return context.share(SHARED_NAME, connect)


class EmulatedPortOptions(DriverOptions):
    """The emulated port has no table in the configuration: a base names it as its port."""

    def build(self, context: DriverContext) -> str:
        """Return the path of the pseudo-terminal."""
        return emulated_ros_arduino(context).port.path
