"""The driver board of a Waveshare UGV, emulated: its commands, its one-shot time-out and its reports.

As in the firmware: only wheel commands (``T`` 1 and 11) feed the time-out and start it again; a speed above 2 m/s is
dropped but feeds it; ``T`` 13 does neither; ``T`` 0 stops and does not last. What is simpler: wheels follow their
target with a time constant in place of the PID, and a duty of 255 is 1 m/s.
Source: ``uart_ctrl.h``, ``movtion_module.h`` and ``ugv_advance.h`` of waveshareteam/ugv_base_ros.
"""

from __future__ import annotations

import json
import math
from typing import Any, ClassVar

from stadimeter.simulation.emulated_base import EmulatedBoardOptions, EmulatedFirmware

HEARTBEAT_S = 3.0
MAX_SPEED_MPS = 2.0
TRACK_WIDTH_M = 0.172  # of a UGV Rover


class WaveshareUgvFirmware(EmulatedFirmware):
    """The firmware, as a function of bytes and time."""

    takes_timeout: ClassVar = True

    def __init__(self, started_s: float = 0.0, ticks_per_metre: float = 4000.0) -> None:
        super().__init__(started_s, ticks_per_metre)
        self._fed_s = started_s
        self._line = b""
        self._echoes = self._streams = False
        self._report_every_s, self._reported_s = 0.0, -math.inf
        self._set_timeout(HEARTBEAT_S)

    def _set_timeout(self, seconds: float) -> None:
        """Set the time-out; one that has run out and stopped the wheels stays so until the next wheel command."""
        self.timeout_s = seconds
        if self._times_out_s < math.inf or self._fed_s == self._now_s:
            self._times_out_s = max(self._now_s, self._fed_s + seconds)

    def _feed_timeout(self) -> None:
        self._fed_s = self._now_s
        super()._feed_timeout()

    def _take(self, data: bytes) -> bytes:
        *lines, self._line = (self._line + data).split(b"\n")
        return b"".join(self._run(line) for line in lines)

    def _run(self, line: bytes) -> bytes:
        try:
            command = json.loads(line)
        except ValueError:
            return b""
        if not isinstance(command, dict):
            return b""
        echo = line + b"\n" if self._echoes else b""
        return echo + self._obey(command)

    def _obey(self, command: dict[str, Any]) -> bytes:
        match command.get("T"):
            case 0:
                self._set_goal(0.0, 0.0)
            case 1:
                self._drive_wheels(command.get("L"), command.get("R"))
            case 11:
                self._drive(command.get("L", 0) / 255, command.get("R", 0) / 255)
            case 13:
                linear, offset = command.get("X", 0.0), command.get("Z", 0.0) * TRACK_WIDTH_M / 2
                self._set_goal(linear - offset, linear + offset)
            case 130:
                return self._report()
            case 131 | 136 | 142 | 143 as setting:
                self._set(setting, command.get("cmd", 0))
        return b""

    def _set(self, setting: int, number: float) -> None:
        if setting == 131:
            self._streams = bool(number)
        elif setting == 136:
            self._set_timeout(number / 1e3)
        elif setting == 142:
            self._report_every_s = abs(number) / 1e3
        else:
            self._echoes = bool(number)

    def _drive_wheels(self, left: object, right: object) -> None:
        if isinstance(left, int | float) and isinstance(right, int | float):
            self._feed_timeout()
            self._set_goal(left, right)

    def _set_goal(self, left_mps: float, right_mps: float) -> None:
        if max(abs(left_mps), abs(right_mps)) <= MAX_SPEED_MPS:
            self.left.driven_mps, self.right.driven_mps = left_mps, right_mps

    def _unasked(self) -> bytes:
        is_due = self._now_s - self._reported_s >= self._report_every_s
        return self._report() if self._streams and is_due else b""

    def _report(self) -> bytes:
        self._reported_s = self._now_s
        report = {
            "T": 1001,
            "L": round(self.left.speed_mps, 3),
            "R": round(self.right.speed_mps, 3),
            "odl": int(self.left.rolled_m * 100),
            "odr": int(self.right.rolled_m * 100),
            "v": int(self.battery_v * 100),
        }
        return json.dumps(report, separators=(",", ":")).encode() + b"\r\n"


class EmulatedWaveshareUgvOptions(EmulatedBoardOptions):
    """The port ``emulated-waveshare-ugv``."""

    firmware: ClassVar = WaveshareUgvFirmware
