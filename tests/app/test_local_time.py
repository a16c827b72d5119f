"""The local time, the date and the sun's times at a place."""

import math
from datetime import UTC, date, datetime
from zoneinfo import ZoneInfo

import pytest

from stadimeter.app.clock import wall_time
from stadimeter.config.loader import load_configuration
from stadimeter.config.sun import sun_times_s
from stadimeter.core.observation import MonthDay
from support.simulated_run import SIMULATED_BALL

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
