"""Reads a range sensor beside the control loop: its newest echo is a measurement, and may keep the base from driving.

The control loop takes what is there and never waits. A sensor that does not answer is opened again and again; until
then its target is not seen, and a base that it watches over stands.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from stadimeter.config.models import SensorTable
from stadimeter.core.clock import Clock
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.errors import DriverError
from stadimeter.sensors.protocol import Echo, RangeSensor

# A sensor that failed is opened again this often.
OPEN_AGAIN_S = 2.0

# An echo that is older says nothing any more. The slowest sensor measures every 60 ms.
MAX_ECHO_AGE_S = 0.2

# The base drives on when what stopped it is further than the limit by this share of it, and this much: so that noise
# does not have it start and stop.
RELEASE_SHARE = 0.1
RELEASE_M = 0.02


class RangeReader:
    """One range sensor of a run.

    Args:
        table: Where it looks from the camera, and what it keeps the base from.
    """

    def __init__(self, name: str, sensor: RangeSensor, table: SensorTable, clock: Clock) -> None:
        self.name = name
        self._sensor = sensor
        self._table = table
        self._clock = clock
        self._echo: Echo | None = None
        self._taken_s = -math.inf
        self._trouble = "it has not measured yet"
        self._is_stopping = False
        self._open_again_s = math.inf
        self._cancel: Callable[[], None] = lambda: None

    def open(self) -> None:
        """Connect and begin to read; `DriverError` if the sensor cannot be opened."""
        self._sensor.open()
        self._start()

    def open_later(self, error: DriverError) -> bool:
        """Go on after `open` has raised, and try again; return that it does."""
        self._fail(error)
        self._start()
        return True

    def close(self) -> None:
        """Cease to read, and release the sensor."""
        self._cancel()
        self._sensor.close()

    def measurement(self) -> Measurement | None:
        """Return the newest echo as a measurement of the target of the sensor's name; None if there is no new one.

        The distance is from the camera: a sensor ``ahead`` of it sees everything that much nearer.
        """
        echo = self._echo
        if echo is None or self._trouble:
            return self._not_measured(MeasurementStatus.ERROR, self._trouble) if self._trouble else None
        if echo.at_s <= self._taken_s:
            return None
        self._taken_s = echo.at_s
        if math.isinf(echo.distance_m):
            return self._not_measured(MeasurementStatus.NOT_FOUND, "nothing is within its range")
        distance_m = echo.distance_m + self._table.ahead
        return Measurement(
            target=self.name,
            status=MeasurementStatus.MEASURED,
            captured_at_s=echo.at_s,
            distance_m=distance_m,
            depth_m=distance_m * math.cos(self._table.bearing),
            sigma_m=echo.sigma_m,
            noise_m=echo.sigma_m,
            bearing_rad=self._table.bearing,
            elevation_rad=0.0,
        )

    def why_not_drive(self) -> str:
        """Return why the base may not drive, in words; empty if it may, or the sensor does not watch over it."""
        limit_m = self._table.stop_below
        if limit_m is None:
            return ""
        echo, now_s = self._echo, self._clock.now_s()
        if self._trouble:
            return f"the sensor '{self.name}' cannot tell what is before it: {self._trouble}"
        if echo is None or not now_s - echo.at_s <= MAX_ECHO_AGE_S:
            return f"the sensor '{self.name}' has not measured for {MAX_ECHO_AGE_S:g} s"
        released_m = limit_m * (1 + RELEASE_SHARE) + RELEASE_M
        self._is_stopping = echo.distance_m < (released_m if self._is_stopping else limit_m)
        if not self._is_stopping:
            return ""
        return f"the sensor '{self.name}' sees something nearer than {limit_m:g} m (sensors.{self.name}.stop_below)"

    def _start(self) -> None:
        self._cancel = self._clock.call_every(self._sensor.period_s, self._read)

    def _read(self, now_s: float) -> None:
        try:
            if now_s >= self._open_again_s:
                self._sensor.close()
                self._sensor.open()
                self._open_again_s = math.inf
            if math.isinf(self._open_again_s):
                echo = self._sensor.read()
                if echo is not None:
                    self._echo, self._trouble = echo, ""
        except DriverError as error:
            self._fail(error)

    def _fail(self, error: DriverError) -> None:
        self._trouble = str(error)
        self._open_again_s = self._clock.now_s() + OPEN_AGAIN_S

    def _not_measured(self, status: MeasurementStatus, reason: str) -> Measurement:
        return Measurement(target=self.name, status=status, captured_at_s=self._clock.now_s(), reason=reason)
