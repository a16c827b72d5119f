"""The interfaces of an actuator and of a push button: what hangs on pins."""

from __future__ import annotations

from typing import Protocol

from stadimeter.core.command import LevelCommand


class Actuator(Protocol):
    """Something that acts with a level from 0 to 1: a vibration motor, a buzzer, a lamp.

    The constructor touches no hardware: `open` does, and leaves the device off. A driver needs no thread, no lock and
    no timer: the app calls it from one thread at a time, calls `tick` every 20 ms, and puts the actuator in its safe
    state when the frame behind the newest command is older than the lease.
    """

    def open(self) -> None:
        """Acquire the device, switched off.

        Raises:
            DeviceOpenError: It is absent, busy, or this user may not open it.
        """

    def apply(self, command: LevelCommand) -> LevelCommand:
        """Act as commanded. The same command may come any number of times; it then changes nothing.

        Returns:
            What was really applied: the level may have been rounded to what the device can do.

        Raises:
            DriverError: The device failed.
        """

    def tick(self, now_s: float) -> None:
        """Move patterns on: a beep's next edge, the end of a motor's kick. Called about every 20 ms.

        Raises:
            DriverError: The device failed.
        """

    def stop(self) -> None:
        """Switch off at once. Does nothing when closed.

        Raises:
            DriverError: The device failed.
        """

    def close(self) -> None:
        """Stop, then release the device. May be called any number of times.

        Raises:
            DriverError: The device failed; it is released all the same.
        """


class Button(Protocol):
    """Something that a person presses.

    The constructor touches no hardware. A driver needs no thread and no debouncing: the app reads it every 20 ms.
    """

    def open(self) -> None:
        """Acquire the device. Does nothing when open.

        Raises:
            DeviceOpenError: It is absent, busy, or this user may not open it.
        """

    def is_pressed(self) -> bool:
        """Check whether it is down now; contacts may bounce. Never waits.

        Raises:
            DriverError: The device failed.
        """

    def close(self) -> None:
        """Release the device. May be called any number of times.

        Raises:
            DriverError: The device failed; it is released all the same.
        """
