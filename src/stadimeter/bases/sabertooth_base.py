"""A Sabertooth of Dimension Engineering on a serial port, in packet serial mode.

**One wire, one way: it answers nothing.** Whether it is there, and whether a command arrived, cannot be known. What
makes up for that is its serial time-out: it is off after each start of the board, is set at open, and goes out again
with every command, so that a board whose battery was changed meanwhile has it too.

It drives motors by duty, not by speed: on a slope, or with a low battery, the same command is slower.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

from msgspec.structs import replace
from pydantic import Field

from stadimeter.bases import protocol
from stadimeter.bases.serial_base import Answers, BaseMessage, Baud, DutyBaseOptions, SerialCodec, WheelCommand
from stadimeter.config.units import Duration

FULL_DUTY = 127

# The first and the second motor forwards; one more is backwards.
_LEFT, _RIGHT, _TIMEOUT = 0, 4, 14

# Boards without a fixed baud rate learn it from this byte. Others take it for the address of somebody else.
_BAUD_BYTE = b"\xaa"


class SabertoothCodec(SerialCodec):
    """Packets of address, command, data and a checksum of 7 bits. Only an address is above 127, so each begins anew.

    Source: Dimension Engineering, Sabertooth 2x12 User's Guide, "Mode 4: Packetized serial".

    Args:
        address: As the switches of the board have it, from 128 to 135.
        timeout_s: After how long without a command the board stops its motors.
    """

    name = "Sabertooth"
    answers = Answers.NEVER
    ends_cut_frame = _BAUD_BYTE

    def __init__(self, *, address: int, steps: protocol.SpeedSteps, timeout_s: float) -> None:
        self._address = address
        self._steps = steps
        self._was_read = False
        self._timeout = self.packet(_TIMEOUT, round(timeout_s / protocol.TIMEOUT_UNIT_S))

    @property
    def stop(self) -> bytes:
        """Both motors off, and the time-out with that."""
        return self._drive(0, 0)

    def packet(self, command: int, data: int) -> bytes:
        """Return one packet."""
        return bytes([self._address, command, data, (self._address + command + data) & 0x7F])

    def encode(self, wheels: protocol.WheelSpeeds) -> WheelCommand:
        """Return the duties for wheel speeds, and the speeds that those make."""
        left, right = self._steps.count(wheels)
        return WheelCommand(frame=self._drive(left, right), sent=self._steps.speeds(left, right))

    def feed(self, data: bytes) -> list[BaseMessage]:
        """Return nothing. What talks while the port is opened is something else; later it is noise on an open wire."""
        if data and not self._was_read:
            self.trouble = "something talks there, and a Sabertooth never does; is this the right port?"
        self._was_read = True
        self.dropped_bytes += len(data)
        return []

    def _drive(self, left: int, right: int) -> bytes:
        motors = ((_LEFT, left), (_RIGHT, right))
        return b"".join(self.packet(motor + (duty < 0), abs(duty)) for motor, duty in motors) + self._timeout


class SabertoothOptions(DutyBaseOptions):
    """The options of a Sabertooth in packetized serial mode."""

    title: ClassVar = "a Sabertooth motor driver on a serial port"
    auto_stop_advice: ClassVar = 'write auto_stop = "300 ms"'

    baud: Baud = 9600
    """As it was set in the board."""
    address: Annotated[int, Field(ge=128, le=135)] = 128
    """As the switches of the board have it."""
    auto_stop: protocol.SerialTimeout = 0.3
    """The board stops when no command came for this long."""
    boot_wait: Duration = 0.7
    """For how long stops are sent before anything else; the board needs half a second to learn the baud rate."""

    def kinematics(self) -> protocol.DifferentialDrive:
        """Return the kinematics, with a limit of whole steps of duty."""
        return replace(super().kinematics(), max_wheel_mps=self._steps().limit_mps(self.max_wheel_speed))

    def codec(self) -> SabertoothCodec:
        """Return a new codec of the protocol."""
        return SabertoothCodec(address=self.address, steps=self._steps(), timeout_s=self.auto_stop)

    def stops_by_itself_after_s(self) -> float:
        """Return the serial time-out that is set at open."""
        return self.auto_stop

    def _steps(self) -> protocol.SpeedSteps:
        return protocol.SpeedSteps(step_mps=self.full_speed / FULL_DUTY)
