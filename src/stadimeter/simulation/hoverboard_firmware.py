"""The mainboard of a hoverboard with hoverboard-firmware-hack-FOC, emulated.

As in the firmware: a frame counts only if it is alone in a burst; motors stay off until a command near zero came;
steer and speed are limited, then mixed. What is simpler: wheels follow their target with a
time constant in place of rate limit, filter and motor control, and a command of 1000 is `FULL_SPEED_MPS`.

A pseudo-terminal knows no pauses. What arrives between two looks, each 2 ms, counts as one burst.
Source: ``util.c``, ``main.c`` and ``config.h`` of EFeru/hoverboard-firmware-hack-FOC.
"""

from __future__ import annotations

import math
import struct
from functools import reduce
from operator import xor
from typing import ClassVar

from stadimeter.simulation.emulated_base import EmulatedBoardOptions, EmulatedFirmware

TIMEOUT_S = 0.8
FULL_SPEED_MPS = 1.0
WHEEL_DIAMETER_M = 0.165
REPORT_EVERY_S = 0.01
ENABLED_BELOW = 50

_COMMAND = struct.Struct("<HhhH")


class HoverboardFirmware(EmulatedFirmware):
    """The firmware, as a function of bytes and time."""

    served_every_s: ClassVar = 0.002

    def __init__(self, started_s: float = 0.0, ticks_per_metre: float = 4000.0) -> None:
        super().__init__(started_s, ticks_per_metre)
        self.timeout_s = TIMEOUT_S
        self.battery_v = 36.5
        self.temperature_c = 25.0
        self.bursts_refused = 0
        self._is_enabled = False
        self._command = (0, 0)
        self._reported_s = -math.inf

    def _take(self, data: bytes) -> bytes:
        if not data:
            return b""
        words = _COMMAND.unpack(data) if len(data) == _COMMAND.size else (0, 0, 0, 0)
        start, steer, speed, checksum = words
        if start != 0xABCD or checksum != (start ^ steer & 0xFFFF ^ speed & 0xFFFF):
            self.bursts_refused += 1
            return b""
        steer, speed = (max(-1000, min(1000, each)) for each in (steer, speed))
        self._is_enabled = self._is_enabled or max(abs(steer), abs(speed)) < ENABLED_BELOW
        self._command = (steer, speed)
        left, right = (max(-1000, min(1000, speed + side * steer / 2)) for side in (1, -1))
        unit_mps = FULL_SPEED_MPS / 1000 if self._is_enabled else 0.0
        self._drive(left * unit_mps, right * unit_mps)
        return b""

    def _time_out(self) -> None:
        super()._time_out()
        self._command = (0, 0)

    def _unasked(self) -> bytes:
        if self._now_s - self._reported_s < REPORT_EVERY_S - 1e-9:
            return b""
        self._reported_s = self._now_s
        left_rpm, right_rpm = (
            round(each.speed_mps * 60 / (math.pi * WHEEL_DIAMETER_M)) for each in (self.left, self.right)
        )
        figures = (*self._command, -right_rpm, left_rpm, round(self.battery_v * 100), round(self.temperature_c * 10), 0)
        words = struct.pack("<H7h", 0xABCD, *figures)
        return words + struct.pack("<H", reduce(xor, (word for (word,) in struct.iter_unpack("<H", words))))


class EmulatedHoverboardOptions(EmulatedBoardOptions):
    """The port ``emulated-hoverboard``."""

    firmware: ClassVar = HoverboardFirmware
