"""The firmware of an OpenBot, emulated, as far as it drives: the example of a protocol that a configuration describes.

As in the firmware: a letter, then a body until a line feed; ``h`` sets the time-out and feeds it, and nothing else
does, so wheels that ``c`` alone drives stand still once it has run out; without any ``h`` they drive on for ever.
What is simpler: wheels follow their duty with a time constant, and a duty of 255 is `FULL_SPEED_MPS`.
Source: ``openbot.ino`` of ob-f/OpenBot.
"""

from __future__ import annotations

import re
from typing import ClassVar

from stadimeter.simulation.emulated_base import EmulatedBoardOptions, EmulatedFirmware

FULL_SPEED_MPS = 0.8
VOLTAGE_EVERY_S = 1.0

_LEADING_INTEGER = re.compile(rb"\s*([+-]?\d+)")


class OpenBotFirmware(EmulatedFirmware):
    """The firmware, as a function of bytes and time."""

    takes_timeout: ClassVar = True

    def __init__(self, started_s: float = 0.0, ticks_per_metre: float = 4000.0) -> None:
        super().__init__(started_s, ticks_per_metre)
        self._message = b""
        self._voltage_s = started_s
        self._is_timed_out = False

    def _take(self, data: bytes) -> bytes:
        *messages, self._message = (self._message + data).split(b"\n")
        return b"".join(self._run(message[:1], message[1:]) for message in messages)

    def _run(self, letter: bytes, body: bytes) -> bytes:
        match letter:
            case b"c":
                self._control(*(_atoi(part) for part in (*body.split(b","), b"", b"")[:2]))
            case b"f":
                return b"fDIY_ESP32:v:i:s:wf:\r\n"
            case b"h":
                self.timeout_s, self._is_timed_out = _atoi(body) / 1e3, False
                self._feed_timeout()
        return b""

    def _control(self, left: int, right: int) -> None:
        if not self._is_timed_out:
            duties = (max(-255, min(255, each)) / 255 for each in (left, right))
            self.left.driven_mps, self.right.driven_mps = (duty * FULL_SPEED_MPS for duty in duties)

    def _time_out(self) -> None:
        super()._time_out()
        self._is_timed_out = True

    def _unasked(self) -> bytes:
        if self._now_s - self._voltage_s < VOLTAGE_EVERY_S:
            return b""
        self._voltage_s = self._now_s
        return b"v%.2f\r\n" % self.battery_v


def _atoi(text: bytes) -> int:
    match = _LEADING_INTEGER.match(text)
    return int(match[1]) if match else 0


class EmulatedOpenBotOptions(EmulatedBoardOptions):
    """The port ``emulated-openbot``."""

    firmware: ClassVar = OpenBotFirmware
