"""A Roomba or Create of iRobot on a serial port, by its Open Interface.

**This base never stops by itself: it keeps the last drive command for ever.** If this computer dies, it drives on until
something makes it leave Safe mode: a cliff, a hanging wheel, its charger, a button.

It is driven in Safe mode only, never in Full, where its cliff sensors stop nothing. When it leaves Safe mode it stands,
and this driver reports a fault instead of putting it back: it was at a stair, was lifted, or is on its charger.
Opening it anew, which the program tries by itself after a while, is refused as long as a wheel hangs or a cliff is
seen; so a robot that stopped at a stair drives on only after it was moved away.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import ClassVar, Self

from msgspec.structs import replace
from pydantic import model_validator

from stadimeter.bases.protocol import DifferentialDrive, EncoderCounter, SpeedSteps, WheelSpeeds
from stadimeter.bases.serial_base import Answers, BaseMessage, SerialBaseOptions, SerialCodec, WheelCommand
from stadimeter.config.plugins import SerialStop
from stadimeter.config.units import Length

MAX_WHEEL_MPS = 0.5
# Wheels of 72 mm, and 508.8 counts while one turns once.
COUNT_M = math.pi * 0.072 / 508.8

_START, _SAFE, _DRIVE_DIRECT, _STREAM, _STOP = 128, 131, 145, 148, 173
_SAFE_MODE = 2

_BUMPS_AND_DROPS, _CLIFFS, _OVERCURRENTS, _VOLTAGE, _MODE, _ENCODERS = 7, (9, 10, 11, 12), 14, 22, 35, (43, 44)
_STREAMED = (_BUMPS_AND_DROPS, *_CLIFFS, _OVERCURRENTS, _VOLTAGE, _MODE, *_ENCODERS)

_HEADER = 19
# The longest frame that the slowest line can carry in the 15 ms between two of them has so many bytes.
_MAX_DATA_BYTES = 172
_PACKETS = range(7, 59)
_WORDS = {19, 20, 22, 23, *range(25, 32), 33, *range(39, 45), *range(46, 52), *range(54, 58)}


class RoombaCodec(SerialCodec):
    """The Open Interface: an opcode and its data, without checksums; and a stream of sensor packets, with one.

    Drive Direct takes the right wheel first. The checksum of a frame covers its header too, which some texts
    leave out. What was cut short is filled up with zeros: as data they drive nothing, and as opcodes they are
    unknown.

    Source: iRobot Create 2 Open Interface Specification based on the Roomba 600.
    """

    name = "Roomba or Create"
    answers = Answers.STREAM
    hint = "check that it is switched on and awake (press its Clean button), that the baud rate is right"
    steps: ClassVar = SpeedSteps(step_mps=1e-3)
    wake = (bytes([_START]), bytes([_SAFE]))
    question = bytes([_STREAM, len(_STREAMED), *_STREAMED])
    closing = (bytes([_START]), bytes([_STOP]))
    ends_cut_frame = bytes(len(question))

    def __init__(self) -> None:
        self._encoders = [EncoderCounter(bits=16, count_m=COUNT_M) for _ in range(2)]
        self._buffer = bytearray()
        self._is_armed = False

    @property
    def stop(self) -> bytes:
        """Drive Direct with both wheels at zero."""
        return self._drive(0, 0)

    def encode(self, wheels: WheelSpeeds) -> WheelCommand:
        """Return the command for wheel speeds, in whole mm/s."""
        left, right = self.steps.count(wheels)
        return WheelCommand(frame=self._drive(left, right), sent=self.steps.speeds(left, right))

    def feed(self, data: bytes) -> list[BaseMessage]:
        """Return the messages in the complete frames of the stream, oldest first."""
        self._buffer += data
        messages = []
        while (packets := self._next_frame()) is not None:
            messages.append(self._message(packets))
        return messages

    def _drive(self, left: int, right: int) -> bytes:
        return struct.pack(">Bhh", _DRIVE_DIRECT, right, left)

    def _next_frame(self) -> dict[int, int] | None:
        """Return the sensor packets of the next complete frame: values by their numbers. Bytes before it are dropped.

        Whatever looks like a frame and is none costs one byte only, for a true one may begin within it.
        """
        buffer = self._buffer
        while buffer:
            size = _frame_size(buffer)
            if size is None or len(buffer) < size:
                return None
            packets = _packets(bytes(buffer[:size])) if size else None
            dropped = 0 if packets else 1
            self.dropped_bytes += dropped
            del buffer[: dropped or size]
            if packets:
                return packets
        return None

    def _message(self, packets: Mapping[int, int]) -> BaseMessage:
        bumps = packets.get(_BUMPS_AND_DROPS)
        is_dropped = bool(bumps and bumps >> 2)
        is_at_cliff = is_dropped or any(packets.get(cliff) for cliff in _CLIFFS)
        if _MODE in packets:
            self._judge(packets[_MODE], is_dropped=is_dropped, is_at_cliff=is_at_cliff)
        rolled_m = [
            encoder.travel_m(packets[packet]) if packet in packets else None
            for encoder, packet in zip(self._encoders, _ENCODERS, strict=True)
        ]
        return BaseMessage(
            is_identity=_MODE in packets and not self.trouble,
            battery_v=packets[_VOLTAGE] / 1e3 if _VOLTAGE in packets else None,
            is_bumped=None if bumps is None else bool(bumps & 0b11),
            is_at_cliff=None if bumps is None else is_at_cliff,
            left_m=rolled_m[0],
            right_m=rolled_m[1],
            errors=_overcurrents(packets.get(_OVERCURRENTS)),
        )

    def _judge(self, mode: int, *, is_dropped: bool, is_at_cliff: bool) -> None:
        """Note why it does not drive, if it does not. It is not armed at a cliff; armed, it stops there by itself."""
        self._is_armed = self._is_armed or (mode == _SAFE_MODE and not is_at_cliff)
        if mode == _SAFE_MODE and self._is_armed:
            self.trouble = ""
        elif is_dropped:
            self.trouble = "a wheel hangs down, so it stands; set it on its wheels"
        elif is_at_cliff:
            self.trouble = "it sees a cliff, so it stands; move it away from the edge"
        else:
            self.trouble = "it is not in Safe mode, so it stands: it is on its charger, or a button was pressed"


def _frame_size(buffer: bytearray) -> int | None:
    """Return the length of the frame that may begin here; 0 if none can, None if more must come."""
    if buffer[0] != _HEADER:
        return 0
    if len(buffer) < 2:
        return None
    return buffer[1] + 3 if 1 <= buffer[1] <= _MAX_DATA_BYTES else 0


def _packets(frame: bytes) -> dict[int, int] | None:
    """Return the packets of a frame; None if its checksum is wrong, or if it is not made of known packets."""
    if sum(frame) & 0xFF:
        return None
    packets, data = {}, frame[2:-1]
    while data:
        size = 2 if data[0] in _WORDS else 1
        if data[0] not in _PACKETS or len(data) <= size:
            return None
        packets[data[0]] = int.from_bytes(data[1 : 1 + size], "big")
        data = data[1 + size :]
    return packets


def _overcurrents(bits: int | None) -> tuple[str, ...] | None:
    if bits is None:
        return None
    return tuple(f"overcurrent of the {side} wheel" for side, bit in (("left", 16), ("right", 8)) if bits & bit)


class RoombaOptions(SerialBaseOptions):
    """The options of a Roomba or Create, by its Open Interface."""

    title: ClassVar = "an iRobot Roomba or Create"
    auto_stop_advice: ClassVar = (
        "nothing makes a Roomba stop when no command comes: have its button in reach, and keep it away from stairs "
        "and people"
    )

    track_width: Length = 0.235
    """Distance between the middles of the two driven wheels."""

    @model_validator(mode="after")
    def _check_speed_is_reached(self) -> Self:
        if self.max_wheel_speed > MAX_WHEEL_MPS:
            raise ValueError(f"max_wheel_speed is beyond {MAX_WHEEL_MPS} m/s, which no Roomba exceeds")
        return self

    def kinematics(self) -> DifferentialDrive:
        """Return the kinematics, with a limit of whole mm/s."""
        return replace(super().kinematics(), max_wheel_mps=RoombaCodec.steps.limit_mps(self.max_wheel_speed))

    def codec(self) -> RoombaCodec:
        """Return a new codec of the protocol."""
        return RoombaCodec()

    def serial_stop(self) -> SerialStop | None:
        """Return the stop, and behind it the opcode that makes it passive, in which its motors are off."""
        stop = super().serial_stop()
        return stop and replace(stop, frame=stop.frame + bytes([_START]))

    def stops_by_itself_after_s(self) -> float:
        """Return infinity: it has no time-out."""
        return math.inf
