"""The laser sensors TF-Luna and TFmini by Benewake, on a serial port.

They send a frame a hundred times a second, unasked: ``59 59``, distance in centimetres, strength of the echo,
temperature (TFmini: mode), each 16 bits with the low byte first, and the low byte of the sum of the eight bytes before.
Source: Benewake, "TF-Luna instruction manual" and "TFmini-S product manual".
"""

from __future__ import annotations

import math
import struct
from typing import ClassVar

import serial
from msgspec import Struct
from pydantic import PositiveInt

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import SerialPort
from stadimeter.errors import DeviceClosedError, DeviceOpenError, LinkLostError
from stadimeter.sensors.protocol import Echo

_HEADER = b"\x59\x59"
_FRAME_BYTES = 9

# Below this the manual calls the distance unreliable; 65535 is an overexposed sensor.
MIN_STRENGTH = 100
MAX_STRENGTH = 0xFFFF

# The manuals state an accuracy of ±6 cm, beyond 3 m of ±2 %; taken as two standard deviations.
SIGMA_M = 0.03
RELATIVE_SIGMA = 0.01

SILENT_AFTER_S = 0.3
_MAX_BYTES_PER_READ = 4096


class RangeFrame(Struct, frozen=True, kw_only=True):
    """One frame of the sensor: distance in metres, and the strength of the echo."""

    distance_m: float
    strength: int

    @property
    def is_reliable(self) -> bool:
        """True if enough light came back, and not too much."""
        return MIN_STRENGTH <= self.strength < MAX_STRENGTH and self.distance_m > 0


class FrameDecoder:
    """Makes frames of bytes, however they are split, and finds its way back after noise."""

    def __init__(self) -> None:
        self._left = b""

    def feed(self, data: bytes) -> list[RangeFrame]:
        """Return the frames that are complete now, oldest first."""
        frames: list[RangeFrame] = []
        left = self._left + data
        while (start := left.find(_HEADER)) >= 0 and len(left) - start >= _FRAME_BYTES:
            frame = left[start : start + _FRAME_BYTES]
            if sum(frame[:-1]) & 0xFF == frame[-1]:
                distance_cm, strength = struct.unpack_from("<HH", frame, 2)
                frames.append(RangeFrame(distance_m=distance_cm / 100, strength=strength))
                left = left[start + _FRAME_BYTES :]
            else:
                left = left[start + 1 :]  # the header may be two bytes of a frame
        self._left = left[-(_FRAME_BYTES - 1) :] if start < 0 else left[start:]
        return frames


class TfLunaOptions(DriverOptions):
    """The options of a laser sensor TF-Luna or TFmini: ± 3 cm, beyond 3 m ± 1 %."""

    port: SerialPort
    """The serial port, best as ``/dev/serial/by-id/…``."""
    baud: PositiveInt = 115200
    """The speed of the line."""

    def build(self, context: DriverContext) -> TfLuna:
        """Return the sensor."""
        return TfLuna(self, context)


class TfLuna:
    """A `RangeSensor` on a serial port."""

    period_s: ClassVar = 0.02

    def __init__(self, options: TfLunaOptions, context: DriverContext) -> None:
        self._options = options
        self._context = context
        self._port: serial.Serial | None = None
        self._decoder = FrameDecoder()
        self._newest: Echo | None = None
        self._heard_at_s = 0.0

    def open(self) -> None:
        """Open the port, for us alone. Does nothing when open."""
        if self._port is not None:
            return
        path = self._context.port_path(self._options.port)
        try:
            self._port = serial.Serial(path, self._options.baud, timeout=0, exclusive=True)
        except (OSError, ValueError) as error:
            raise DeviceOpenError(
                f"the sensor '{self._context.name}' cannot open {path}: {error}; check the port, that no other program "
                "has it open, and that this user is in the group dialout"
            ) from error
        self._decoder, self._newest = FrameDecoder(), None
        self._heard_at_s = self._context.clock.now_s()

    def read(self) -> Echo | None:
        """Return the newest measurement; a `LinkLostError` if the port is gone or nothing comes that makes sense."""
        if self._port is None:
            raise DeviceClosedError(f"the sensor '{self._context.name}' is not open")
        now_s = self._context.clock.now_s()
        try:
            frames = self._decoder.feed(self._port.read(_MAX_BYTES_PER_READ))
        except OSError as error:
            raise LinkLostError(f"the sensor '{self._context.name}' is gone, was it unplugged? ({error})") from error
        if frames:
            self._heard_at_s, self._newest = now_s, _echo(frames[-1], now_s)
        elif now_s - self._heard_at_s > SILENT_AFTER_S:
            raise LinkLostError(
                f"the sensor '{self._context.name}' at {self._options.port} sends nothing that makes sense: check its "
                "power, TX and RX, and the baud rate"
            )
        return self._newest

    def close(self) -> None:
        """Release the port. May be called any number of times."""
        port, self._port = self._port, None
        if port is not None:
            port.close()


def _echo(frame: RangeFrame, at_s: float) -> Echo:
    """Return a frame as a measurement. Little light comes back from what is far away, black or not there."""
    distance_m = frame.distance_m if frame.is_reliable else math.inf
    return Echo(at_s=at_s, distance_m=distance_m, sigma_m=max(SIGMA_M, RELATIVE_SIGMA * frame.distance_m))
