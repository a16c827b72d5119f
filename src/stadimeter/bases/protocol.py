"""The interface of a robot base, what its answers say of its link and its last stop, and how two wheels drive it."""

from __future__ import annotations

import math
from typing import Annotated, Protocol

from msgspec import Struct
from pydantic import AfterValidator

from stadimeter.config.units import Duration
from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.core.measurement import Track

# The answers of a base so far, and what they say of the link to it and of the last stop -------------------------------

STOP_REPEATED_AFTER_S = 0.1

# A board answers within milliseconds, an adapter or a radio adds up to some tens. After this much a command is doubted,
# and a stop goes out behind it.
DOUBTED_AFTER_S = 0.15

# What is answered later than this tells of a line that is too slow; what is not answered by then, while something else
# was, is lost. Longer than a stop may take where commands take no longer than `DOUBTED_AFTER_S`, so that no answer that
# is still under way counts as lost: else commands would queue up.
LATE_AFTER_S = 0.25

# The time between two looks at the line counts as silence up to this.
LOOK_S = 0.05


class Acknowledgements:
    """Counts commands and their answers on a line where each command gets one, in order.

    At most one command that drives is under way (`is_free`): more would queue up in an adapter or a radio that is
    slower than they come, and be obeyed late. A command that is not answered in time is followed by a stop, and none
    follows until it is known what became of both.

    Silence is time in which the line was read. When this process waits for a processor, the clock goes on and nothing
    is read; and a command may leave the computer long after its time was noted. So silence adds up from look to look,
    and a gap between two looks counts for `LOOK_S` at most.

    Args:
        any_byte_feeds: Whether every byte keeps the board from stopping by itself. Then nothing is sent behind two
            frames that are not answered: on a line that spoils or delays them, more would keep its wheels turning.

    Attributes:
        is_late: Whether the last answer came so late that the line does not carry what is sent.
    """

    def __init__(self, *, any_byte_feeds: bool = False) -> None:
        self.is_late = False
        self._any_byte_feeds = any_byte_feeds
        self._unanswered = 0
        self._is_stop = self._was_heard = False
        self._sent_s = self._looked_s = 0.0
        self._silent_s: float | None = None
        self._quiet_s = 0.0  # since the last command or answer

    def sent(self, now_s: float, *, stop: bool) -> None:
        """Note that a command was sent. Any other command takes an earlier stop back."""
        self._unanswered += 1
        self._is_stop, self._was_heard = stop, False
        self._sent_s, self._quiet_s = now_s, 0.0
        if self._silent_s is None:
            self._silent_s, self._looked_s = 0.0, now_s

    def looked(self, now_s: float) -> None:
        """Note that everything which had arrived at that time was read."""
        if self._silent_s is not None:
            silent_s = min(max(0.0, now_s - self._looked_s), LOOK_S)
            self._silent_s += silent_s
            self._quiet_s += silent_s
            self._looked_s = now_s

    def repeating(self) -> None:
        """Note that a stop is about to be repeated. If answers came, those that are still missing will not come."""
        if self._was_heard:
            self._unanswered, self._silent_s = 0, None

    def note_answer(self, *, is_done: bool) -> None:
        """Note an answer. If all was answered, and the last command done, a stop has arrived; else it is repeated."""
        self.is_late = self.silent_s > LATE_AFTER_S
        self._quiet_s = 0.0
        if self._unanswered == 1 and self._is_stop and not is_done:
            return
        self._was_heard = True
        self._unanswered = max(0, self._unanswered - 1)
        if not self._unanswered:
            self._silent_s = None

    def heard(self, now_s: float) -> None:
        """Note that the base said something that is no answer: it takes no command for done."""

    def stop_is_overdue(self, now_s: float) -> bool:
        """Check whether a stop shall be sent: one is not acknowledged, or a command is not answered in time."""
        if not self._unanswered or self.must_be_quiet:
            return False
        if not self._is_stop:
            return self._quiet_s >= DOUBTED_AFTER_S
        if self._was_heard:
            return self._quiet_s >= LATE_AFTER_S
        return now_s - self._sent_s >= STOP_REPEATED_AFTER_S

    @property
    def is_free(self) -> bool:
        """True if a command that drives may be sent: all before it were answered."""
        return not self._unanswered

    @property
    def must_be_quiet(self) -> bool:
        """True if nothing shall be sent, so that the board stops by itself."""
        return self._any_byte_feeds and self._unanswered > 1

    @property
    def silent_s(self) -> float:
        """Time for which the line has been silent although something should have come, or not all was answered."""
        return self._silent_s or 0.0


class Unacknowledged(Acknowledgements):
    """The same for a base that acknowledges nothing.

    Nothing tells whether a stop arrived, so each is sent several times; nor whether a command did, so the line is free.

    Args:
        streams: Whether the base sends something all the time, so that silence is a lost link. Else it never is one.
        stop_repeats: How often a stop is sent.
    """

    def __init__(self, now_s: float, *, streams: bool, stop_repeats: float) -> None:
        super().__init__()
        self._streams = streams
        self._stop_repeats = self._stops_left = stop_repeats
        self._is_repeating = False
        self._sent_s = math.inf
        self.heard(now_s)

    def sent(self, now_s: float, *, stop: bool) -> None:
        """Note that a command was sent. Any other command takes an earlier stop back."""
        self._stops_left = (self._stops_left if self._is_repeating else self._stop_repeats) - 1
        self._is_repeating = False
        self._sent_s = now_s if stop and self._stops_left > 0 else math.inf

    def repeating(self) -> None:
        """Note that a stop is about to be repeated."""
        self._is_repeating = True

    def heard(self, now_s: float) -> None:
        """Note that the base said something."""
        if self._streams:
            self._silent_s, self._looked_s = 0.0, now_s

    def stop_is_overdue(self, now_s: float) -> bool:
        """Check whether a stop shall be sent once more."""
        return now_s - self._sent_s >= STOP_REPEATED_AFTER_S


# The interface of a robot base ----------------------------------------------------------------------------------------


class MobileBase(Protocol):
    """Something that drives.

    The constructor touches no hardware: `open` does, and leaves the base standing. Speeds are in m/s and rad/s; the
    driver knows wheels, encoders and which side comes first. A driver needs no thread and no lock: the app calls it
    from one thread at a time, calls `tick` every 20 ms, and stops the base when the frame behind the newest command is
    older than the lease. Bases differ in whether they stop by themselves when nothing comes; a driver's documentation
    says so.
    """

    def open(self) -> None:
        """Connect, wait until the base answers, and stop it.

        Raises:
            DeviceOpenError: The port is absent or busy, this user may not open it, or nothing answers.
            ProtocolError: The base answers, but will not drive.
        """

    def apply(self, command: TwistCommand) -> TwistCommand:
        """Move as commanded. Sent on each time, even if nothing changed: the base's own timeout wants feeding.

        Returns:
            What was really sent: speeds may have been limited or rounded to what the base can do.

        Raises:
            LinkLostError: The base no longer answers.
            ProtocolError: The base refused the command.
        """

    def tick(self, now_s: float) -> None:
        """Read what the base has sent, and repeat a stop that was not acknowledged. Called about every 20 ms.

        Raises:
            LinkLostError: The base no longer answers.
            ProtocolError: The base refused a command.
        """

    def report(self) -> BaseReport | None:
        """Return the last report of the base, as read by `tick` or `apply`; None if it reports nothing. Never waits."""

    def stop(self) -> None:
        """Stand still at once. Does nothing when closed.

        Raises:
            LinkLostError: The stop could not be sent.
        """

    def close(self) -> None:
        """Stop, then release the port. May be called any number of times.

        Raises:
            LinkLostError: The stop could not be sent; the port is released all the same.
        """


class ShowsTargets(Protocol):
    """A base whose other side wants to know where targets are, such as a robot that runs ROS 2."""

    def show_target(self, track: Track) -> None:
        """Pass on a target that the newest frame has shown.

        Raises:
            LinkLostError: The base no longer answers.
        """


class MotorOutputs(Struct, frozen=True, kw_only=True):
    """The wiring of a motor driver (H-bridge) for one motor: to pins by their BCM number, or to channels of a chip.

    With two inputs, one for each direction, both high brake and both low coast. With `pwm` beside them they only
    choose the direction. With one input for the direction, the board decides what standing still is.

    Attributes:
        forward: High drives forwards; where there is no `backward`, low drives backwards.
        backward: High drives backwards.
        pwm: How strongly; None where the inputs themselves are pulsed.
    """

    forward: int
    backward: int | None = None
    pwm: int | None = None


# Kinematics of a robot with a driven wheel on each side. Pure functions of numbers ------------------------------------
#
# With speed v, rate of turn ω (positive to the left) and track width b, the wheels run at v ∓ ω·b/2, left and
# right. Source: the standard model of a differential drive, e.g. Siegwart and Nourbakhsh, Introduction to
# Autonomous Mobile Robots, section 3.2.


class Motion(Struct, frozen=True, kw_only=True):
    """The robot's speed forwards, and its rate of turn, positive to the left."""

    linear_mps: float
    angular_radps: float


class WheelSpeeds(Struct, frozen=True, kw_only=True):
    """The speeds at which both wheels roll, positive forwards."""

    left_mps: float
    right_mps: float


class DifferentialDrive(Struct, frozen=True, kw_only=True):
    """A robot's wheels.

    Attributes:
        track_width_m: Distance between the middles of the two wheels.
        max_wheel_mps: No wheel rolls faster.
    """

    track_width_m: float
    max_wheel_mps: float

    def wheels(self, motion: Motion) -> WheelSpeeds:
        """Return the wheel speeds for a motion.

        If a wheel would be too fast, both are slowed in the same proportion, so the robot keeps to its curve and
        drives along it more slowly.
        """
        offset_mps = motion.angular_radps * self.track_width_m / 2
        left_mps, right_mps = motion.linear_mps - offset_mps, motion.linear_mps + offset_mps
        fastest_mps = max(abs(left_mps), abs(right_mps))
        scale = self.max_wheel_mps / fastest_mps if fastest_mps > self.max_wheel_mps else 1.0
        return WheelSpeeds(left_mps=left_mps * scale, right_mps=right_mps * scale)

    def motion(self, wheels: WheelSpeeds) -> Motion:
        """Return the motion that wheel speeds make."""
        return Motion(
            linear_mps=(wheels.left_mps + wheels.right_mps) / 2,
            angular_radps=(wheels.right_mps - wheels.left_mps) / self.track_width_m,
        )


# The whole numbers that bases count: steps of speed, encoder counts that wrap around, and units of their time-out -----

# In these a RoboClaw and a Sabertooth count their serial time-out, which 0 would switch off.
TIMEOUT_UNIT_S = 0.1
# A robot at 0.5 m/s rolls 25 cm in this time.
MAX_TIMEOUT_S = 0.5


def _check_timeout(timeout_s: float) -> float:
    units = timeout_s / TIMEOUT_UNIT_S
    if not 1 <= round(units) <= round(MAX_TIMEOUT_S / TIMEOUT_UNIT_S) or abs(units - round(units)) > 1e-6:
        raise ValueError(
            f"{timeout_s * 1e3:g} ms: the board counts its time-out in {TIMEOUT_UNIT_S * 1e3:.0f} ms, and a robot "
            f"without commands shall stop within {MAX_TIMEOUT_S * 1e3:.0f} ms; write '100 ms', '200 ms' … '500 ms'"
        )
    return timeout_s


SerialTimeout = Annotated[Duration, AfterValidator(_check_timeout)]


class SpeedSteps(Struct, frozen=True, kw_only=True):
    """The speeds that a base can be given: whole multiples of one step."""

    step_mps: float

    def limit_mps(self, max_wheel_mps: float) -> float:
        """Return the highest speed that can be given and is within a limit."""
        return math.floor(max_wheel_mps / self.step_mps + 1e-9) * self.step_mps  # a limit of exactly n steps gives n

    def count(self, wheels: WheelSpeeds) -> tuple[int, int]:
        """Return the nearest numbers of steps for the left and the right wheel."""
        return round(wheels.left_mps / self.step_mps), round(wheels.right_mps / self.step_mps)

    def speeds(self, left: int, right: int) -> WheelSpeeds:
        """Return the wheel speeds that two numbers of steps stand for."""
        return WheelSpeeds(left_mps=left * self.step_mps, right_mps=right * self.step_mps)


class EncoderCounter:
    """The distance a wheel has rolled, from a counter that wraps around: less than half its range between two readings.

    Args:
        bits: The width of the counter.
        count_m: How far the wheel rolls in one count.
    """

    def __init__(self, *, bits: int, count_m: float) -> None:
        self._range = 1 << bits
        self._count_m = count_m
        self._counts: int | None = None

    def travel_m(self, reading: int) -> float:
        """Return the distance that the wheel has rolled in all, backwards negative, after a reading of the counter."""
        last = reading if self._counts is None else self._counts
        half = self._range // 2
        self._counts = last + (reading - last + half) % self._range - half
        return self._counts * self._count_m
