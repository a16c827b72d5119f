"""A RoboClaw of Basicmicro on a serial port or on USB, in packet serial mode.

Its serial time-out is off after each start of the board. It is set at open, and read again every few seconds: a board
that was switched off and on meanwhile has none, and is stopped and opened anew.

**Every byte feeds that time-out, not only commands that drive.** So nothing is asked of a board to which no command
goes: questions must not keep wheels turning without commands. And behind two frames that stay unanswered nothing is
sent, so that the board stops by itself.
"""

from __future__ import annotations

import math
import struct
from binascii import crc_hqx
from collections import deque
from typing import Annotated, ClassVar, Self

from msgspec.structs import replace
from pydantic import Field, PositiveInt, model_validator

from stadimeter.bases import protocol
from stadimeter.bases.serial_base import Answers, BaseMessage, Baud, SerialBaseOptions, SerialCodec, WheelCommand
from stadimeter.config.units import Duration, Length, Speed

FULL_DUTY = 32767

_SET_TIMEOUT, _TIMEOUT, _BATTERY, _DRIVE_DUTY, _DRIVE_SPEED, _ENCODERS, _STATUS = 14, 15, 24, 34, 37, 78, 90
_DONE = 0xFF
_CRC_BYTES = 2
# How many bytes of data answer a question. The status has 16 bits in old firmware, and 32 in new.
_ANSWER_BYTES = {_TIMEOUT: (1,), _BATTERY: (2,), _ENCODERS: (8,), _STATUS: (2, 4)}
# The board answers within milliseconds. What is older than so many frames was lost.
_MAX_UNANSWERED = 4

# The bits of the status that are errors, by whether it has 32 bits: warnings must not stop a robot.
_ERRORS = {
    False: {
        2: "emergency stop", 3: "too hot", 4: "second sensor too hot", 5: "battery voltage too high",
        6: "logic voltage too high", 7: "logic voltage too low", 8: "fault of driver 1", 9: "fault of driver 2",
    },
    True: {
        0: "emergency stop", 1: "too hot", 2: "second sensor too hot", 3: "battery voltage too high",
        4: "logic voltage too high", 5: "logic voltage too low", 6: "fault of driver 1", 7: "fault of driver 2",
        8: "speed error of motor 1", 9: "speed error of motor 2", 10: "position error of motor 1",
        11: "position error of motor 2", 12: "current error of motor 1", 13: "current error of motor 2",
    },
}  # fmt: skip


class RoboclawCodec(SerialCodec):
    """Packets of address, command, data and CRC-16. Answers carry neither length nor name, so what was asked is noted.

    A board discards a packet whose bytes pause for 10 ms. Within that time a new packet is read as the rest of one that
    was cut short; two stops end any of ours: the first completes it, and what is left of the second is passed over.

    Source: Basicmicro, RoboClaw Series User Manual, "Packet Serial" and "Advanced Packet Serial".

    Args:
        address: From 0x80 to 0x87.
        steps: One encoder count a second; without encoders, one step of duty.
        timeout_s: After how long without a byte the board stops its motors.
    """

    name = "RoboClaw"
    answers = Answers.EACH_COMMAND
    any_byte_feeds = True
    hint = "check that it is set to packet serial with this address and baud rate, that it is switched on"

    def __init__(self, *, address: int, steps: protocol.SpeedSteps, has_encoders: bool, timeout_s: float) -> None:
        self._address = address
        self._steps = steps
        self._timeout_units = round(timeout_s / protocol.TIMEOUT_UNIT_S)
        self._unanswered: deque[int] = deque(maxlen=_MAX_UNANSWERED)
        self._buffer = bytearray()
        self._encoders = [protocol.EncoderCounter(bits=32, count_m=steps.step_mps) for _ in range(2)]
        self._has_encoders = has_encoders
        self.ends_cut_frame = 2 * self.stop
        self.question = self.ask(_BATTERY)
        self.opening = (self.command(_SET_TIMEOUT, bytes([self._timeout_units])),)
        encoders = (_ENCODERS,) if has_encoders else ()
        self.polls = tuple(map(self.ask, (*encoders, _TIMEOUT, *encoders, _BATTERY, *encoders, _STATUS)))

    @property
    def stop(self) -> bytes:
        """Duty 0 of both motors, which ends a speed command too."""
        return self.command(_DRIVE_DUTY, bytes(4))

    def command(self, code: int, data: bytes) -> bytes:
        """Return a packet that is acknowledged."""
        packet = bytes([self._address, code]) + data
        return packet + crc_hqx(packet, 0).to_bytes(_CRC_BYTES, "big")

    def ask(self, code: int) -> bytes:
        """Return a question. It has no CRC; its answer has one, which covers the question too."""
        return bytes([self._address, code])

    def encode(self, wheels: protocol.WheelSpeeds) -> WheelCommand:
        """Return the command for wheel speeds: encoder counts a second, or duties if there are no encoders."""
        left, right = self._steps.count(wheels)
        if self._has_encoders:
            frame = self.command(_DRIVE_SPEED, struct.pack(">ii", left, right))
        else:
            frame = self.command(_DRIVE_DUTY, struct.pack(">hh", left, right))
        return WheelCommand(frame=frame, sent=self._steps.speeds(left, right))

    def note_sent(self, frame: bytes) -> None:
        """Take in which answer comes next. Nothing that was sent before the end of a cut frame is waited for."""
        if frame.startswith(self.ends_cut_frame):
            self._unanswered.clear()
            frame = frame.removeprefix(self.ends_cut_frame)
        self._unanswered.append(frame[1])

    def feed(self, data: bytes) -> list[BaseMessage]:
        """Return the answers to the frames that were noted, in their order; bytes that fit none are dropped."""
        self._buffer += data
        messages = []
        while self._unanswered and self._buffer:
            size = self._answer_size(self._unanswered[0])
            if size is None:
                break
            if size:
                messages.append(self._message(self._unanswered.popleft(), bytes(self._buffer[: size - _CRC_BYTES])))
            else:
                self.dropped_bytes += 1
            del self._buffer[: size or 1]
        if not self._unanswered:
            self.dropped_bytes += len(self._buffer)
            self._buffer.clear()
        return messages

    def _answer_size(self, code: int) -> int | None:
        """Return the number of first bytes that are the answer; 0 if they cannot be, None if more must come."""
        sizes = _ANSWER_BYTES.get(code)
        if sizes is None:
            return int(self._buffer[0] == _DONE)
        for size in sizes:
            whole = bytes(self._buffer[: size + _CRC_BYTES])
            if len(whole) == size + _CRC_BYTES and crc_hqx(self.ask(code) + whole, 0) == 0:
                return len(whole)
        return None if len(self._buffer) < sizes[-1] + _CRC_BYTES else 0

    def _message(self, code: int, data: bytes) -> BaseMessage:
        value = int.from_bytes(data, "big")
        match code:
            case 15:
                self._check_timeout(value)
                return BaseMessage()
            case 24:
                return BaseMessage(is_identity=True, battery_v=value / 10)
            case 78:
                left, right = struct.unpack(">II", data)
                return BaseMessage(left_m=self._encoders[0].travel_m(left), right_m=self._encoders[1].travel_m(right))
            case 90:
                return BaseMessage(
                    errors=tuple(error for bit, error in _ERRORS[len(data) > 2].items() if value >> bit & 1)
                )
        return BaseMessage(was_done=True)

    def _check_timeout(self, units: int) -> None:
        if units != self._timeout_units:
            self.trouble = (
                "it has forgotten its time-out: it was switched off and on, or its supply broke down; without one it "
                "would drive on for ever"
            )


class RoboclawOptions(SerialBaseOptions):
    """The options of a RoboClaw, with or without encoders."""

    title: ClassVar = "a RoboClaw motor controller on a serial port or USB"
    auto_stop_advice: ClassVar = 'write auto_stop = "300 ms"'

    baud: Baud = 38400
    """As it was set in the board. On USB it does not matter."""
    address: Annotated[int, Field(ge=0x80, le=0x87)] = 0x80
    """As it was set in the board."""
    wheel_diameter: Length | None = Field(default=None, examples=["10 cm"])
    """Diameter of the driven wheels; with encoders."""
    ticks_per_turn: PositiveInt | None = Field(default=None, examples=[2000])
    """Encoder ticks while a wheel turns once, all edges and the gear counted. None for motors without encoders."""
    full_speed: Speed | None = None
    """Without encoders: how fast a wheel rolls when its motor gets the whole voltage of the battery."""
    auto_stop: protocol.SerialTimeout = 0.3
    """The board stops when nothing came for this long."""
    boot_wait: Duration = 2.0
    """How long the board may take until it answers."""

    @model_validator(mode="after")
    def _check_wheels_are_known(self) -> Self:
        if (self.ticks_per_turn is None) != (self.wheel_diameter is None):
            raise ValueError("ticks_per_turn and wheel_diameter belong together: give both, or neither")
        if (self.ticks_per_turn is None) == (self.full_speed is None):
            raise ValueError("give ticks_per_turn and wheel_diameter for motors with encoders, or else full_speed")
        if self.full_speed is not None and self.max_wheel_speed > self.full_speed:
            raise ValueError("max_wheel_speed is beyond full_speed, which the wheels cannot exceed")
        return self

    def kinematics(self) -> protocol.DifferentialDrive:
        """Return the kinematics, with a limit of whole counts a second, or of whole steps of duty."""
        return replace(super().kinematics(), max_wheel_mps=self._steps().limit_mps(self.max_wheel_speed))

    def codec(self) -> RoboclawCodec:
        """Return a new codec of the protocol."""
        return RoboclawCodec(
            address=self.address, steps=self._steps(), has_encoders=self.full_speed is None, timeout_s=self.auto_stop
        )

    def stops_by_itself_after_s(self) -> float:
        """Return the serial time-out that is set at open."""
        return self.auto_stop

    def _steps(self) -> protocol.SpeedSteps:
        if self.ticks_per_turn and self.wheel_diameter:
            return protocol.SpeedSteps(step_mps=math.pi * self.wheel_diameter / self.ticks_per_turn)
        return protocol.SpeedSteps(step_mps=(self.full_speed or 0.0) / FULL_DUTY)
