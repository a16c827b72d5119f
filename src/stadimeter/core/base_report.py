"""The report of a robot base on itself."""

from __future__ import annotations

from msgspec import Struct


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
