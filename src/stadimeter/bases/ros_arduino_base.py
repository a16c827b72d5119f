"""A robot base with an Arduino that runs ros_arduino_bridge, on a serial port.

**This base stops by itself 2 s after the last command, and that time cannot be set over the wire.** A robot at
0.5 m/s rolls on for a metre if this computer dies. To shorten it, change ``AUTO_STOP_INTERVAL`` in the sketch.

The firmware takes the left wheel first. Its own Python driver sends the right one first, so a robot that was wired to
suit that driver turns the wrong way here: set ``swap_sides``.

A command is one letter with arguments after single spaces, ended by a carriage return and nothing else. A line feed
does not end a command: the sketch appends it to an argument of 16 bytes whose bounds it does not check, so a host
with the wrong line ending has a robot that never moves and soon crashes. An answer is one line, ended by both.
Source: ``ROSArduinoBridge.ino`` and ``commands.h`` of hbrobotics/ros_arduino_bridge and of the fork by joshnewans.
"""

from __future__ import annotations

import math
import re
from typing import ClassVar, Self

from msgspec.structs import replace
from pydantic import Field, PositiveInt, model_validator

from stadimeter.bases import serial_base
from stadimeter.bases.protocol import DifferentialDrive, SpeedSteps, WheelSpeeds
from stadimeter.config.units import Duration, Length
from stadimeter.errors import CommandRangeError

END = b"\r"
STOP = b"m 0 0" + END
ASK_BAUD_RATE = b"b" + END
RESET_ENCODERS = b"r" + END
READ_ENCODERS = b"e" + END

# Length of one frame of the firmware's speed control: 30 a second are meant, and ``1000 / 30`` is 33 ms in C.
FRAME_S = 0.033

# The firmware reads arguments into 16 bits.
MAX_TICKS_PER_FRAME = 32767

_MAX_LINE_BYTES = 64
_NUMBERS = re.compile(r"(-?\d{1,11})(?: (-?\d{1,11}))?")
_WORDS = {"OK": serial_base.BaseMessage(was_done=True), "Invalid Command": serial_base.BaseMessage(was_done=False)}


class RosArduinoOptions(serial_base.SerialBaseOptions):
    """The options of an Arduino with ros_arduino_bridge."""

    title: ClassVar = "an Arduino with the ros_arduino_bridge sketch"
    auto_stop_advice: ClassVar = 'set AUTO_STOP_INTERVAL in its sketch to 500, load it, and write auto_stop = "500 ms"'

    baud: serial_base.Baud = 57600
    """``BAUDRATE`` of the sketch."""
    wheel_diameter: Length = Field(examples=["6.5 cm"])
    """Diameter of the driven wheels."""
    ticks_per_turn: PositiveInt = Field(examples=[1440])
    """Encoder ticks while a wheel turns once, all edges and the gear counted."""
    auto_stop: Duration = 2.0
    """``AUTO_STOP_INTERVAL`` of the sketch: the wheels stop when no command came for this long. It only says so."""

    @model_validator(mode="after")
    def _check_speeds_fit_the_firmware(self) -> Self:
        ticks = self.max_wheel_speed / self.codec().steps.step_mps
        if not 1 - 1e-9 <= ticks < MAX_TICKS_PER_FRAME + 1:
            raise ValueError(
                f"max_wheel_speed of {self.max_wheel_speed:g} m/s is {ticks:.3g}"
                f" encoder ticks in {FRAME_S * 1e3:.0f} ms; the firmware takes 1 to {MAX_TICKS_PER_FRAME}: "
                "check it together with wheel_diameter and ticks_per_turn"
            )
        return self

    def kinematics(self) -> DifferentialDrive:
        """Return the kinematics that these figures describe, with a limit of whole ticks."""
        return replace(super().kinematics(), max_wheel_mps=self.codec().steps.limit_mps(self.max_wheel_speed))

    def codec(self) -> RosArduinoCodec:
        """Return a new codec."""
        return RosArduinoCodec(ticks_per_metre=self.ticks_per_turn / (math.pi * self.wheel_diameter))

    def stops_by_itself_after_s(self) -> float:
        """Return the time that the sketch is said to have."""
        return self.auto_stop or math.inf


class RosArduinoCodec(serial_base.SerialCodec):
    """The protocol of ros_arduino_bridge.

    Words are recognised even right behind noise. Numbers are not, because the noise may have eaten a digit.

    Attributes:
        steps: The speeds of whole ticks per frame.
    """

    name: ClassVar = "ros_arduino_bridge"
    answers: ClassVar = serial_base.Answers.EACH_COMMAND
    hint: ClassVar = "check that its sketch is loaded, that the baud rate is the sketch's"
    refusal_hint: ClassVar = (
        "its sketch was built without the base controller: enable '#define USE_BASE' in ROSArduinoBridge.ino, choose "
        "the motor driver and load it again"
    )
    ends_cut_frame = END
    question = ASK_BAUD_RATE
    opening = (RESET_ENCODERS,)
    polls = (READ_ENCODERS,)

    def __init__(self, ticks_per_metre: float) -> None:
        self._ticks_per_metre = ticks_per_metre
        self.steps = SpeedSteps(step_mps=1.0 / (ticks_per_metre * FRAME_S))
        self._lines = serial_base.LineReader(_MAX_LINE_BYTES)

    @property
    def stop(self) -> bytes:
        """The frame that makes the base stand."""
        return STOP

    def encode(self, wheels: WheelSpeeds) -> serial_base.WheelCommand:
        """Return the command for wheel speeds, rounded to whole ticks per frame.

        Raises `CommandRangeError` for a speed beyond the firmware's 16 bits.
        """
        left, right = self.steps.count(wheels)
        if max(abs(left), abs(right)) > MAX_TICKS_PER_FRAME:
            raise CommandRangeError(f"{left} and {right} ticks per frame are not both within ±{MAX_TICKS_PER_FRAME}")
        return serial_base.WheelCommand(frame=f"m {left} {right}".encode() + END, sent=self.steps.speeds(left, right))

    def feed(self, data: bytes) -> list[serial_base.BaseMessage]:
        """Return the replies that are complete now, oldest first."""
        return [message for line in self._lines.feed(data) if (message := self._meaning(line))]

    def _meaning(self, line: serial_base.TextLine) -> serial_base.BaseMessage | None:
        message = _WORDS.get(line.text)
        numbers = None if line.noise else _NUMBERS.fullmatch(line.text)
        if numbers and numbers[2]:
            left_m, right_m = (int(ticks) / self._ticks_per_metre for ticks in numbers.groups())
            message = serial_base.BaseMessage(left_m=left_m, right_m=right_m)
        elif numbers:  # the baud rate
            message = serial_base.BaseMessage(is_identity=True)
        self.dropped_bytes += line.noise + (len(line.text) if message is None else 0)
        return message
