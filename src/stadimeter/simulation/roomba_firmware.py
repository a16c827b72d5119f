"""A Create 2 or a Create 1, emulated down to the bytes of its Open Interface, with wheels that take time to turn.

What is as in the specification: opcodes and how many data bytes follow them, modes and what leaves Safe mode, the 20 ms
that a change of mode takes, the stream of sensor packets every 15 ms, encoders of 16 bits, and that **nothing ever ends
a drive command**. What is simpler: no cleaning, no sleep; packets of what it lacks are 0.

Source: iRobot Create 2 Open Interface Specification based on the Roomba 600; Create Open Interface of 2006.
"""

from __future__ import annotations

import math
import struct
from typing import ClassVar

from stadimeter.simulation.emulated_base import EmulatedBoardOptions, EmulatedFirmware

STREAMED_EVERY_S = 0.015
MODE_CHANGE_S = 0.020  # what comes within this after a change of mode is lost
MAX_WHEEL_MPS = 0.5
TICKS_PER_METRE = 508.8 / (math.pi * 0.072)

OFF, PASSIVE, SAFE, FULL = range(4)

# How many data bytes follow an opcode, where there are any.
_DATA_BYTES = {129: 1, 137: 4, 138: 1, 139: 3, 141: 1, 142: 1, 144: 3, 145: 4, 146: 4, 150: 1}
_STREAM = 148
_WORDS = {19, 20, *range(22, 24), *range(25, 32), 33, *range(39, 45), *range(46, 52), *range(54, 58)}


class RoombaFirmware(EmulatedFirmware):
    """The robot's program, as a function of bytes and time."""

    last_packet: ClassVar = 58

    def __init__(self, started_s: float = 0.0, ticks_per_metre: float = TICKS_PER_METRE) -> None:
        super().__init__(started_s, ticks_per_metre)
        # What its sensors see: the cliff is below all four that look down.
        self.is_bumped = self.is_at_cliff = self.is_wheel_dropped = self.is_on_charger = False
        self.overcurrents = 0
        self.mode = OFF
        self._command = bytearray()
        self._deaf_until_s = started_s
        self._streamed = b""
        self._stream_at_s = math.inf

    def step(self, now_s: float) -> None:
        """Live until that time, and leave Safe mode for what the specification names."""
        super().step(now_s)
        drives_over_an_edge = self.is_at_cliff and self.left.driven_mps + self.right.driven_mps > 0
        if self.mode == SAFE and (self.is_wheel_dropped or self.is_on_charger or drives_over_an_edge):
            self._enter(PASSIVE)

    def _take(self, data: bytes) -> bytes:
        for byte in data:
            if self._now_s >= self._deaf_until_s:
                self._take_byte(byte)
        return b""

    def _take_byte(self, byte: int) -> None:
        """Take one byte: an opcode, unless the one before still wants data. Unknown opcodes are passed over."""
        command = self._command
        command.append(byte)
        wanted = _DATA_BYTES.get(command[0], 0)
        if command[0] == _STREAM:
            wanted = 1 + command[1] if len(command) > 1 else 1
        if len(command) > wanted:
            self._command = bytearray()
            self._run(command[0], bytes(command[1:]))

    def _run(self, opcode: int, data: bytes) -> None:
        if opcode == 128:
            self._change_mode(PASSIVE)
        elif self.mode != OFF:
            self._run_started(opcode, data)

    def _run_started(self, opcode: int, data: bytes) -> None:
        match opcode:
            case 131 | 132:
                self._change_mode(SAFE if opcode == 131 else FULL)
            case 145 if self.mode >= SAFE:
                right, left = (max(-MAX_WHEEL_MPS, min(MAX_WHEEL_MPS, mm / 1e3)) for mm in struct.unpack(">hh", data))
                self._drive(left, right)
            case 148 if all(7 <= packet <= self.last_packet for packet in data[1:]):
                self._streamed = data[1:]
                self._stream(is_on=True)
            case 150:
                self._stream(is_on=data[0] == 1)
            case 173 if self.last_packet == RoombaFirmware.last_packet:
                self._change_mode(OFF)
                self._stream(is_on=False)

    def _stream(self, *, is_on: bool) -> None:
        self._stream_at_s = self._now_s + STREAMED_EVERY_S if is_on and self._streamed else math.inf

    def _change_mode(self, mode: int) -> None:
        self._enter(mode)
        self._deaf_until_s = self._now_s + MODE_CHANGE_S

    def _enter(self, mode: int) -> None:
        self.mode = mode
        if mode < SAFE:
            self._time_out()

    def _unasked(self) -> bytes:
        """Return the frame of the stream that is due. Frames that were due before it are lost, as on a wire."""
        if self._now_s < self._stream_at_s:
            return b""
        while self._stream_at_s <= self._now_s:
            self._stream_at_s += STREAMED_EVERY_S
        data = b"".join(bytes([packet]) + self._sensors(packet) for packet in self._streamed)
        frame = bytes([19, len(data)]) + data
        return frame + bytes([-sum(frame) & 0xFF])

    def _sensors(self, packet: int) -> bytes:
        value = self._value(packet)
        return struct.pack(">H", value & 0xFFFF) if packet in _WORDS else bytes([value])

    def _value(self, packet: int) -> int:
        if packet == 7:
            return 0b11 * self.is_bumped | 0b1100 * self.is_wheel_dropped
        if packet in {9, 10, 11, 12}:
            return int(self.is_at_cliff)
        if packet in {43, 44}:
            return int((self.left if packet == 43 else self.right).rolled_m * TICKS_PER_METRE)
        return {14: self.overcurrents, 22: round(self.battery_v * 1e3), 35: self.mode}.get(packet, 0)


class Create1Firmware(RoombaFirmware):
    """A Create 1, which has no encoders, and cannot leave its Open Interface."""

    last_packet: ClassVar = 42


class EmulatedRoombaOptions(EmulatedBoardOptions):
    """The port of the emulated robot, a Create 2."""

    firmware: ClassVar = RoombaFirmware
