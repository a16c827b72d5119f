r"""A Waveshare UGV (UGV Rover, UGV Beast, RaspRover): the ESP32 of its driver board, which speaks JSON, a line each.

**It stops by itself ``auto_stop`` after the last command.** The firmware comes with 3 s; opening sets what is
configured, at most `MAX_AUTO_STOP_S`.

Traps of the firmware, which this driver goes around:

- ``{"T":13}``, speed and rate of turn, neither feeds that time-out nor starts it again: who drives with it has none
  after the first stop. So wheels are driven with ``{"T":1}`` only.
- A wheel speed above 2 m/s is ignored, but feeds the time-out: the wheels run on as before. So it is never sent.
- ``{"T":0}``, the emergency stop, does not last: the next command drives again. A stop is a speed of 0.
- Commands may be echoed. The echo is switched off, and is no answer.

Source: ``uart_ctrl.h``, ``movtion_module.h`` and ``ugv_advance.h`` of waveshareteam/ugv_base_ros.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Self

import msgspec
from msgspec import Struct
from pydantic import AfterValidator, model_validator

from stadimeter.bases import serial_base
from stadimeter.bases.protocol import WheelSpeeds
from stadimeter.config.units import Duration

MAX_WHEEL_MPS = 2.0

# With commands 20 times a second, a shorter time-out stops it between two of them when one comes late.
MIN_AUTO_STOP_S, MAX_AUTO_STOP_S = 0.2, 3.0

REPORTED_EVERY_S = 0.05
_FEEDBACK = 1001
_MAX_LINE_BYTES = 512

# Newer firmware reports hundredths of a volt, older firmware volts. No battery of it has less than 1 V or more than 99.
_HUNDREDTHS_FROM = 100.0


def _check_auto_stop(seconds: float) -> float:
    if not MIN_AUTO_STOP_S <= seconds <= MAX_AUTO_STOP_S:
        raise ValueError(f"auto_stop is {seconds:g} s; write {MIN_AUTO_STOP_S:g} to {MAX_AUTO_STOP_S:g} s, best 0.5 s")
    return seconds


class WaveshareUgvOptions(serial_base.SerialBaseOptions):
    """The options of a Waveshare UGV or another board with its JSON commands."""

    title: ClassVar = "a Waveshare UGV (Rover, Beast, RaspRover)"
    auto_stop_advice: ClassVar = 'leave out auto_stop, or write "500 ms": opening the base sets it'

    auto_stop: Annotated[Duration, AfterValidator(_check_auto_stop)] = 0.5
    """The wheels stop when no command came for this long; set when the base is opened."""

    @model_validator(mode="after")
    def _check_speed_is_obeyed(self) -> Self:
        if self.max_wheel_speed > MAX_WHEEL_MPS:
            raise ValueError(
                f"max_wheel_speed is {self.max_wheel_speed:g} m/s: the firmware ignores commands above "
                f"{MAX_WHEEL_MPS:g} m/s and drives on as before; write less"
            )
        return self

    def codec(self) -> WaveshareUgvCodec:
        """Return a new codec."""
        return WaveshareUgvCodec(self.auto_stop)

    def stops_by_itself_after_s(self) -> float:
        """Return the time that opening sets."""
        return self.auto_stop


class _Feedback(Struct, kw_only=True):
    """A line from the base, as far as it matters here. Odometry is in centimetres, and not in older firmware."""

    T: int
    odl: float | None = None
    odr: float | None = None
    v: float | None = None


class WaveshareUgvCodec(serial_base.SerialCodec):
    """The JSON of the driver board. It has no checksum: a line counts only if all of it is as it must be."""

    name: ClassVar = "the firmware of a Waveshare UGV"
    answers: ClassVar = serial_base.Answers.STREAM
    hint: ClassVar = (
        "check that the base is switched on; on the pins of a Pi, that the serial port is on and the login console off"
    )
    ends_cut_frame = b"\n"
    question = b'{"T":130}\n'

    def __init__(self, auto_stop_s: float) -> None:
        self._lines = serial_base.LineReader(_MAX_LINE_BYTES)
        self.opening = (
            f'{{"T":136,"cmd":{round(auto_stop_s * 1e3)}}}\n'.encode(),
            b'{"T":143,"cmd":0}\n',  # no echo
            f'{{"T":142,"cmd":{round(REPORTED_EVERY_S * 1e3)}}}\n'.encode(),
            b'{"T":131,"cmd":1}\n',  # reports, all the time
        )

    @property
    def stop(self) -> bytes:
        """The frame that makes the base stand."""
        return b'{"T":1,"L":0.0,"R":0.0}\n'

    def encode(self, wheels: WheelSpeeds) -> serial_base.WheelCommand:
        """Return the command for wheel speeds, in whole mm/s and never above `MAX_WHEEL_MPS`."""
        left_mps, right_mps = _sendable(wheels.left_mps), _sendable(wheels.right_mps)
        frame = f'{{"T":1,"L":{left_mps},"R":{right_mps}}}\n'.encode()
        return serial_base.WheelCommand(frame=frame, sent=WheelSpeeds(left_mps=left_mps, right_mps=right_mps))

    def feed(self, data: bytes) -> list[serial_base.BaseMessage]:
        """Return the reports that are complete now, oldest first."""
        return [message for line in self._lines.feed(data) if (message := self._meaning(line))]

    def _meaning(self, line: serial_base.TextLine) -> serial_base.BaseMessage | None:
        try:
            feedback = msgspec.json.decode(line.text, type=_Feedback)
        except ValueError:
            self.dropped_bytes += line.noise + len(line.text)
            return None
        self.dropped_bytes += line.noise
        return _message(feedback) if feedback.T == _FEEDBACK else None


def _sendable(speed_mps: float) -> float:
    return round(min(MAX_WHEEL_MPS, max(-MAX_WHEEL_MPS, speed_mps)), 3) + 0.0  # no minus zero


def _message(feedback: _Feedback) -> serial_base.BaseMessage:
    volts = feedback.v
    if volts is not None and volts >= _HUNDREDTHS_FROM:
        volts /= 100
    return serial_base.BaseMessage(
        is_identity=True,
        battery_v=volts,
        left_m=None if feedback.odl is None else feedback.odl / 100,
        right_m=None if feedback.odr is None else feedback.odr / 100,
    )
