"""A RoboClaw in packet serial mode, emulated down to the bytes, with wheels that take time to turn.

What is as in the manual: packets and their CRC, that a packet whose bytes pause is discarded, that its serial time-out
is off after each start and is fed by every byte, also such that mean nothing. What is simpler: the velocity loop is
replaced by wheels that follow their target with a time constant.

Source: Basicmicro, RoboClaw Series User Manual, "Packet Serial" and "Advanced Packet Serial".
"""

from __future__ import annotations

import math
import struct
from typing import ClassVar

from stadimeter.simulation.emulated_base import EmulatedBoardOptions, EmulatedFirmware

# A packet is discarded when its next byte takes longer than this.
MAX_BYTE_GAP_S = 0.010
TIMEOUT_UNIT_S = 0.1

# The speed of the emulated motors at full duty.
FULL_DUTY_MPS = 1.0
FULL_DUTY = 32767

_DATA_BYTES = {14: 1, 34: 4, 37: 8}  # of the commands that write; questions carry no data and no CRC
_QUESTIONS = (15, 24, 78, 90)


def crc16(data: bytes) -> int:
    """Return the CRC-16 of the manual: polynomial 0x1021 from 0, most significant bit first."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


class RoboclawFirmware(EmulatedFirmware):
    """The board's program, as a function of bytes and time. Its first motor drives the left wheel."""

    takes_timeout: ClassVar = True

    def __init__(self, started_s: float = 0.0, ticks_per_metre: float = 4000.0) -> None:
        super().__init__(started_s, ticks_per_metre)
        self.address = 0x80
        self.status = 0  # the bits of command 90
        self.is_old = False  # whether it answers command 90 with 16 bits, as old firmware does
        self.switch_off_and_on()

    def switch_off_and_on(self) -> None:
        """Start again: motors off, encoders at zero, and the serial time-out off, which is not kept."""
        self._time_out()
        self._timeout_units = 0
        self.timeout_s = math.inf
        self._packet = bytearray()
        self._byte_at_s = self._now_s
        self._zero_m = (self.left.rolled_m, self.right.rolled_m)

    def _take(self, data: bytes) -> bytes:
        if not data:
            return b""
        if self._now_s - self._byte_at_s > MAX_BYTE_GAP_S:
            self._packet.clear()
        self._byte_at_s = self._now_s
        answers = b"".join(self._take_byte(byte) for byte in data)
        self._feed_timeout()
        return answers

    def _take_byte(self, byte: int) -> bytes:
        """Take one byte, and return the answer if it completes a packet. Bytes before an address are passed over."""
        packet = self._packet
        if not packet and byte != self.address:
            return b""
        packet.append(byte)
        if len(packet) < 2 or (packet[1] in _DATA_BYTES and len(packet) < _DATA_BYTES[packet[1]] + 4):
            return b""
        self._packet = bytearray()
        return self._run(bytes(packet))

    def _run(self, packet: bytes) -> bytes:
        command = packet[1]
        if command in _QUESTIONS:
            data = self._answer(command)
            return data + struct.pack(">H", crc16(packet + data))
        if command not in _DATA_BYTES or crc16(packet[:-2]) != struct.unpack(">H", packet[-2:])[0]:
            return b""
        self._obey(command, packet[2:-2])
        return b"\xff"

    def _obey(self, command: int, data: bytes) -> None:
        if command == 14:
            self._timeout_units = data[0]
            self.timeout_s = data[0] * TIMEOUT_UNIT_S or math.inf
        elif command == 34:
            left, right = struct.unpack(">hh", data)
            self._drive(left / FULL_DUTY * FULL_DUTY_MPS, right / FULL_DUTY * FULL_DUTY_MPS)
        else:
            left, right = struct.unpack(">ii", data)
            self._drive(left / self.ticks_per_metre, right / self.ticks_per_metre)

    def _answer(self, question: int) -> bytes:
        match question:
            case 15:
                return bytes([self._timeout_units])
            case 24:
                return struct.pack(">H", round(self.battery_v * 10))
            case 78:
                rolled_m = (self.left.rolled_m - self._zero_m[0], self.right.rolled_m - self._zero_m[1])
                return struct.pack(">II", *(int(each_m * self.ticks_per_metre) & 0xFFFFFFFF for each_m in rolled_m))
        return struct.pack(">H" if self.is_old else ">I", self.status)


class EmulatedRoboclawOptions(EmulatedBoardOptions):
    """The port of the emulated board."""

    firmware: ClassVar = RoboclawFirmware
