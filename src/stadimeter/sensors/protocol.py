"""The interface of a range sensor."""

from __future__ import annotations

from typing import ClassVar, Protocol

from msgspec import Struct


class Echo(Struct, frozen=True, kw_only=True):
    """A single measurement of a range sensor.

    Attributes:
        at_s: When, on the run's monotonic clock.
        distance_m: From the sensor to what is nearest in its beam; infinite if nothing is within its range.
        sigma_m: Standard deviation of the distance.
    """

    at_s: float
    distance_m: float
    sigma_m: float


class RangeSensor(Protocol):
    """Something that measures how far away the nearest thing in its beam is.

    The constructor touches no hardware. A driver needs no lock: it is called from one thread at a time, apart from the
    control loop, which never waits for it. Three ultrasonic sensors that were read within a vision loop took it from 30
    to 5 pictures a second.

    Attributes:
        period_s: How often `read` is called.
    """

    period_s: ClassVar[float]

    def open(self) -> None:
        """Connect and begin to measure. Does nothing when open.

        Raises:
            DeviceOpenError: The device is absent or busy, or this user may not open it.
            DriverUnavailableError: A library that it needs is not installed.
        """

    def read(self) -> Echo | None:
        """Return the newest measurement; None before the first. May wait for as long as one takes, up to 0.1 s.

        Raises:
            LinkLostError: The sensor does not answer.
        """

    def close(self) -> None:
        """Release the device. May be called any number of times."""
