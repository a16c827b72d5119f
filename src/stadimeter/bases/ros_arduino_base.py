"""A robot base with an Arduino that runs ros_arduino_bridge, on a serial port.

**This base stops by itself 2 s after the last command, and that time cannot be set over the wire.** A robot at
0.5 m/s rolls on for a metre if this computer dies. To shorten it, change ``AUTO_STOP_INTERVAL`` in the sketch.

The firmware takes the left wheel first. Its own Python driver sends the right one first, so a robot that was wired to
suit that driver turns the wrong way here: set ``swap_sides``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Self

from pydantic import PositiveInt, model_validator

from stadimeter.bases import ros_arduino_codec as codec
from stadimeter.bases.differential_drive import DifferentialDrive, Motion, WheelTicks
from stadimeter.bases.serial_link import SerialLink, port_lacks
from stadimeter.config.plugins import PORTS, DriverContext, DriverOptions, SerialStop, driver_names
from stadimeter.config.units import Duration, Length, SerialPort, Speed
from stadimeter.core.clock import Clock
from stadimeter.core.command import TwistCommand
from stadimeter.errors import DeviceClosedError, DeviceOpenError, LinkLostError, ProtocolError

_ASKED_EVERY_S = 0.2
_READ_EVERY_S = 0.02
_ANSWER_WITHIN_S = 0.5

BASE_IS_OFF = (
    "its sketch was built without the base controller: enable '#define USE_BASE' in ROSArduinoBridge.ino, choose the "
    "motor driver and load it again"
)


@dataclass(slots=True, kw_only=True)
class Handshake:
    """The first exchange with a base, over a link that was just opened; the base may still be booting."""

    link: SerialLink
    clock: Clock
    boot_wait_s: float
    _parser: codec.ReplyParser = field(default_factory=codec.ReplyParser)

    def run(self) -> None:
        """Wait until the base answers, stop it, and set its encoders to zero.

        Each try begins with an end of line and a stop. A base that drove when an earlier program died shall not drive
        on while we ask, and half a command of that program shall not swallow our stop.
        """
        tries = self._identify()
        if tries > 1:
            self._let_late_answers_pass()
        self._confirm(codec.RESET_ENCODERS)
        self._confirm(codec.STOP)

    def _identify(self) -> int:
        """Ask until the base tells its baud rate, and return how often it was asked."""
        deadline_s = self.clock.now_s() + self.boot_wait_s
        for tries in itertools.count(1):
            self.link.write(codec.END + codec.STOP)
            self.link.write(codec.ASK_BAUD_RATE)
            if any(isinstance(reply, codec.BaudRate) for reply in self._replies_for(_ASKED_EVERY_S)):
                return tries
            if self.clock.now_s() >= deadline_s:
                break
        raise DeviceOpenError(self._no_answer_error())

    def _let_late_answers_pass(self) -> None:
        """Several tries may have been answered at once, after the boot. None of them shall pass for a later answer."""
        end_s = self.clock.now_s() + self.boot_wait_s  # something that is no base may talk for ever
        while self.clock.now_s() < end_s and any(True for _ in self._replies_for(_ANSWER_WITHIN_S)):
            pass

    def _confirm(self, frame: bytes) -> None:
        self.link.write(frame)
        for reply in self._replies_for(_ANSWER_WITHIN_S):
            if isinstance(reply, codec.Acknowledged):
                return
            if isinstance(reply, codec.Refused):
                raise ProtocolError(f"the base at {self.link.path} refuses to drive; {BASE_IS_OFF}")
        raise DeviceOpenError(
            f"the base at {self.link.path} has answered with its baud rate, but does not acknowledge {frame!r}; "
            "is its sketch the one of ros_arduino_bridge?"
        )

    def _replies_for(self, seconds: float) -> Iterator[codec.Reply]:
        end_s = self.clock.now_s() + seconds
        while self.clock.now_s() < end_s:
            self.clock.sleep_until_s(min(end_s, self.clock.now_s() + _READ_EVERY_S))
            yield from self._parser.feed(self.link.read())

    def _no_answer_error(self) -> str:
        heard = self._parser.dropped_bytes
        what = f"only {heard} bytes without meaning came" if heard else "nothing answers"
        return (
            f"no ros_arduino_bridge at {self.link.path}: {what} in {self.boot_wait_s:g} s; check that its sketch is "
            "loaded, that the baud rate is the sketch's, and that this is the right port"
        )


STOP_REPEATED_AFTER_S = 0.1

# The time between two looks at the line counts as silence up to this.
LOOK_S = 0.05


class Acknowledgements:
    """Counts commands and their answers on a line where each command gets one, in order.

    A lost answer must not count as a lost link for ever. Therefore silence is counted from the first command that was
    sent after the last answer, not from the oldest one that was never answered.

    Silence is time in which the line was read. When this process waits for a processor, the clock goes on and nothing
    is read; and a command may leave the computer long after its time was noted. So silence adds up from look to look,
    and a gap between two looks counts for `LOOK_S` at most: ten looks in a row must have found nothing.
    """

    def __init__(self) -> None:
        self._unanswered = 0
        self._silent_s: float | None = None
        self._looked_s = 0.0
        self._stop_sent_s: float | None = None

    def sent(self, now_s: float, *, stop: bool) -> None:
        """Note that a command was sent. Any other command takes an earlier stop back."""
        self._unanswered += 1
        self._stop_sent_s = now_s if stop else None
        if self._silent_s is None:
            self._silent_s, self._looked_s = 0.0, now_s

    def looked(self, now_s: float) -> None:
        """Note that everything which had arrived at that time was read."""
        if self._silent_s is not None:
            self._silent_s += min(max(0.0, now_s - self._looked_s), LOOK_S)
            self._looked_s = now_s

    def repeating(self) -> None:
        """Note that a command is about to be repeated, so the answers that are still missing will not come."""
        self._unanswered = 0

    def acknowledged(self) -> None:
        """Note that a command was done. With the last one that is waited for, a stop is known to have arrived."""
        self._note_answer()
        if not self._unanswered:
            self._stop_sent_s = None

    def refused(self) -> None:
        """Note that a command was answered, but not done: a stop must be repeated."""
        self._note_answer()

    def stop_is_overdue(self, now_s: float) -> bool:
        """Return whether a stop was sent at least `STOP_REPEATED_AFTER_S` ago and is not acknowledged."""
        return self._stop_sent_s is not None and now_s - self._stop_sent_s >= STOP_REPEATED_AFTER_S

    @property
    def silent_s(self) -> float:
        """For how long commands have been sent and the line was read without any answer; 0 if none is waited for."""
        return self._silent_s or 0.0

    def _note_answer(self) -> None:
        self._unanswered = max(0, self._unanswered - 1)
        self._silent_s = None


LOST_AFTER_S = 0.5


class RosArduinoOptions(DriverOptions):
    """The table of such a base in the configuration."""

    port: SerialPort
    """The serial port, best as ``/dev/serial/by-id/…``; or ``emulated-ros-arduino-bridge``."""
    baud: PositiveInt = 57600
    """``BAUDRATE`` of the sketch."""
    wheel_diameter: Length
    """Diameter of the driven wheels."""
    ticks_per_turn: PositiveInt
    """Encoder ticks while a wheel turns once, all edges and the gear counted."""
    track_width: Length
    """Distance between the middles of the two driven wheels."""
    max_wheel_speed: Speed = 0.5
    """No wheel is asked to run faster."""
    swap_sides: bool = False
    """Whether the firmware's left motor drives the right wheel."""
    invert_left: bool = False
    """Whether the left wheel turns backwards when told to turn forwards."""
    invert_right: bool = False
    """The same for the right wheel."""
    boot_wait: Duration = 4.0
    """How long the Arduino, which opening the port resets, may take until it answers."""

    @model_validator(mode="after")
    def _check_speeds_fit_the_firmware(self) -> Self:
        drive = self.drive()
        if not 1 <= drive.max_ticks <= codec.MAX_TICKS_PER_FRAME:
            raise ValueError(
                f"max_wheel_speed of {self.max_wheel_speed:g} m/s is {self.max_wheel_speed / drive.tick_mps:.3g} "
                f"encoder ticks in {codec.FRAME_S * 1e3:.0f} ms; the firmware takes 1 to {codec.MAX_TICKS_PER_FRAME}: "
                "check it together with wheel_diameter and ticks_per_turn"
            )
        return self

    def drive(self) -> DifferentialDrive:
        """Return the kinematics that these figures describe."""
        return DifferentialDrive(
            track_width_m=self.track_width,
            ticks_per_metre=self.ticks_per_turn / (math.pi * self.wheel_diameter),
            max_wheel_mps=self.max_wheel_speed,
            frame_s=codec.FRAME_S,
        )

    def build(self, context: DriverContext) -> RosArduinoBase:
        """Return the base."""
        return RosArduinoBase(self, context)

    def is_simulated(self) -> bool:
        """Return whether the port is an emulated one."""
        return self.port in driver_names(PORTS)

    def lacks(self) -> tuple[str, ...]:
        """Return what keeps the port from being opened."""
        return () if self.is_simulated() else port_lacks(self.port)

    def serial_stop(self) -> SerialStop | None:
        """Return a stop behind an end of line, which ends a command that the program may have begun."""
        if self.is_simulated():
            return None
        return SerialStop(port=self.port, baud=self.baud, frame=codec.END + codec.STOP)


class RosArduinoBase:
    """A `MobileBase` over the serial protocol of ros_arduino_bridge.

    Every command is one write, and nothing waits in a queue of ours: a port that does not take a frame is an error.
    """

    def __init__(self, options: RosArduinoOptions, context: DriverContext) -> None:
        self._options = options
        self._context = context
        self._clock = context.clock
        self._drive = options.drive()
        self._link: SerialLink | None = None
        self._parser = codec.ReplyParser()
        self._awaited = Acknowledgements()
        self._frame_cut_short = False
        self._refusals_to_ignore = 0

    def open(self) -> None:
        """Open the port, wait until the base answers, and make it stand. Does nothing when open."""
        if self._link:
            return
        link = SerialLink(self._context.port_path(self._options.port), self._options.baud)
        link.open()
        try:
            Handshake(link=link, clock=self._clock, boot_wait_s=self._options.boot_wait).run()
        except LinkLostError as error:
            link.close()
            raise DeviceOpenError(f"the base vanished while it was greeted: {error}") from error
        except BaseException:
            link.close()
            raise
        self._begin(link)

    def apply(self, command: TwistCommand) -> TwistCommand:
        """Move as commanded.

        The speeds returned are those sent: limited along the same curve, and rounded to whole encoder ticks.

        Raises:
            LinkLostError: The port is gone, takes no bytes, or nothing was answered for `LOST_AFTER_S`.
            ProtocolError: The base refused a command.
        """
        link = self._opened()
        now_s = self._clock.now_s()
        self._read_replies(link, now_s)
        self._check_silence(link)
        ticks = self._drive.ticks(Motion(linear_mps=command.linear_mps, angular_radps=command.angular_radps))
        self._send(link, codec.encode_drive(*self._arguments(ticks)), now_s)
        sent = self._drive.motion(ticks)
        return replace(command, linear_mps=sent.linear_mps, angular_radps=sent.angular_radps)

    def tick(self, now_s: float) -> None:
        """Read answers, and repeat a stop that was not acknowledged, also while the link counts as lost."""
        link = self._opened()
        self._read_replies(link, now_s)
        if self._awaited.stop_is_overdue(now_s):
            self._awaited.repeating()
            self._send(link, codec.STOP, now_s)
        self._check_silence(link)

    def stop(self) -> None:
        """Stand still at once. Does nothing when closed."""
        if self._link:
            self._send(self._link, codec.STOP, self._clock.now_s())

    def close(self) -> None:
        """Stop, wait shortly until the stop has left the computer, and release the port, even if the stop fails."""
        link = self._link
        if not link:
            return
        try:
            self.stop()
            link.drain()
        finally:
            self._link = None
            link.close()

    def _begin(self, link: SerialLink) -> None:
        self._link = link
        self._parser = codec.ReplyParser()
        self._awaited = Acknowledgements()
        self._frame_cut_short = False
        self._refusals_to_ignore = 0

    def _opened(self) -> SerialLink:
        if self._link is None:
            raise DeviceClosedError(f"the base '{self._context.name}' is not open")
        return self._link

    def _arguments(self, ticks: WheelTicks) -> tuple[int, int]:
        """Return the firmware's first and second argument, as the motors are wired."""
        left = -ticks.left if self._options.invert_left else ticks.left
        right = -ticks.right if self._options.invert_right else ticks.right
        return (right, left) if self._options.swap_sides else (left, right)

    def _send(self, link: SerialLink, frame: bytes, now_s: float) -> None:
        if self._frame_cut_short:
            frame = self._after_a_cut(frame, now_s)
        self._awaited.sent(now_s, stop=frame.endswith(codec.STOP))  # noted first: a stop that fails is tried again
        self._frame_cut_short = True
        link.write(frame)
        self._frame_cut_short = False

    def _after_a_cut(self, frame: bytes, now_s: float) -> bytes:
        """Return the frame behind an end of line.

        The firmware may hold the beginning of a frame that the port took only in part. A stop appended to ``m 10``
        would make it spin. So that remainder is ended first: it is done or refused, and this frame follows at once.
        """
        self._refusals_to_ignore += 1
        self._awaited.sent(now_s, stop=False)
        return codec.END + frame

    def _read_replies(self, link: SerialLink, now_s: float) -> None:
        for reply in self._parser.feed(link.read()):
            if isinstance(reply, codec.Acknowledged):
                self._awaited.acknowledged()
            elif isinstance(reply, codec.Refused):
                self._take_refusal(link)
        self._awaited.looked(now_s)

    def _take_refusal(self, link: SerialLink) -> None:
        self._awaited.refused()
        if self._refusals_to_ignore:
            self._refusals_to_ignore -= 1
            return
        raise ProtocolError(f"the base at {link.path} refused a motor command; if it always does, {BASE_IS_OFF}")

    def _check_silence(self, link: SerialLink) -> None:
        if self._awaited.silent_s > LOST_AFTER_S:
            raise LinkLostError(
                f"the base at {link.path} has acknowledged nothing for {LOST_AFTER_S} s; check its cable and its power"
            )
