"""A range sensor is read beside the loop, is a target of its own, and keeps the base from what is near."""

import math

import pytest

from stadimeter.app.range_reader import MAX_ECHO_AGE_S, OPEN_AGAIN_S, RangeReader
from stadimeter.config.models import SensorTable
from stadimeter.core.measurement import MeasurementStatus
from stadimeter.errors import DeviceOpenError, LinkLostError
from stadimeter.sensors.protocol import Echo
from stadimeter.testing.rig import ManualClock


class Sensor:
    """A sensor in memory: what it sees, or how it fails."""

    period_s = 0.05

    def __init__(self, clock):
        self.clock, self.distance_m, self.fails, self.is_open = clock, 1.0, False, False

    def open(self):
        if self.fails:
            raise DeviceOpenError("it is not there")
        self.is_open = True

    def read(self):
        if self.fails:
            raise LinkLostError("it is silent")
        return Echo(at_s=self.clock.now_s(), distance_m=self.distance_m, sigma_m=0.01)

    def close(self):
        self.is_open = False


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def sensor(clock):
    return Sensor(clock)


def reading(sensor, clock, **table):
    reader = RangeReader("front", sensor, SensorTable.model_validate(table), clock)
    reader.open()
    clock.advance_s(0.1)
    return reader


def test_an_echo_is_a_measurement_from_the_camera_in_the_direction_in_which_the_sensor_looks(sensor, clock):
    measured = reading(sensor, clock, bearing="60 deg", ahead="-10 cm").measurement()
    assert (measured.target, measured.status) == ("front", MeasurementStatus.MEASURED)
    assert measured.distance_m == pytest.approx(0.9)
    assert measured.depth_m == pytest.approx(0.45)
    assert measured.bearing_rad == pytest.approx(math.pi / 3)


def test_no_echo_is_measured_twice(sensor, clock):
    reader = reading(sensor, clock)
    assert reader.measurement() is not None
    assert reader.measurement() is None
    clock.advance_s(0.1)
    assert reader.measurement() is not None


def test_nothing_in_range_is_not_found_and_keeps_nobody_from_driving(sensor, clock):
    sensor.distance_m = math.inf
    reader = reading(sensor, clock, stop_below="30 cm")
    assert reader.measurement().status is MeasurementStatus.NOT_FOUND
    assert not reader.why_not_drive()


def test_something_near_keeps_the_base_until_it_is_clearly_further(sensor, clock):
    reader = reading(sensor, clock, stop_below="30 cm")
    answers = []
    for distance_m in (0.31, 0.29, 0.31, 0.34, 0.36, 0.31):
        sensor.distance_m = distance_m
        clock.advance_s(0.1)
        answers.append(bool(reader.why_not_drive()))
    assert answers == [False, True, True, True, False, False]


def test_a_sensor_that_is_silent_or_late_keeps_the_base_too(sensor, clock):
    reader = RangeReader("front", sensor, SensorTable.model_validate({"stop_below": "30 cm"}), clock)
    reader.open()
    assert reader.why_not_drive(), "it has not measured yet"
    clock.advance_s(0.1)
    assert not reader.why_not_drive()
    sensor.fails = True
    clock.advance_s(0.1)
    assert "silent" in reader.why_not_drive()
    assert reader.measurement().status is MeasurementStatus.ERROR


def test_an_echo_that_grows_old_keeps_the_base(sensor, clock):
    reader = reading(sensor, clock, stop_below="30 cm")
    reader.close()
    clock.advance_s(1.1 * MAX_ECHO_AGE_S)
    assert "has not measured" in reader.why_not_drive()


def test_a_sensor_that_watches_over_nothing_keeps_nobody(sensor, clock):
    sensor.distance_m = 0.01
    assert not reading(sensor, clock).why_not_drive()


@pytest.mark.parametrize("is_there_at_first", [True, False])
def test_a_sensor_that_comes_back_is_opened_again(sensor, clock, is_there_at_first):
    reader = RangeReader("front", sensor, SensorTable.model_validate({"stop_below": "30 cm"}), clock)
    if is_there_at_first:
        reader.open()
    sensor.fails = True
    if not is_there_at_first:
        assert reader.open_later(DeviceOpenError("it is not there"))
    clock.advance_s(2.5 * OPEN_AGAIN_S)
    assert reader.why_not_drive()
    sensor.fails = False
    clock.advance_s(1.1 * OPEN_AGAIN_S)
    assert sensor.is_open
    assert not reader.why_not_drive()
    reader.close()
    assert not sensor.is_open
