"""A hoverboard whose mainboard runs the firmware hoverboard-firmware-hack-FOC, over its serial line.

**It stops by itself 0.8 s after the last command, and beeps; that time cannot be set over the wire**, but as
``SERIAL_TIMEOUT`` in the firmware. The motors are strong enough to break bones: wheels off the floor first, and a
switch in the battery's lead.

Commands are a speed and a steering value from -1000 to 1000 without a unit, which the firmware mixes: left is speed +
steer / 2, right is speed - steer / 2. What 1000 is in metres per second depends on the battery, the control mode and
the settings of the firmware. ``full_speed`` says it, and must be measured: see the page on robots.

The firmware takes a frame only if it is alone in a burst: what follows without a pause spoils both. So frames are sent
apart, each in one write.
Source: ``util.c``, ``main.c`` and ``config.h`` of EFeru/hoverboard-firmware-hack-FOC.
"""

from __future__ import annotations

import math
import struct
from typing import ClassVar

from stadimeter.bases.protocol import WheelSpeeds
from stadimeter.bases.serial_base import Answers, BaseMessage, DutyBaseOptions, SerialCodec, WheelCommand
from stadimeter.config.units import Duration, Length

START = 0xABCD
MAX_COMMAND = 1000

# Eight bytes take 0.7 ms at 115,200 baud; the firmware sees the end of a burst when the line is quiet for one more.
GAP_S = 0.004

# TEMP_WARNING of the firmware, where it begins to beep; it switches itself off at 65 °C.
HOT_C = 60.0

_HEADER = struct.pack("<H", START)
_FEEDBACK = struct.Struct("<H7hH")


class HoverboardOptions(DutyBaseOptions):
    """The options of a hoverboard with the firmware of Emanuel Feru."""

    title: ClassVar = "a hoverboard with the FOC firmware"
    auto_stop_advice: ClassVar = (
        'set SERIAL_TIMEOUT in its firmware to 100 (0.5 s), load it, and write auto_stop = "500 ms"'
    )

    wheel_diameter: Length = 0.165
    """Diameter of the driven wheels, for the distance that the base reports."""
    invert_feedback: bool = False
    """Whether the base reports a speed below zero where it drives forwards."""
    auto_stop: Duration = 0.8
    """``SERIAL_TIMEOUT`` of the firmware: the wheels stop when no command came for this long. It only says so."""

    def codec(self) -> HoverboardCodec:
        """Return a new codec."""
        rpm_mps = math.pi * self.wheel_diameter / 60 * (-1 if self.invert_feedback else 1)
        return HoverboardCodec(full_speed_mps=self.full_speed, rpm_mps=rpm_mps)

    def stops_by_itself_after_s(self) -> float:
        """Return the time that the firmware is said to have."""
        return self.auto_stop or math.inf


class HoverboardCodec(SerialCodec):
    """The frames of the firmware.

    Args:
        full_speed_mps: The speed of a wheel at a command of 1000.
        rpm_mps: The speed of a wheel that turns once a minute.
    """

    name: ClassVar = "hoverboard-firmware-hack-FOC"
    answers: ClassVar = Answers.STREAM
    hint: ClassVar = (
        "check that the board is switched on, that its firmware has FEEDBACK_SERIAL and CONTROL_SERIAL on this cable, "
        "and that both data wires are connected"
    )
    gap_s: ClassVar = GAP_S
    stop_repeats: ClassVar = math.inf  # it beeps when nothing comes; only zeros are ever repeated

    def __init__(self, full_speed_mps: float, rpm_mps: float) -> None:
        self._unit_mps = full_speed_mps / MAX_COMMAND
        self._rpm_mps = rpm_mps
        self._received = bytearray()

    @property
    def stop(self) -> bytes:
        """The frame that makes the base stand."""
        return command_frame(0, 0)

    def encode(self, wheels: WheelSpeeds) -> WheelCommand:
        """Return the command for wheel speeds, in the same proportion if it is too much for the protocol.

        The firmware limits the steering value by itself, which bends the curve: turning on the spot, no wheel can be
        asked to run faster than half of what it does straight ahead.
        """
        speed = (wheels.left_mps + wheels.right_mps) / 2 / self._unit_mps
        steer = (wheels.left_mps - wheels.right_mps) / self._unit_mps
        scale = min(1.0, MAX_COMMAND / max(abs(speed), abs(steer), MAX_COMMAND))
        speed, steer = round(speed * scale), round(steer * scale)
        sent = WheelSpeeds(
            left_mps=(speed + steer / 2) * self._unit_mps, right_mps=(speed - steer / 2) * self._unit_mps
        )
        return WheelCommand(frame=command_frame(steer, speed), sent=sent)

    def feed(self, data: bytes) -> list[BaseMessage]:
        """Return the reports that are complete now, oldest first.

        What looks like a start but has no valid checksum is skipped by one byte: a true start may be inside.
        """
        self._received += data
        messages: list[BaseMessage] = []
        while (begin := self._received.find(_HEADER)) >= 0 and len(self._received) - begin >= _FEEDBACK.size:
            self._drop(begin)
            if message := self._meaning(bytes(self._received[: _FEEDBACK.size])):
                messages.append(message)
                del self._received[: _FEEDBACK.size]
            else:
                self._drop(1)
        # The first byte of a start may be the last that came.
        kept = begin if begin >= 0 else len(self._received) - self._received.endswith(_HEADER[:1])
        self._drop(kept)
        return messages

    def _drop(self, count: int) -> None:
        del self._received[:count]
        self.dropped_bytes += count

    def _meaning(self, frame: bytes) -> BaseMessage | None:
        if _checksum(frame[:-2]) != int.from_bytes(frame[-2:], "little"):
            return None
        _, _, _, right_rpm, left_rpm, centivolts, tenths_c, _, _ = _FEEDBACK.unpack(frame)
        hot = (f"the board is {tenths_c / 10:g} °C hot, and switches itself off at 65 °C",)
        return BaseMessage(
            is_identity=True,
            battery_v=centivolts / 100,
            left_mps=left_rpm * self._rpm_mps,
            right_mps=-right_rpm * self._rpm_mps,  # its motor faces the other way
            errors=hot if tenths_c >= HOT_C * 10 else (),
        )


def command_frame(steer: int, speed: int) -> bytes:
    """Return the frame of a command: start, steer, speed, and the checksum, all little-endian words of 16 bits."""
    words = struct.pack("<Hhh", START, steer, speed)
    return words + _checksum(words).to_bytes(2, "little")


def _checksum(words: bytes) -> int:
    """Return the exclusive or of words."""
    result = 0
    for (word,) in struct.iter_unpack("<H", words):
        result ^= word
    return result
