"""An Arduino that runs ros_arduino_bridge, emulated down to the bytes, with wheels that take time to turn.

What is as in the sketch: how it collects a command, its answers, its motor speeds in ticks per frame, its stop 2 s
after the last motor command. What is simpler: its PID loop is replaced by wheels that follow their target with a time
constant. Source: ``ROSArduinoBridge.ino`` and ``diff_controller.h`` of hbrobotics/ros_arduino_bridge.
"""

from __future__ import annotations

import re
from typing import ClassVar

from stadimeter.simulation.emulated_base import EmulatedBoardOptions, EmulatedFirmware

AUTO_STOP_S = 2.0
FRAME_S = 0.033
ARGUMENT_BYTES = 16

_CR = 0x0D
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
            command = (self._letter, _atoi_16(self._arguments[0]), _atoi_16(self._arguments[1]))
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


def _atoi_16(text: bytearray) -> int:
    match = _LEADING_INTEGER.match(text)
    value = int(match[1]) if match else 0
    return (value + 0x8000) % 0x10000 - 0x8000  # an int of an AVR has 16 bits


class RosArduinoFirmware(EmulatedFirmware):
    """The sketch, as a function of bytes and time."""

    def __init__(self, started_s: float = 0.0, ticks_per_metre: float = 4000.0) -> None:
        super().__init__(started_s, ticks_per_metre)
        self.timeout_s = AUTO_STOP_S
        self.use_base_off = False  # fault: the sketch was built without ``USE_BASE`` and knows no motor commands
        self._encoders_zero_m = (0.0, 0.0)
        self.reset()

    def reset(self, boot_s: float = 0.0) -> None:
        """Start again, motors off, as a real board does when a host opens its port.

        For `boot_s` from now the boot loader eats what the host sends.
        """
        self._runs_from_s = self._now_s + boot_s
        self._next_frame_s = self._runs_from_s + FRAME_S
        self._targets = (0, 0)
        self._line = CommandLine()
        self._time_out()

    @property
    def hung(self) -> bool:
        """True if an argument was too long. The emulated board then hangs with its motors as they are."""
        return self._line.overrun

    def step(self, now_s: float) -> None:
        """Live until that time: turn the wheels, run the frames of the speed control, stop by itself."""
        while not self.hung and (due_s := min(self._next_frame_s, self._times_out_s)) <= now_s:
            self._turn_until(due_s)
            if due_s == self._times_out_s:
                self._time_out()
            else:
                self._next_frame_s += FRAME_S
                self._run_frame()
        self._turn_until(now_s)

    def _take(self, data: bytes) -> bytes:
        answer = b""
        for byte in data:
            if self.hung or self._now_s < self._runs_from_s:
                continue
            command = self._line.take(byte)
            if command:
                answer += self._run(*command) + b"\r\n"
        return answer

    def _run_frame(self) -> None:
        if self._moving:
            left_mps, right_mps = (ticks / FRAME_S / self.ticks_per_metre for ticks in self._targets)
            self.left.driven_mps, self.right.driven_mps = left_mps, right_mps

    def _time_out(self) -> None:
        super()._time_out()
        self._moving = False

    def _run(self, letter: bytes, first: int, second: int) -> bytes:
        if letter == b"b":
            return b"57600"
        if self.use_base_off:
            return b"Invalid Command"
        match letter:
            case b"e":
                return b"%d %d" % self._ticks()
            case b"r":
                return self._reset_encoders()
            case b"m":
                return self._set_motor_speeds(first, second)
        return b"Invalid Command"

    def _ticks(self) -> tuple[int, int]:
        zero_left_m, zero_right_m = self._encoders_zero_m
        left_m, right_m = self.left.rolled_m - zero_left_m, self.right.rolled_m - zero_right_m
        return (int(left_m * self.ticks_per_metre), int(right_m * self.ticks_per_metre))

    def _reset_encoders(self) -> bytes:
        self._encoders_zero_m = (self.left.rolled_m, self.right.rolled_m)
        self._targets = (0, 0)
        return b"OK"

    def _set_motor_speeds(self, left: int, right: int) -> bytes:
        self._targets = (left, right)
        if self._targets == (0, 0):
            self._time_out()
        else:
            self._moving = True
            self._feed_timeout()
        return b"OK"


class EmulatedRosArduinoOptions(EmulatedBoardOptions):
    """The port ``emulated-ros-arduino-bridge``."""

    firmware: ClassVar = RosArduinoFirmware
