"""The firmware of robot bases, emulated from what their protocols say: bytes in, wheel speeds and bytes out.

What the tests of drivers need alone; `ros_arduino_bridge`, which the demonstration has, is in the package.
"""

from __future__ import annotations

import json
import math
import re
import struct
from functools import reduce
from operator import xor
from typing import Any, ClassVar

from stadimeter.simulation.emulated_base import EmulatedBoardOptions, EmulatedFirmware

# The firmware of an OpenBot, emulated, as far as it drives: the example of a protocol that a configuration
# describes.
#
# As in the firmware: a letter, then a body until a line feed; ``h`` sets the time-out and feeds it, and nothing
# else does, so wheels that ``c`` alone drives stand still once it has run out; without any ``h`` they drive on for
# ever. What is simpler: wheels follow their duty with a time constant, and a duty of 255 is
# `OPENBOT_FULL_SPEED_MPS`. Source: ``openbot.ino`` of ob-f/OpenBot.

OPENBOT_FULL_SPEED_MPS = 0.8
VOLTAGE_EVERY_S = 1.0


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
            self.left.driven_mps, self.right.driven_mps = (duty * OPENBOT_FULL_SPEED_MPS for duty in duties)

    def _time_out(self) -> None:
        super()._time_out()
        self._is_timed_out = True

    def _unasked(self) -> bytes:
        if self._now_s - self._voltage_s < VOLTAGE_EVERY_S:
            return b""
        self._voltage_s = self._now_s
        return b"v%.2f\r\n" % self.battery_v


def _atoi(text: bytes) -> int:
    match = re.match(rb"\s*([+-]?\d+)", text)
    return int(match[1]) if match else 0


class EmulatedOpenBotOptions(EmulatedBoardOptions):
    """The port ``emulated-openbot``."""

    firmware: ClassVar = OpenBotFirmware


# A Sabertooth in packet serial mode, emulated down to the bytes, with wheels that take time to turn -------------------
#
# What is as in the manual: packets and their checksum, that it never answers, and the serial time-out, which is off
# after each start, and which every command feeds. What is simpler: no ramps, no dead zone, and no learning of the
# baud rate.
#
# Source: Dimension Engineering, Sabertooth 2x12 User's Guide, "Mode 4: Packetized Serial Mode".

# The speed of the emulated motors at full duty.
SABERTOOTH_FULL_MPS = 1.0
SABERTOOTH_FULL_DUTY = 127
SABERTOOTH_TIMEOUT_UNIT_S = 0.1

_PACKET_BYTES = 4


class SabertoothFirmware(EmulatedFirmware):
    """The board's program, as a function of bytes and time. Its first motor drives the left wheel."""

    takes_timeout: ClassVar = True

    def __init__(self, started_s: float = 0.0, ticks_per_metre: float = 4000.0) -> None:
        super().__init__(started_s, ticks_per_metre)
        self.address = 128
        self.switch_off_and_on()

    def switch_off_and_on(self) -> None:
        """Start again: motors off, and the serial time-out off, which is not kept."""
        self._time_out()
        self.timeout_s = math.inf
        self._packet = bytearray()

    def _take(self, data: bytes) -> bytes:
        for byte in data:
            self._take_byte(byte)
        return b""

    def _take_byte(self, byte: int) -> None:
        """Take one byte. Only an address is above 127, so that it begins a packet wherever it comes."""
        if byte >= 0x80:
            self._packet = bytearray([byte])
        elif self._packet:
            self._packet.append(byte)
        if len(self._packet) == _PACKET_BYTES:
            address, command, data, checksum = self._packet
            self._packet.clear()
            if address == self.address and (address + command + data) & 0x7F == checksum:
                self._obey(command, data)

    def _obey(self, command: int, data: int) -> None:
        duty_mps = (-data if command & 1 else data) / SABERTOOTH_FULL_DUTY * SABERTOOTH_FULL_MPS
        if command == 14:
            self.timeout_s = data * SABERTOOTH_TIMEOUT_UNIT_S or math.inf
        elif command in {0, 1}:
            self.left.driven_mps = duty_mps
        elif command in {4, 5}:
            self.right.driven_mps = duty_mps
        self._feed_timeout()


class EmulatedSabertoothOptions(EmulatedBoardOptions):
    """The port of the emulated board."""

    firmware: ClassVar = SabertoothFirmware


# The mainboard of a hoverboard with hoverboard-firmware-hack-FOC, emulated --------------------------------------------
#
# As in the firmware: a frame counts only if it is alone in a burst; motors stay off until a command near zero came;
# steer and speed are limited, then mixed. What is simpler: wheels follow their target with a time constant in place
# of rate limit, filter and motor control, and a command of 1000 is `HOVERBOARD_FULL_SPEED_MPS`.
#
# A pseudo-terminal knows no pauses. What arrives between two looks, each 2 ms, counts as one burst. Source:
# ``util.c``, ``main.c`` and ``config.h`` of EFeru/hoverboard-firmware-hack-FOC.

TIMEOUT_S = 0.8
HOVERBOARD_FULL_SPEED_MPS = 1.0
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
        unit_mps = HOVERBOARD_FULL_SPEED_MPS / 1000 if self._is_enabled else 0.0
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


# The driver board of a Waveshare UGV, emulated: its commands, its one-shot time-out and its reports -------------------
#
# As in the firmware: only wheel commands (``T`` 1 and 11) feed the time-out and start it again; a speed above 2 m/s
# is dropped but feeds it; ``T`` 13 does neither; ``T`` 0 stops and does not last. What is simpler: wheels follow
# their target with a time constant in place of the PID, and a duty of 255 is 1 m/s. Source: ``uart_ctrl.h``,
# ``movtion_module.h`` and ``ugv_advance.h`` of waveshareteam/ugv_base_ros.

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


# A RoboClaw in packet serial mode, emulated down to the bytes, with wheels that take time to turn ---------------------
#
# What is as in the manual: packets and their CRC, that a packet whose bytes pause is discarded, that its serial
# time-out is off after each start and is fed by every byte, also such that mean nothing. What is simpler: the
# velocity loop is replaced by wheels that follow their target with a time constant.
#
# Source: Basicmicro, RoboClaw Series User Manual, "Packet Serial" and "Advanced Packet Serial".

# A packet is discarded when its next byte takes longer than this.
MAX_BYTE_GAP_S = 0.010
ROBOCLAW_TIMEOUT_UNIT_S = 0.1

# The speed of the emulated motors at full duty.
ROBOCLAW_FULL_MPS = 1.0
ROBOCLAW_FULL_DUTY = 32767

_ROBOCLAW_DATA_BYTES = {14: 1, 34: 4, 37: 8}  # of the commands that write; questions carry no data and no CRC
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
        if len(packet) < 2 or (packet[1] in _ROBOCLAW_DATA_BYTES and len(packet) < _ROBOCLAW_DATA_BYTES[packet[1]] + 4):
            return b""
        self._packet = bytearray()
        return self._run(bytes(packet))

    def _run(self, packet: bytes) -> bytes:
        command = packet[1]
        if command in _QUESTIONS:
            data = self._answer(command)
            return data + struct.pack(">H", crc16(packet + data))
        if command not in _ROBOCLAW_DATA_BYTES or crc16(packet[:-2]) != struct.unpack(">H", packet[-2:])[0]:
            return b""
        self._obey(command, packet[2:-2])
        return b"\xff"

    def _obey(self, command: int, data: bytes) -> None:
        if command == 14:
            self._timeout_units = data[0]
            self.timeout_s = data[0] * ROBOCLAW_TIMEOUT_UNIT_S or math.inf
        elif command == 34:
            left, right = struct.unpack(">hh", data)
            self._drive(left / ROBOCLAW_FULL_DUTY * ROBOCLAW_FULL_MPS, right / ROBOCLAW_FULL_DUTY * ROBOCLAW_FULL_MPS)
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


# A Create 2, emulated down to the bytes of its Open Interface, with wheels that take time to turn ---------------------
#
# What is as in the specification: opcodes and how many data bytes follow them, modes and what leaves Safe mode, the
# 20 ms that a change of mode takes, the stream of sensor packets every 15 ms, encoders of 16 bits, and that
# **nothing ever ends a drive command**. What is simpler: no cleaning, no sleep; packets of what it lacks are 0.
#
# Source: iRobot Create 2 Open Interface Specification based on the Roomba 600.

STREAMED_EVERY_S = 0.015
MODE_CHANGE_S = 0.020  # what comes within this after a change of mode is lost
MAX_WHEEL_MPS = 0.5
TICKS_PER_METRE = 508.8 / (math.pi * 0.072)

OFF, PASSIVE, SAFE, FULL = range(4)
LAST_PACKET = 58

# How many data bytes follow an opcode, where there are any.
_ROOMBA_DATA_BYTES = {129: 1, 137: 4, 138: 1, 139: 3, 141: 1, 142: 1, 144: 3, 145: 4, 146: 4, 150: 1}
_STREAM = 148
_WORDS = {19, 20, *range(22, 24), *range(25, 32), 33, *range(39, 45), *range(46, 52), *range(54, 58)}


class RoombaFirmware(EmulatedFirmware):
    """The robot's program, as a function of bytes and time."""

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
        wanted = _ROOMBA_DATA_BYTES.get(command[0], 0)
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
            case 148 if all(7 <= packet <= LAST_PACKET for packet in data[1:]):
                self._streamed = data[1:]
                self._stream(is_on=True)
            case 150:
                self._stream(is_on=data[0] == 1)
            case 173:
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


class EmulatedRoombaOptions(EmulatedBoardOptions):
    """The port of the emulated robot, a Create 2."""

    firmware: ClassVar = RoombaFirmware
