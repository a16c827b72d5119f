"""The parts that every base on a serial port has in common: its options, and the driver around its codec.

A base is one file with two classes: its options, derived from `SerialBaseOptions`, and its protocol, a
`stadimeter.bases.serial_codec.SerialCodec`. Opening the port, waiting for the base, limits, signs and order of the
wheels, silence, stops that must be repeated, frames that were sent in part, and the way out are here.
"""

from __future__ import annotations

import math
from itertools import cycle
from typing import Annotated, ClassVar, Self

from msgspec.structs import replace
from pydantic import AfterValidator, Field, model_validator

from stadimeter.bases.differential_drive import DifferentialDrive, Motion, WheelSpeeds
from stadimeter.bases.protocol import Acknowledgements, Unacknowledged
from stadimeter.bases.serial_codec import Answers, BaseMessage, SerialCodec, WheelCommand
from stadimeter.bases.serial_link import TAKES_EFFECT_S, Greeting, SerialLink, port_lacks
from stadimeter.config.plugins import PORTS, DriverContext, DriverOptions, SerialStop, driver_names
from stadimeter.config.units import Duration, Length, SerialPort, Speed
from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.errors import DeviceClosedError, DeviceOpenError, LinkLostError, ProtocolError

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
    """The serial port, best as ``/dev/serial/by-id/…``; or an emulated one: ``emulated-`` and the driver's name."""
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
    """How fast a wheel rolls at the highest command: measure it."""

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
            self._awaited = Unacknowledged(now_s, streams=codec.answers is Answers.STREAM, stops=codec.stops)
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
