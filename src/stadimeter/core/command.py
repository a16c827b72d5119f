"""The commands that an actuator or a base receives, and what a base reports of itself."""

from __future__ import annotations

import math

from msgspec import Struct

from stadimeter.errors import CommandRangeError

# The commands that an actuator or a base receives. Commands are values: a wrong one cannot be made --------------------


class LevelCommand(Struct, frozen=True, kw_only=True, tag=True):
    """The strength with which an actuator shall act.

    Attributes:
        output: The name of the actuator.
        level: From 0, off, to 1, full.
        captured_at_s: When the frame was taken that justifies the command, on the run's monotonic clock. None for the
            safe level, which needs no justification and never grows stale.

    Raises:
        CommandRangeError: The level is not a number from 0 to 1, or the time is not finite.
    """

    output: str
    level: float
    captured_at_s: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.level <= 1.0:  # NaN fails this too
            raise CommandRangeError(f"{self.output}: level {self.level} is not between 0 and 1")
        _check_time(self.output, self.captured_at_s)


class TwistCommand(Struct, frozen=True, kw_only=True, tag=True):
    """The motion that a base shall make.

    Attributes:
        output: The name of the base.
        linear_mps: Speed forwards.
        angular_radps: Rate of turn, positive to the left.
        tilt_radps: How fast its camera tilts, positive upwards: the pitch of ROS REP 103 with the other sign. A base
            whose camera does not tilt applies 0.
        captured_at_s: When the frame was taken that justifies the command; None for standing still.

    Raises:
        CommandRangeError: A value is not finite, or the base would move without a frame that justifies it.
    """

    output: str
    linear_mps: float
    angular_radps: float
    tilt_radps: float = 0.0
    captured_at_s: float | None = None

    @property
    def moves(self) -> bool:
        """True if anything shall move."""
        return (self.linear_mps, self.angular_radps, self.tilt_radps) != (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        speeds = (self.linear_mps, self.angular_radps, self.tilt_radps)
        if not all(map(math.isfinite, speeds)):
            raise CommandRangeError(
                f"{self.output}: {speeds[0]} m/s, {speeds[1]} rad/s and a tilt of {speeds[2]} rad/s are not all finite"
            )
        if self.captured_at_s is None and self.moves:
            raise CommandRangeError(f"{self.output}: a base moves only on a frame, and this command names none")
        _check_time(self.output, self.captured_at_s)


Command = LevelCommand | TwistCommand


def _check_time(output: str, captured_at_s: float | None) -> None:
    if captured_at_s is not None and not math.isfinite(captured_at_s):
        raise CommandRangeError(f"{output}: capture time {captured_at_s} is not finite")


# The report of a robot base on itself ---------------------------------------------------------------------------------


class BaseReport(Struct, frozen=True, kw_only=True):
    """The last report of a base. None stands for what it does not have, or has not reported yet.

    Attributes:
        at_s: When it was received, on the run's monotonic clock.
        battery_v: Voltage of the battery.
        is_bumped: Whether a bumper is pressed.
        is_at_cliff: Whether a sensor below it sees no floor, or a wheel hangs down.
        left_m: How far the left wheel has rolled since the base was opened, less what it rolled back.
        right_m: The same of the right wheel.
        camera_tilt_rad: How far its camera is tilted up from level.
        errors: What the base says is wrong with it, in words.
    """

    at_s: float
    battery_v: float | None = None
    is_bumped: bool | None = None
    is_at_cliff: bool | None = None
    left_m: float | None = None
    right_m: float | None = None
    camera_tilt_rad: float | None = None
    errors: tuple[str, ...] = ()

    @property
    def why_not_drive(self) -> str:
        """The reason why the base may not drive, whatever rules want, in words; empty if it may."""
        bumped = ["its bumper is pressed"] if self.is_bumped else []
        at_cliff = ["there is no floor below it"] if self.is_at_cliff else []
        return "; ".join((*bumped, *at_cliff, *self.errors))
