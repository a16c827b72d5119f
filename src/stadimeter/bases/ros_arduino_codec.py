"""The ASCII protocol of ros_arduino_bridge, as bytes and values. No port is touched here.

A command is one letter with arguments after single spaces, ended by a carriage return and nothing else. A line feed
does not end a command: the sketch appends it to an argument of 16 bytes whose bounds it does not check, so a host
with the wrong line ending has a robot that never moves and soon crashes. An answer is one line, ended by both.

Source: ``ROSArduinoBridge.ino`` and ``commands.h`` of hbrobotics/ros_arduino_bridge and of the fork by joshnewans.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from stadimeter.errors import CommandRangeError

END = b"\r"
STOP = b"m 0 0" + END
ASK_BAUD_RATE = b"b" + END
ASK_ENCODERS = b"e" + END
RESET_ENCODERS = b"r" + END

# Length of one frame of the firmware's speed control: 30 a second are meant, and ``1000 / 30`` is 33 ms in C.
FRAME_S = 0.033

# The firmware reads arguments into 16 bits.
MAX_TICKS_PER_FRAME = 32767

_MAX_LINE_BYTES = 64
_NUMBER = re.compile(r"-?\d{1,11}")
_TWO_NUMBERS = re.compile(r"(-?\d{1,11}) (-?\d{1,11})")


@dataclass(frozen=True, slots=True)
class Acknowledged:
    """``OK``: a command was done."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EncoderCounts:
    """The answer to `ASK_ENCODERS`: ticks of each wheel since the last reset."""

    left: int
    right: int


@dataclass(frozen=True, slots=True, kw_only=True)
class BaudRate:
    """The answer to `ASK_BAUD_RATE`, in bits per second; it shows that the firmware runs."""

    baud: int


@dataclass(frozen=True, slots=True)
class Refused:
    """``Invalid Command``: the firmware does not know the command, or was built without it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Garbage:
    """Bytes that were dropped: noise, a boot loader's, or a line without meaning; `text` is their printable end."""

    size: int
    text: str = ""


Reply = Acknowledged | EncoderCounts | BaudRate | Refused | Garbage


def encode_drive(left_ticks: int, right_ticks: int) -> bytes:
    """Return the command that drives both wheels at a speed in ticks per frame (`FRAME_S`), to send in one write.

    Raises `CommandRangeError` for a speed beyond the firmware's 16 bits.
    """
    if max(abs(left_ticks), abs(right_ticks)) > MAX_TICKS_PER_FRAME:
        raise CommandRangeError(
            f"{left_ticks} and {right_ticks} ticks per frame are not both within ±{MAX_TICKS_PER_FRAME}"
        )
    return f"m {left_ticks} {right_ticks}".encode() + END


class ReplyParser:
    """Makes replies of bytes, however they are split, and finds its way back after noise.

    Words are recognised even right behind noise. Numbers are not, because the noise may have eaten a digit.
    """

    def __init__(self) -> None:
        self._line = bytearray()
        self._noise = 0
        self._dropped_bytes = 0

    @property
    def dropped_bytes(self) -> int:
        """Number of bytes that were dropped as garbage so far."""
        return self._dropped_bytes

    def feed(self, data: bytes) -> list[Reply]:
        """Return the replies that are complete now, oldest first; garbage comes before the reply behind it."""
        replies: list[Reply] = []
        for byte in data:
            if byte in b"\r\n":
                replies += self._end_of_line()
            elif 0x20 <= byte < 0x7F:
                self._take(byte)
            else:
                self._noise += len(self._line) + 1
                self._line.clear()
        return replies

    def _take(self, byte: int) -> None:
        self._line.append(byte)
        if len(self._line) > _MAX_LINE_BYTES:
            del self._line[0]
            self._noise += 1

    def _end_of_line(self) -> list[Reply]:
        text, noise = self._line.decode("ascii"), self._noise
        self._line.clear()
        self._noise = 0
        reply = _understand(text.strip(), behind_noise=noise > 0)
        if reply is None and (text or noise):
            self._dropped_bytes += noise + len(text)
            return [Garbage(size=noise + len(text), text=text)]
        self._dropped_bytes += noise
        return ([Garbage(size=noise)] if noise else []) + ([reply] if reply else [])


def _understand(text: str, *, behind_noise: bool) -> Reply | None:
    if text == "OK":
        return Acknowledged()
    if text == "Invalid Command":
        return Refused()
    if behind_noise:
        return None
    if counts := _TWO_NUMBERS.fullmatch(text):
        return EncoderCounts(left=int(counts[1]), right=int(counts[2]))
    return BaudRate(baud=int(text)) if _NUMBER.fullmatch(text) else None
