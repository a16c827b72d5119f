"""The contract of every range sensor: subclass it with a fixture ``make_rig``, as `stadimeter.testing.rig` shows."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import pytest

from stadimeter.errors import DeviceClosedError, DriverError, LinkLostError
from stadimeter.sensors.protocol import Echo, RangeSensor
from stadimeter.testing.rig import Contract, Rig

ABSENT, SILENT = SENSOR_FAULTS = ("absent", "silent")

NEAR_M, FAR_M = 0.5, 1.5


class SensorRig(Rig[RangeSensor], frozen=True, kw_only=True):
    """A range sensor with something before it.

    Its faults are `ABSENT` (it cannot be opened) and `SILENT` (it no longer answers).

    Attributes:
        place: Puts something at a distance in metres before the sensor; infinite for nothing.
        pass_time: Lets the sensor measure again: steps its clock, or waits a moment where it runs by itself.
        now_s: Returns the time of the clock that the driver was given.
    """

    place: Callable[[float], None]
    pass_time: Callable[[], None]
    now_s: Callable[[], float]

    def read(self) -> Echo | None:
        """Let a moment pass, and read."""
        self.pass_time()
        return self.device.read()

    def first(self) -> Echo:
        """Wait for a measurement and return it."""
        echo = self.eventually(self.read)
        assert echo is not None
        return echo

    def sees(self, distance_m: float) -> bool:
        """Check whether the newest echo agrees with a distance within three standard deviations."""
        echo = self.read()
        if echo is None or math.isinf(distance_m) or math.isinf(echo.distance_m):
            return echo is not None and echo.distance_m == distance_m
        return abs(echo.distance_m - distance_m) <= 3 * echo.sigma_m


class SensorContract(Contract):
    """The tests. The sensor must be able to see something at 0.5 m and at 1.5 m."""

    def test_it_measures_what_is_before_it(self, opened: SensorRig) -> None:
        for distance_m in (NEAR_M, FAR_M, NEAR_M):
            opened.place(distance_m)
            opened.eventually(partial(opened.sees, distance_m))
        assert 0 < opened.first().sigma_m < NEAR_M

    def test_what_is_not_there_is_infinitely_far(self, opened: SensorRig) -> None:
        opened.place(math.inf)
        opened.eventually(lambda: opened.sees(math.inf))

    def test_each_echo_has_its_time_which_is_not_to_come(self, opened: SensorRig) -> None:
        opened.place(NEAR_M)
        first = opened.first()
        assert first.at_s <= opened.now_s()
        opened.eventually(lambda: (echo := opened.read()) is not None and echo.at_s > first.at_s)

    def test_one_that_does_not_answer_is_noticed(self, opened: SensorRig) -> None:
        opened.place(NEAR_M)
        opened.eventually(opened.read)
        opened.begin(SILENT)

        def is_noticed() -> bool:
            try:
                opened.read()
            except LinkLostError:
                return True
            return False

        opened.eventually(is_noticed)

    def test_one_that_cannot_be_opened_says_so(self, rig: SensorRig) -> None:
        rig.begin(ABSENT)
        with pytest.raises(DriverError):
            rig.device.open()
        rig.device.close()

    def test_it_may_be_closed_twice_and_opened_again(self, opened: SensorRig) -> None:
        opened.device.close()
        opened.device.close()
        with pytest.raises(DeviceClosedError):
            opened.device.read()
        opened.device.open()
        opened.place(FAR_M)
        opened.eventually(lambda: opened.sees(FAR_M))
