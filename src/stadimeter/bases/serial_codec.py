"""The facts that the driver of a base on a serial port must know of its protocol. No port is touched here."""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum
from typing import ClassVar

from msgspec import Struct

from stadimeter.bases.differential_drive import WheelSpeeds


class Answers(Enum):
    """The kinds of answers that a base sends."""

    EACH_COMMAND = "an acknowledgement of each command, in order"
    STREAM = "reports, all the time, and no acknowledgements"
    NEVER = "nothing"


class WheelCommand(Struct, frozen=True, kw_only=True):
    """The bytes that drive both wheels, to send in one write, and the speeds that they really say."""

    frame: bytes
    sent: WheelSpeeds


class BaseMessage(Struct, frozen=True, kw_only=True):
    """The content of one frame, line or answer of a base. None stands for what it does not speak of.

    Attributes:
        is_identity: Whether only a base of this protocol says that, and says it once it runs.
        was_done: Of an acknowledgement, whether the command was done, or else refused.
        left_m: How far the left wheel of the base has rolled in all; the zero does not matter.
        right_m: The same of the right wheel. Both come together.
        left_mps, right_mps: How fast the wheels roll, from a base that counts no travel. Both come together.
        battery_v, is_bumped, is_at_cliff, errors: As in `stadimeter.core.command.BaseReport`.
    """

    is_identity: bool = False
    was_done: bool | None = None
    battery_v: float | None = None
    is_bumped: bool | None = None
    is_at_cliff: bool | None = None
    left_m: float | None = None
    right_m: float | None = None
    left_mps: float | None = None
    right_mps: float | None = None
    errors: tuple[str, ...] | None = None


class SerialCodec(ABC):
    """The protocol of a base, as bytes and values. Each opening of the port begins with a new one.

    Left and right are here as the base has them; how its motors are wired, the driver makes up for.

    Attributes:
        name: What it is, for messages, such as ``ros_arduino_bridge``.
        answers: What the base sends.
        stop: Makes the base stand.
        ends_cut_frame: What makes the base forget a frame of which it got only the beginning; sent before the next one.
        wake: Frames that come before the question, each by itself with time to take effect.
        question: What a base that runs answers with its identity. Empty if it says that unasked, or never.
        opening: What is sent once, after that: the time-out of the firmware, which reports to send.
        polls: Questions that are asked in turn, five a second while it stands or commands come, for reports.
        closing: What is sent after the last stop.
        gap_s: How long the line must be quiet between two frames.
        stops: How often a stop is sent to a base that acknowledges none.
        any_byte_feeds: Whether every byte keeps the base from stopping by itself, and not only commands that drive.
        hint: What to check when nothing answers.
        refusal_hint: What is wrong when a base refuses to drive.
        trouble: Why the base, which answers, does not drive, as far as it was heard; empty if it does.
        dropped_bytes: How many bytes came that mean nothing.
    """

    name: ClassVar[str]
    answers: ClassVar[Answers]
    hint: ClassVar[str] = "check that its firmware is loaded, that the baud rate is right, and that it is switched on"
    refusal_hint: ClassVar[str] = ""
    gap_s: ClassVar[float] = 0.0
    stops: ClassVar[float] = 3
    any_byte_feeds: ClassVar[bool] = False
    ends_cut_frame: bytes = b""
    wake: tuple[bytes, ...] = ()
    question: bytes = b""
    opening: tuple[bytes, ...] = ()
    polls: tuple[bytes, ...] = ()
    closing: tuple[bytes, ...] = ()
    trouble: str = ""
    dropped_bytes: int = 0

    @property
    @abstractmethod
    def stop(self) -> bytes:
        """The frame that makes the base stand."""

    @abstractmethod
    def encode(self, wheels: WheelSpeeds) -> WheelCommand:
        """Return the command for wheel speeds that are within the driver's limit."""

    @abstractmethod
    def feed(self, data: bytes) -> list[BaseMessage]:
        """Return the messages complete now, oldest first, however the bytes are split and whatever noise is between."""

    def note_sent(self, frame: bytes) -> None:  # noqa: B027 -- most protocols need not know
        """Take in that a frame was sent, where an answer means nothing without its question."""


class TextLine(Struct, frozen=True, kw_only=True):
    """A line of printable ASCII.

    Attributes:
        noise: How many bytes were dropped from it, so that a number in it may lack digits.
    """

    text: str
    noise: int


class LineReader:
    """Makes lines of bytes, however they are split, and finds its way back after noise.

    Args:
        max_bytes: Of a longer line, only the end is kept.
    """

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._line = bytearray()
        self._noise = 0

    def feed(self, data: bytes) -> list[TextLine]:
        """Return the lines that are complete now, oldest first. A line feed or a carriage return ends one."""
        lines: list[TextLine] = []
        for byte in data:
            if byte in b"\r\n":
                if self._line or self._noise:
                    lines.append(TextLine(text=self._line.decode("ascii").strip(), noise=self._noise))
                self._line.clear()
                self._noise = 0
            elif 0x20 <= byte < 0x7F:
                self._take(byte)
            else:
                self._noise += len(self._line) + 1
                self._line.clear()
        return lines

    def _take(self, byte: int) -> None:
        self._line.append(byte)
        if len(self._line) > self._max_bytes:
            del self._line[0]
            self._noise += 1
