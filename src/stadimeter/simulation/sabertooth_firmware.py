"""A Sabertooth in packet serial mode, emulated down to the bytes, with wheels that take time to turn.

What is as in the manual: packets and their checksum, that it never answers, and the serial time-out, which is off after
each start, and which every command feeds. What is simpler: no ramps, no dead zone, and no learning of the baud rate.

Source: Dimension Engineering, Sabertooth 2x12 User's Guide, "Mode 4: Packetized Serial Mode".
"""

from __future__ import annotations

import math
from typing import ClassVar

from stadimeter.simulation.emulated_base import EmulatedBoardOptions, EmulatedFirmware

# The speed of the emulated motors at full duty.
FULL_DUTY_MPS = 1.0
FULL_DUTY = 127
TIMEOUT_UNIT_S = 0.1

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
        duty_mps = (-data if command & 1 else data) / FULL_DUTY * FULL_DUTY_MPS
        if command == 14:
            self.timeout_s = data * TIMEOUT_UNIT_S or math.inf
        elif command in {0, 1}:
            self.left.driven_mps = duty_mps
        elif command in {4, 5}:
            self.right.driven_mps = duty_mps
        self._feed_timeout()


class EmulatedSabertoothOptions(EmulatedBoardOptions):
    """The port of the emulated board."""

    firmware: ClassVar = SabertoothFirmware
