"""The time of day: read seldom, believed only when somebody vouches for it."""

from datetime import UTC, datetime, timedelta

import pytest

from stadimeter.app import clock as clocks
from stadimeter.app.clock import TimeOfDay, is_synchronised
from stadimeter.core.conditions.compounds import AllOf, Not
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.schedule import ScheduleCondition
from stadimeter.core.observation import MonthDay, WallTime
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule

SATURDAY_NIGHT = datetime(2026, 11, 21, 22, 30, 15, 500_000, tzinfo=UTC)

AROUND = tuple(MonthDay(11, day) for day in (20, 21, 22))


class Clock:
    """A wall clock to set by hand, and whether it is right."""

    def __init__(self):
        self.time = SATURDAY_NIGHT
        self.is_right = True
        self.asked = 0

    def now(self):
        self.asked += 1
        return self.time

    def time_of_day(self, *, is_live=True):
        return TimeOfDay(is_live=is_live, now=self.now, is_right=lambda: self.is_right)


@pytest.fixture
def clock():
    return Clock()


def test_it_is_seconds_since_midnight_and_the_day_of_the_week(clock):
    assert clock.time_of_day().at(0.0) == WallTime(second_of_day=22 * 3600 + 30 * 60 + 15.5, weekday=5, dates=AROUND)


def test_it_is_asked_for_once_a_second_however_many_cycles_there_are(clock):
    of_day = clock.time_of_day()
    for cycle in range(90):
        of_day.at(100.0 + cycle / 30)
    assert clock.asked == 3


def test_a_clock_that_nobody_vouches_for_shows_no_time_until_somebody_does(clock):
    clock.is_right = False
    of_day = clock.time_of_day()
    assert of_day.at(0.0) is None
    clock.is_right = True
    assert of_day.at(0.5) is None
    assert of_day.at(1.0) is not None


def test_a_live_run_goes_by_the_clock_on_the_wall_when_that_is_set_anew(clock):
    of_day = clock.time_of_day()
    before = of_day.at(0.0)
    clock.time += timedelta(hours=3)
    assert of_day.at(2.0).weekday == 6
    assert before.weekday == 5


def test_in_a_simulation_the_day_goes_on_with_the_run_and_not_with_the_computer(clock):
    of_day = clock.time_of_day(is_live=False)
    of_day.at(10.0)
    clock.time += timedelta(seconds=2)
    assert of_day.at(10.0 + 3600) == WallTime(second_of_day=23 * 3600 + 30 * 60 + 15.5, weekday=5, dates=AROUND)


def test_the_file_of_the_time_service_vouches_for_the_clock(tmp_path, monkeypatch):
    monkeypatch.setattr(clocks, "_kernel_error_us", lambda: float("inf"))
    assert not is_synchronised(tmp_path / "synchronized")
    (tmp_path / "synchronized").touch()
    assert is_synchronised(tmp_path / "synchronized")


@pytest.mark.parametrize(("error_us", "right"), [(2_000, True), (16_000_000, False), (float("inf"), False)])
def test_so_does_a_kernel_that_knows_its_clock_to_be_right(tmp_path, monkeypatch, error_us, right):
    monkeypatch.setattr(clocks, "_kernel_error_us", lambda: error_us)
    assert is_synchronised(tmp_path / "none") is right


NEAR = DistanceCondition(below=1.0)
AT_NIGHT = ScheduleCondition(from_s=22 * 3600, to_s=6 * 3600)


@pytest.mark.parametrize(
    ("how", "asks"),
    [
        ({"condition": NEAR}, False),
        ({"condition": AT_NIGHT}, True),
        ({"condition": AllOf(conditions=(NEAR, Not(condition=AT_NIGHT)))}, True),
        ({"condition": NEAR, "suppress_when": AT_NIGHT}, True),
    ],
)
def test_only_a_plan_with_a_schedule_asks_for_the_time(how, asks):
    rule = AlarmRule(name="near", target="ball", **how)
    assert Plan(targets=("ball",), rules=(rule,)).needs_wall_time is asks
