"""The time of day: read seldom, believed only when somebody vouches for it."""

import math
from datetime import UTC, date, datetime, timedelta
from zoneinfo import ZoneInfo

import pytest

from stadimeter.app import clock as clocks
from stadimeter.app.clock import TimeOfDay, is_synchronised, wall_time
from stadimeter.config.loader import load_configuration
from stadimeter.config.sun import sun_times_s
from stadimeter.core.conditions.compounds import AllOf, Not
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.schedule import ScheduleCondition
from stadimeter.core.observation import MonthDay, WallTime
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule
from support.simulated_run import SIMULATED_BALL

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


# The local time, the date and the sun's times at a place.


BERLIN, TROMSO, AUCKLAND = (52.52, 13.405), (69.65, 18.96), (-36.85, 174.76)
QUITO = (-0.18, -78.47)
MINUTE_S = 60.0


@pytest.fixture
def configuration_with(tmp_path):
    def load(between, place):
        path = tmp_path / "place.toml"
        rule = f"[rules.near]\nwhen = {{ below = '1 m', time = {{ between = {between} }} }}\n"
        path.write_text(f"{SIMULATED_BALL}\n[world]\n[place]\n{place}\n{rule}")
        return load_configuration(path)

    return load


@pytest.mark.parametrize(
    ("place", "zone", "day", "rises", "sets"),
    [
        # Computed with PyEphem 4.2 (upper edge of the sun, refraction of 34 minutes of arc), rounded to the minute.
        (BERLIN, "Europe/Berlin", date(2026, 6, 21), (4, 43), (21, 33)),
        (BERLIN, "Europe/Berlin", date(2026, 12, 21), (8, 15), (15, 54)),
        (AUCKLAND, "Pacific/Auckland", date(2026, 12, 21), (5, 58), (20, 40)),
        (QUITO, "America/Guayaquil", date(2026, 3, 20), (6, 18), (18, 25)),
        (TROMSO, "Europe/Oslo", date(2026, 4, 10), (5, 7), (20, 27)),
    ],
)
def test_the_sun_rises_and_sets_when_another_program_says(place, zone, day, rises, sets):
    found = sun_times_s(*place, ZoneInfo(zone), day)
    expected = [3600.0 * hour + MINUTE_S * minute for hour, minute in (rises, sets)]
    assert found == pytest.approx(expected, abs=1.5 * MINUTE_S)


def test_beyond_the_polar_circle_there_are_days_without_sunrise_or_sunset():
    zone = ZoneInfo("Europe/Oslo")
    assert sun_times_s(*TROMSO, zone, date(2026, 6, 21)) == (-math.inf, math.inf)
    assert sun_times_s(*TROMSO, zone, date(2026, 12, 21)) == (math.inf, -math.inf)
    assert sun_times_s(*TROMSO, UTC, date(2026, 12, 21)) == (math.inf, -math.inf)


def test_every_day_of_a_year_at_every_latitude_has_times_or_says_that_it_has_none():
    for latitude in (-90.0, -66.0, -23.0, 0.0, 45.0, 65.7, 67.0, 80.0, 90.0):
        for month in range(1, 13):
            for zone in (UTC, ZoneInfo("Pacific/Kiritimati"), ZoneInfo("Pacific/Pago_Pago")):
                times_s = sun_times_s(latitude, 13.4, zone, date(2026, month, 21))
                assert not any(math.isnan(at_s) for at_s in times_s)
                assert all(math.isinf(at_s) or -86400 < at_s < 2 * 86400 for at_s in times_s)


def test_a_place_has_the_time_of_its_zone_and_no_sun_unless_a_rule_asks(configuration_with):
    place = "latitude = 52.52\nlongitude = 13.405\ntime_zone = 'Europe/Berlin'"
    now = datetime(2026, 6, 21, 22, 30, tzinfo=UTC)
    plain = wall_time(now, configuration_with("['22:00', '06:00']", place))
    assert (plain.second_of_day, plain.dates[1], plain.weekday) == (1800.0, MonthDay(6, 22), 0)
    assert (plain.sunrise_s, plain.sunset_s) == (None, None)
    by_sun = wall_time(now, configuration_with("['sunset', 'sunrise']", place))
    assert by_sun.sunrise_s == pytest.approx(3600 * 4.72, abs=120)
