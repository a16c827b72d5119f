"""The parts that every base on a serial port has in common: its options, and the driver around its codec.

A base is one file with two classes: its options, derived from `SerialBaseOptions`, and its protocol, a
`stadimeter.bases.serial_base.SerialCodec`. Opening the port, waiting for the base, limits, signs and order of the
wheels, silence, stops that must be repeated, frames that were sent in part, and the way out are here.
"""

from __future__ import annotations

import errno
import itertools
import math
import os
import select
import termios
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import suppress
from enum import Enum
from itertools import cycle
from pathlib import Path
from typing import Annotated, ClassVar, Self

import serial
from msgspec import Struct
from msgspec.structs import replace
from pydantic import AfterValidator, Field, model_validator
from serial.tools import list_ports

from stadimeter.bases.protocol import Acknowledgements, DifferentialDrive, Motion, Unacknowledged, WheelSpeeds
from stadimeter.config.plugins import PORTS, DriverContext, DriverOptions, SerialStop, driver_names
from stadimeter.config.units import Duration, Length, SerialPort, Speed
from stadimeter.core.clock import Clock
from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.errors import DeviceClosedError, DeviceOpenError, LinkLostError, ProtocolError

# The facts that the driver of a base on a serial port must know of its protocol. No port is touched here.


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
        stop_repeats: How often a stop is sent to a base that acknowledges none.
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
    stop_repeats: ClassVar[float] = 3
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


# The one way to a serial port: opened for us alone, never waiting long, and with errors that say what to do -----------

# A port that still holds bytes back after this long is a port whose other end does not read.
UNTAKEN_AFTER_S = 0.05

DRAIN_TIMEOUT_S = 0.1

_MAX_BYTES_PER_READ = 4096
_ABSENT = {errno.ENOENT, errno.ENODEV, errno.ENXIO}
_TAKEN = {errno.EBUSY, errno.EAGAIN}
_FORBIDDEN = {errno.EACCES, errno.EPERM}


class SerialLink:
    """A serial port, `path`, that carries bytes.

    Opening it resets most Arduinos, because it raises DTR.

    A time-out that is measured with one's own clock blames the other side for one's own delay: this process may wait
    for a processor longer than any limit here, while the port took every byte. So a limit only says when to look once
    more, and what counts is what is left then. pyserial's own write goes wrong both ways: with a ``write_timeout``
    above 0 it reports a frame that was taken whole, but late, and with 0 it never returns from a port that is full.
    """

    def __init__(self, path: str, baud: int) -> None:
        self.path = path
        self._baud = baud
        self._port: serial.Serial | None = None

    def open(self) -> None:
        """Open the port and lock it, so that no second program can mix its bytes with ours."""
        try:
            self._port = serial.Serial(self.path, self._baud, timeout=0, exclusive=True)
        except (OSError, ValueError, termios.error) as error:
            raise DeviceOpenError(_open_trouble(self.path, error)) from error

    def write(self, frame: bytes) -> None:
        """Hand a frame to the port: at once as a rule, else as the other end makes room.

        Raises:
            LinkLostError: The port is gone, or bytes of the frame remain after `UNTAKEN_AFTER_S`. Part of the frame
                may have been sent. What waited in the port is thrown away: the next frame, mostly a stop, shall neither
                find it full nor come after commands from before.
        """
        deadline_s = time.monotonic() + UNTAKEN_AFTER_S
        left = frame[self._offer(frame) :]
        while left:
            wait_s = deadline_s - time.monotonic()
            if wait_s > 0:
                self._wait_for_room(wait_s)
            left = left[self._offer(left) :]
            if left and wait_s <= 0:
                self.discard()
                raise LinkLostError(
                    f"the serial port {self.path} has not taken {len(left)} bytes in {UNTAKEN_AFTER_S * 1e3:.0f} ms; "
                    "the other end does not read: check the base and its cable"
                )

    def read(self) -> bytes:
        """Read the bytes that have arrived, if any; never waits. Raises `LinkLostError` if the port is gone."""
        port = self._opened()
        try:
            return port.read(_MAX_BYTES_PER_READ)
        except OSError as error:
            raise self._lost(error) from error

    def drain(self) -> None:
        """Wait until everything written has left the computer; raises `LinkLostError` after `DRAIN_TIMEOUT_S`."""
        deadline_s = time.monotonic() + DRAIN_TIMEOUT_S
        while self.waiting() and time.monotonic() < deadline_s:
            time.sleep(0.001)
        if left := self.waiting():
            raise LinkLostError(f"the last {left} bytes to the serial port {self.path} have not left in time")

    def close(self) -> None:
        """Release the port, without what has not left it: the system may wait for that for half a minute.

        May be called any number of times.
        """
        with suppress(LinkLostError):
            if self._port and self.waiting():
                self.discard()
        port, self._port = self._port, None
        if port:
            port.close()

    def _offer(self, data: bytes) -> int:
        """Offer bytes to the port, and return how many it took."""
        descriptor = self._opened().fileno()
        try:
            return os.write(descriptor, data)  # pyserial opens the port so that this never waits
        except BlockingIOError:
            return 0
        except OSError as error:
            raise self._lost(error) from error

    def waiting(self) -> int:
        """Return the number of bytes that have not left the port."""
        port = self._opened()
        try:
            return port.out_waiting
        except OSError as error:
            raise self._lost(error) from error

    def discard(self) -> None:
        """Throw away what has not left the port. The other end may have the beginning of a frame."""
        with suppress(OSError, termios.error):
            self._opened().reset_output_buffer()

    def _wait_for_room(self, seconds: float) -> None:
        waiting = select.poll()
        waiting.register(self._opened().fileno(), select.POLLOUT)
        waiting.poll(seconds * 1e3)

    def _opened(self) -> serial.Serial:
        if self._port is None:
            raise DeviceClosedError(f"the serial port {self.path} is not open")
        return self._port

    def _lost(self, error: OSError) -> LinkLostError:
        return LinkLostError(f"the serial port {self.path} is gone, was the base unplugged? ({error})")


def port_lacks(path: str) -> tuple[str, ...]:
    """Return why a port cannot be opened, as far as that shows without opening it, which would reset an Arduino."""
    if not Path(path).exists():
        return (_open_trouble(path, FileNotFoundError(errno.ENOENT, path)),)
    if not os.access(path, os.R_OK | os.W_OK):
        return (_open_trouble(path, PermissionError(errno.EACCES, path)),)
    return ()


def _open_trouble(path: str, error: Exception) -> str:
    number = getattr(error, "errno", None)
    if number in _ABSENT:
        return f"there is no serial port {path}; {_existing_ports()}"
    if number in _TAKEN:
        return f"the serial port {path} is already open in another program, or twice in this one; close the other"
    if number in _FORBIDDEN:
        return (
            f"this user may not use the serial port {path}; "
            "add yourself to the group dialout (sudo usermod -aG dialout $USER), then log in again"
        )
    return f"the serial port {path} cannot be opened: {error}"


def _existing_ports() -> str:
    found = sorted(port.device for port in list_ports.comports())
    return f"these exist: {', '.join(found)}" if found else "none is plugged in: check the cable"


# The first exchange with a base on a serial port that was just opened; the base may still be booting ------------------

_ASKED_EVERY_S = 0.2
_READ_EVERY_S = 0.02
_ANSWER_WITHIN_S = 0.5

# What changes the mode of a base has this long to take effect: a Roomba takes nothing for 20 ms meanwhile.
TAKES_EFFECT_S = 0.03


class Greeting(Struct, kw_only=True):
    """Waits for a base, sets its time-out, and leaves it standing.

    Each try begins with the end of a frame and a stop. A base that drove when an earlier program died shall not drive
    on while we ask, and half a command of that program shall not swallow our stop.
    """

    link: SerialLink
    clock: Clock
    codec: SerialCodec
    boot_wait_s: float

    def run(self) -> None:
        """Wait until the base answers, send what opens it, and stop it.

        Raises:
            DeviceOpenError: Nothing answers, or not as this base does.
            ProtocolError: The base refuses to drive.
            LinkLostError: The port is gone.
        """
        if self.codec.answers is Answers.NEVER:
            self._stand_for(self.boot_wait_s)
            self.codec.feed(self.link.read())
        elif self._identify() > 1 and self.codec.answers is Answers.EACH_COMMAND:
            self._let_late_answers_pass()
        self._check_trouble()
        for frame in (*self.codec.opening, self.codec.stop):
            self._send(frame)
            if self.codec.answers is Answers.EACH_COMMAND:
                self._confirm(frame)
            else:
                self._pause(_READ_EVERY_S)

    def _identify(self) -> int:
        """Ask until the base shows what it is, and return how often it was asked."""
        deadline_s = self.clock.now_s() + self.boot_wait_s
        for tries in itertools.count(1):
            self._send(self.codec.ends_cut_frame + self.codec.stop)
            for frame in self.codec.wake:
                self._send(frame)
                self._pause(TAKES_EFFECT_S)
            if self.codec.question:
                self._pause(self.codec.gap_s)
                self._send(self.codec.question)
            is_known = any(message.is_identity for message in self._messages_for(_ASKED_EVERY_S))
            if is_known and (self.codec.answers is Answers.EACH_COMMAND or self._is_awake()):
                return tries
            if self.clock.now_s() >= deadline_s:
                break
        self._check_trouble()
        raise DeviceOpenError(self._no_answer_error())

    def _check_trouble(self) -> None:
        if self.codec.trouble:
            raise ProtocolError(f"no {self.codec.name} that drives is at {self.link.path}: {self.codec.trouble}")

    def _stand_for(self, seconds: float) -> None:
        """Send stops to a base that answers nothing, until it must have booted."""
        end_s = self.clock.now_s() + seconds
        while self.clock.now_s() < end_s:
            self._send(self.codec.ends_cut_frame + self.codec.stop)
            self._pause(min(_ASKED_EVERY_S, end_s - self.clock.now_s()))

    def _let_late_answers_pass(self) -> None:
        """Several tries may have been answered at once, after the boot. None of them shall pass for a later answer."""
        end_s = self.clock.now_s() + self.boot_wait_s  # something that is no base may talk for ever
        while self.clock.now_s() < end_s and any(True for _ in self._messages_for(_ANSWER_WITHIN_S)):
            pass

    def _is_awake(self) -> bool:
        """Check whether a base that has shown what it is will drive; wait for that while it is woken.

        It may have shown it by late reports from before, of a former connection too; what follows says that it does not
        drive, until it does. If it does not, what woke it was lost, and it must be woken again.
        """
        reports = self._messages_for(_ASKED_EVERY_S)
        while self.codec.trouble and next(reports, None) is not None:
            pass
        return not self.codec.trouble

    def _confirm(self, frame: bytes) -> None:
        for message in self._messages_for(_ANSWER_WITHIN_S):
            if message.was_done:
                return
            if message.was_done is False:
                raise ProtocolError(f"the base at {self.link.path} refuses to drive; {self.codec.refusal_hint}")
        raise DeviceOpenError(
            f"the base at {self.link.path} has answered, but does not acknowledge {frame!r}; "
            f"is it one of {self.codec.name}?"
        )

    def _messages_for(self, seconds: float) -> Iterator[BaseMessage]:
        end_s = self.clock.now_s() + seconds
        while self.clock.now_s() < end_s:
            self._pause(min(_READ_EVERY_S, end_s - self.clock.now_s()))
            yield from self.codec.feed(self.link.read())

    def _send(self, frame: bytes) -> None:
        self.codec.note_sent(frame)
        self.link.write(frame)

    def _pause(self, seconds: float) -> None:
        self.clock.sleep_until_s(self.clock.now_s() + seconds)

    def _no_answer_error(self) -> str:
        heard = self.codec.dropped_bytes
        what = f"only {heard} bytes without meaning came" if heard else "nothing answers"
        return (
            f"no {self.codec.name} at {self.link.path}: {what} in {self.boot_wait_s:g} s; {self.codec.hint}, "
            "and that this is the right port"
        )


LOST_AFTER_S = 0.5

# Bytes that are still in the port so long after they should have left at its baud rate wait for a line that is slower.
HELD_UP_AFTER_S = 0.1

# Reports that a base gives only when asked: often enough for a battery and for odometry beside a camera.
POLLED_EVERY_S = 0.2

# Some boards take every byte for a sign of life. So while wheels turn, a question only follows a command: else they
# would turn on while nobody commands them.
POLLED_AFTER_COMMAND_S = 0.1

# A line that is too slow has carried two frames by then, and nothing more feeds the time-out of the board.
CARRIED_AFTER_S = 1.2

# No base that this is for has more; a number beyond is damage on the line.
MAX_BATTERY_V = 100.0

MIN_BAUD = 2400
BITS_A_BYTE = 10
TOO_SLOW = "raise the baud rate, here and in the base, or mend the adapter or the radio link between them"

STANDING = WheelSpeeds(left_mps=0.0, right_mps=0.0)

_REPORTED = ("battery_v", "is_bumped", "is_at_cliff", "errors")


def _check_baud(baud: int) -> int:
    if baud < MIN_BAUD:
        raise ValueError(
            f"at {baud} baud a command is under way for too long, so that wheels stop late; "
            f"set the base to {MIN_BAUD} baud or more, and write that"
        )
    return baud


Baud = Annotated[int, AfterValidator(_check_baud)]


class SerialBaseOptions(DriverOptions):
    """The options of every base on a serial port."""

    auto_stop_advice: ClassVar[str]

    port: SerialPort
    """The serial port, best as ``/dev/serial/by-id/…``; or ``emulated-ros-arduino-bridge``, as in the demonstration."""
    baud: Baud = 115200
    """The speed of the line."""
    track_width: Length = Field(examples=["20 cm"])
    """Distance between the middles of the two driven wheels."""
    max_wheel_speed: Speed = 0.5
    """No wheel is asked to run faster."""
    swap_sides: bool = False
    """Whether the base's left motor drives the right wheel."""
    invert_left: bool = False
    """Whether the left wheel turns backwards when commanded forwards."""
    invert_right: bool = False
    """The same for the right wheel."""
    boot_wait: Duration = 4.0
    """How long the base, which opening the port may reset, may take until it answers."""

    @model_validator(mode="after")
    def _check_wheels_can_turn(self) -> Self:
        if self.max_wheel_speed <= 0:
            raise ValueError("max_wheel_speed is 0: a base whose wheels cannot turn goes nowhere")
        return self

    def codec(self) -> SerialCodec:
        """Return a new codec of the protocol."""
        raise NotImplementedError(f"{type(self).__name__} has no method `codec`")

    def stops_by_itself_after_s(self) -> float:
        """Return the time the base drives on when nothing comes, in seconds; infinity for a base that never stops."""
        raise NotImplementedError(f"{type(self).__name__} does not say whether its base stops by itself")

    def kinematics(self) -> DifferentialDrive:
        """Return the kinematics that these figures describe."""
        return DifferentialDrive(track_width_m=self.track_width, max_wheel_mps=self.max_wheel_speed)

    def build(self, context: DriverContext) -> SerialBase:
        """Return the base."""
        return SerialBase(self, context)

    def is_simulated(self) -> bool:
        """Check whether the port is an emulated one."""
        return self.port in driver_names(PORTS)

    def lacks(self) -> tuple[str, ...]:
        """List the things that keep the port from being opened."""
        return () if self.is_simulated() else port_lacks(self.port)

    def serial_stop(self) -> SerialStop | None:
        """Return a stop behind what ends a frame that the program may have begun."""
        if self.is_simulated():
            return None
        codec = self.codec()
        return SerialStop(port=self.port, baud=self.baud, frame=codec.ends_cut_frame + codec.stop)

    def to_motors(self, left: float, right: float) -> tuple[float, float]:
        """Return the motion of the base's left and right motor, as they are wired, for what the wheels shall do."""
        left, right = self._signed(left, right)
        return (right, left) if self.swap_sides else (left, right)

    def to_wheels(self, left: float, right: float) -> tuple[float, float]:
        """Return the motion of the left and right wheel, for what the base's motors do."""
        return self._signed(*((right, left) if self.swap_sides else (left, right)))

    def _signed(self, left: float, right: float) -> tuple[float, float]:
        return (-left if self.invert_left else left, -right if self.invert_right else right)


class DutyBaseOptions(SerialBaseOptions):
    """The options of a base whose commands have no unit, such as duties: what the highest does must be measured."""

    full_speed: Speed = Field(examples=["1 m/s"])
    """How fast a wheel rolls at the highest command. Keep the example until you have measured it."""

    @model_validator(mode="after")
    def _check_speed_is_reached(self) -> Self:
        if self.max_wheel_speed > self.full_speed:
            raise ValueError(
                f"max_wheel_speed {self.max_wheel_speed:g} m/s is above full_speed {self.full_speed:g} m/s, which the "
                "wheels cannot exceed: measure full_speed, or write a lower max_wheel_speed"
            )
        return self


class SerialBase:
    """A `MobileBase` over a serial port.

    Every command is one write, and nothing waits in a queue: a port that does not take a frame, or does not send it, is
    an error. A command that drives waits while one before it is on its way, since a line that is slower than commands
    come would have them obeyed late. The newest takes the place of one that waits, and a stop of any.
    """

    def __init__(self, options: SerialBaseOptions, context: DriverContext) -> None:
        self._options = options
        self._context = context
        self._clock = context.clock
        self._drive = options.kinematics()
        self._link: SerialLink | None
        self._waiting: WheelCommand | None
        self._begin(None, options.codec())

    def open(self) -> None:
        """Open the port, wait until the base answers, set its time-out and make it stand. Does nothing when open."""
        if self._link:
            return
        if self._awaited.must_be_quiet:  # so what it was sent last shall not be followed by more before it stands
            after_s = CARRIED_AFTER_S + self._options.stops_by_itself_after_s()
            self._clock.sleep_until_s(self._commanded_s + after_s)
        codec = self._options.codec()
        link = SerialLink(self._context.port_path(self._options.port), self._options.baud)
        link.open()
        try:
            Greeting(link=link, clock=self._clock, codec=codec, boot_wait_s=self._options.boot_wait).run()
        except LinkLostError as error:
            link.close()
            raise DeviceOpenError(f"the base vanished while it was greeted: {error}") from error
        except BaseException:
            link.close()
            raise
        self._begin(link, codec)

    def apply(self, command: TwistCommand) -> TwistCommand:
        """Move as commanded.

        The speeds returned are those that are sent, at once or as soon as the line is free: limited along the same
        curve, and rounded to what its protocol can say.

        Raises:
            LinkLostError: The port is gone, takes or sends no bytes, or answers are missing or late.
            ProtocolError: The base refused a command.
        """
        link = self._opened()
        now_s = self._clock.now_s()
        self._read(link, now_s)
        self._check_line(link, now_s)
        wheels = self._drive.wheels(Motion(linear_mps=command.linear_mps, angular_radps=command.angular_radps))
        left_mps, right_mps = self._options.to_motors(wheels.left_mps, wheels.right_mps)
        encoded = self._codec.encode(WheelSpeeds(left_mps=left_mps, right_mps=right_mps))
        is_stop = encoded.sent == STANDING
        is_first_stop = is_stop and self._sent != STANDING
        self._waiting = None if is_stop or self._awaited.must_be_quiet else encoded
        if not self._awaited.must_be_quiet and (is_first_stop or self._is_free(link, now_s)):
            self._send(link, encoded.frame, now_s, encoded.sent)
        said = STANDING if is_stop else self._waiting.sent if self._waiting else self._sent
        left_mps, right_mps = self._options.to_wheels(said.left_mps, said.right_mps)
        sent = self._drive.motion(WheelSpeeds(left_mps=left_mps, right_mps=right_mps))
        return replace(command, linear_mps=sent.linear_mps, angular_radps=sent.angular_radps, tilt_radps=0.0)

    def tick(self, now_s: float) -> None:
        """Read answers, send the command that waits, ask for reports, and send a stop where one may not have arrived.

        Stops are repeated also over a link that is lost.
        """
        link = self._opened()
        self._read(link, now_s)
        if self._awaited.stop_is_overdue(now_s):
            self._awaited.repeating()
            self._send(link, self._codec.stop, now_s)
        self._check_line(link, now_s)
        if self._waiting and not self._awaited.must_be_quiet and self._is_free(link, now_s):
            self._send(link, self._waiting.frame, now_s, self._waiting.sent)
        if self._sent == STANDING or now_s - self._commanded_s < POLLED_AFTER_COMMAND_S:
            self._poll(link, now_s)

    def report(self) -> BaseReport | None:
        """Return the last report of the base; None if it has reported nothing."""
        return self._report

    def stop(self) -> None:
        """Stand still at once. Does nothing when closed."""
        now_s = self._clock.now_s()
        self._waiting = None
        if self._link and not self._awaited.must_be_quiet:
            self._send(self._link, self._codec.stop, now_s)

    def close(self) -> None:
        """Stop, wait shortly until the stop has left the computer, and release the port, even if the stop fails."""
        link = self._link
        if not link:
            return
        try:
            self.stop()
            link.drain()
            for frame in self._codec.closing:
                link.write(frame)
                link.drain()
                self._clock.sleep_until_s(self._clock.now_s() + TAKES_EFFECT_S)
        finally:
            self._link = None
            link.close()

    def _begin(self, link: SerialLink | None, codec: SerialCodec) -> None:
        self._link = link
        self._codec = codec
        now_s = self._clock.now_s()
        self._awaited = Acknowledgements(any_byte_feeds=codec.any_byte_feeds)
        if codec.answers is not Answers.EACH_COMMAND:
            self._awaited = Unacknowledged(
                now_s, streams=codec.answers is Answers.STREAM, stop_repeats=codec.stop_repeats
            )
        self._polls = cycle(codec.polls)
        self._polled_s = -math.inf
        self._left_s = self._commanded_s = now_s
        self._sent = STANDING
        self._waiting = None
        self._frame_cut_short = False
        self._refusals_to_ignore = 0
        self._report: BaseReport | None = None
        self._start_m: tuple[float, float] | None = None
        self._speeds_s = now_s
        self._rolled_m = (0.0, 0.0)

    def _opened(self) -> SerialLink:
        if self._link is None:
            raise DeviceClosedError(f"the base '{self._context.name}' is not open")
        return self._link

    def _send(self, link: SerialLink, frame: bytes, now_s: float, says: WheelSpeeds = STANDING) -> None:
        """Send a command, noted first: a stop that fails is tried again.

        A stop follows nothing that the port holds back, unless what ends a cut frame is longer than that.
        """
        is_held_up = now_s > self._left_s and link.waiting() > len(self._codec.ends_cut_frame)
        if says == STANDING != self._sent and is_held_up:
            link.discard()
            self._frame_cut_short = True
        if self._frame_cut_short:
            self._left_s = now_s
            frame = self._after_a_cut(frame, now_s)
        self._awaited.sent(now_s, stop=says == STANDING)
        self._waiting = None
        self._commanded_s, self._sent = now_s, says
        self._write(link, frame)

    def _after_a_cut(self, frame: bytes, now_s: float) -> bytes:
        """Return the frame behind what ends the one before.

        The firmware may hold the beginning of a frame that the port took only in part. A stop appended to ``m 10``
        would make it spin. So that remainder is ended first: it is done or refused, and this frame follows at once.
        """
        if not self._codec.ends_cut_frame:
            return frame
        self._refusals_to_ignore += 1
        self._awaited.sent(now_s, stop=False)
        return self._codec.ends_cut_frame + frame

    def _write(self, link: SerialLink, frame: bytes) -> None:
        if self._codec.gap_s and self._clock.now_s() < self._left_s + self._codec.gap_s:
            self._clock.sleep_until_s(self._left_s + self._codec.gap_s)
        self._codec.note_sent(frame)
        self._frame_cut_short = True
        link.write(frame)
        self._frame_cut_short = False
        self._left_s = max(self._left_s, self._clock.now_s()) + len(frame) * BITS_A_BYTE / self._options.baud

    def _is_free(self, link: SerialLink, now_s: float) -> bool:
        """Check whether nothing that was sent is still on its way, as far as that shows here."""
        return self._awaited.is_free and now_s >= self._left_s and not link.waiting()

    def _poll(self, link: SerialLink, now_s: float) -> None:
        question = next(self._polls, b"") if now_s - self._polled_s >= POLLED_EVERY_S else b""
        if question and not self._frame_cut_short and self._is_free(link, now_s):
            self._polled_s = now_s
            self._write(link, question)

    def _read(self, link: SerialLink, now_s: float) -> None:
        for message in self._codec.feed(link.read()):
            self._awaited.heard(now_s)
            if message.was_done is not None:
                self._awaited.note_answer(is_done=message.was_done)
            if message.was_done is False:
                self._take_refusal(link)
            self._take_report(message, now_s)
        self._awaited.looked(now_s)
        if self._codec.trouble:
            raise ProtocolError(f"the base at {link.path} does not drive: {self._codec.trouble}")

    def _take_refusal(self, link: SerialLink) -> None:
        if not self._refusals_to_ignore:
            raise ProtocolError(
                f"the base at {link.path} refused a motor command; if it always does, {self._codec.refusal_hint}"
            )
        self._refusals_to_ignore -= 1

    def _take_report(self, message: BaseMessage, now_s: float) -> None:
        known = {name: value for name in _REPORTED if (value := getattr(message, name)) is not None}
        if not 0 <= known.get("battery_v", 0.0) <= MAX_BATTERY_V:
            del known["battery_v"]
        if rolled_m := self._rolled(message, now_s):
            known |= dict(zip(("left_m", "right_m"), self._options.to_wheels(*rolled_m), strict=True))
        if known:
            self._report = replace(self._report or BaseReport(at_s=now_s), at_s=now_s, **known)

    def _rolled(self, message: BaseMessage, now_s: float) -> tuple[float, float] | None:
        """Return the distances that the base's motors have rolled since it was opened, if the message is about that."""
        if message.left_m is not None and message.right_m is not None:
            start_left_m, start_right_m = self._start_m = self._start_m or (message.left_m, message.right_m)
            return (message.left_m - start_left_m, message.right_m - start_right_m)
        if message.left_mps is not None and message.right_mps is not None:
            seconds = now_s - self._speeds_s
            left_m, right_m = self._rolled_m
            self._speeds_s = now_s
            self._rolled_m = (left_m + message.left_mps * seconds, right_m + message.right_mps * seconds)
            return self._rolled_m
        return None

    def _check_line(self, link: SerialLink, now_s: float) -> None:
        if now_s - self._left_s > HELD_UP_AFTER_S and link.waiting():
            raise LinkLostError(f"the line at {link.path} is slower than its {self._options.baud} baud; {TOO_SLOW}")
        if self._awaited.is_late:
            raise LinkLostError(f"the base at {link.path} acknowledges commands too late; {TOO_SLOW}")
        if self._awaited.silent_s > LOST_AFTER_S:
            said = "acknowledged" if self._codec.answers is Answers.EACH_COMMAND else "reported"
            raise LinkLostError(
                f"the base at {link.path} has {said} nothing for {LOST_AFTER_S} s; check its cable and its power"
            )
