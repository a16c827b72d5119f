"""The interface of a robot base."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from msgspec import Struct

from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.core.measurement import Track


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


class WiresMotors(Protocol):
    """An emulated port behind which motors turn the wheels of the simulated robot."""

    def wire(self, left: Sequence[MotorOutputs], right: Sequence[MotorOutputs], enable: int | None = None) -> None:
        """Connect the motors of each side, and an output that must be high for any of them to run."""
        ...
