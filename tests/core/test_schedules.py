"""Schedules by the calendar and the sun."""

import math
from datetime import date, timedelta

import pytest

from stadimeter.core.conditions.evidence import describe_verdict
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.schedule import DateSpan, ScheduleCondition
from stadimeter.core.observation import MonthDay, WallTime

HOUR_S = 3600.0
CHRISTMAS = DateSpan(MonthDay(12, 24), MonthDay(12, 26))
NIGHT = ScheduleCondition(from_s=0.0, to_s=0.0, from_sun="sunset", to_sun="sunrise")
BY_DAY = ScheduleCondition(from_s=0.0, to_s=0.0, from_sun="sunrise", to_sun="sunset")
POLAR_NIGHT, POLAR_DAY = (math.inf, -math.inf), (-math.inf, math.inf)


def words(schedule, wall):
    return describe_verdict(schedule, inputs(wall), (), is_active=False)


def month_and_day(day):
    return MonthDay(day.month, day.day)


def dates_around(day):
    return tuple(month_and_day(day + timedelta(days=later)) for later in (-1, 0, 1))


def at(day, hour, sun=(None, None)):
    return WallTime(
        second_of_day=hour * HOUR_S, weekday=day.weekday(), dates=dates_around(day), sunrise_s=sun[0], sunset_s=sun[1]
    )


def seconds(*hours_of_day):
    return tuple(hour * HOUR_S for hour in hours_of_day)


@pytest.mark.parametrize(
    ("day", "hour", "holds"),
    [
        (date(2026, 12, 23), 23.0, False),
        (date(2026, 12, 24), 1.0, False),
        (date(2026, 12, 24), 23.0, True),
        (date(2026, 12, 27), 1.0, True),
        (date(2026, 12, 27), 23.0, False),
    ],
)
def test_over_midnight_the_date_on_which_it_begins_counts(day, hour, holds):
    schedule = ScheduleCondition(from_s=22 * HOUR_S, to_s=6 * HOUR_S, dates=(CHRISTMAS,))
    assert schedule.covers(at(day, hour)) is holds


def test_a_span_of_dates_may_go_over_the_end_of_the_year():
    span = DateSpan(MonthDay(12, 20), MonthDay(1, 6))
    days = [date(2026, 12, 1) + timedelta(days=number) for number in range(60)]
    assert [day for day in days if span.covers(month_and_day(day))] == [
        date(2026, 12, 20) + timedelta(days=n) for n in range(18)
    ]


def test_29_february_is_a_day_of_leap_years():
    span = DateSpan(MonthDay(2, 29), MonthDay(2, 29))
    days = [date(2026, 1, 1) + timedelta(days=number) for number in range(5 * 365)]
    assert [day for day in days if span.covers(month_and_day(day))] == [date(2028, 2, 29)]


def test_without_a_date_one_by_dates_is_not_known():
    schedule = ScheduleCondition(from_s=0.0, to_s=86400.0, dates=(CHRISTMAS,))
    assert schedule.covers(WallTime(second_of_day=0.0, weekday=0)) is None
    assert "the date is not known" in words(schedule, WallTime(second_of_day=0.0, weekday=0))


def inputs(wall):
    return RuleInputs(tracks={}, now_s=0.0, wall=wall)


@pytest.mark.parametrize("hour", range(24))
def test_night_is_from_sunset_to_sunrise_and_day_the_rest(hour):
    wall = at(date(2026, 3, 1), hour, seconds(6.5, 18.5))
    assert NIGHT.covers(wall) is not (6.5 < hour < 18.5)
    assert BY_DAY.covers(wall) is (6.5 < hour < 18.5)


@pytest.mark.parametrize("hour", [0.0, 11.0, 23.9])
def test_where_the_sun_does_not_rise_it_is_night_all_day_and_where_it_does_not_set_never(hour):
    dark, bright = at(date(2026, 12, 21), hour, POLAR_NIGHT), at(date(2026, 6, 21), hour, POLAR_DAY)
    assert (NIGHT.covers(dark), BY_DAY.covers(dark)) == (True, False)
    assert (NIGHT.covers(bright), BY_DAY.covers(bright)) == (False, True)


def test_one_side_by_the_clock_goes_on_while_the_sun_does_not_come():
    until_sunrise = ScheduleCondition(from_s=22 * HOUR_S, to_s=0.0, to_sun="sunrise")
    assert until_sunrise.covers(at(date(2026, 12, 21), 12.0, POLAR_NIGHT)) is True
    assert until_sunrise.covers(at(date(2026, 6, 21), 23.0, POLAR_DAY)) is False


@pytest.mark.parametrize(
    ("schedule", "sun", "expected"),
    [
        # Stockholm in June and in December: it ends at 22:00 on the same day, or does not begin.
        (ScheduleCondition(from_s=0.0, to_s=22 * HOUR_S, from_sun="sunset"), (3.5, 22.1), []),
        (ScheduleCondition(from_s=0.0, to_s=22 * HOUR_S, from_sun="sunset"), (8.7, 14.8), [15, 16, 17, 18, 19, 20, 21]),
        (ScheduleCondition(from_s=5 * HOUR_S, to_s=0.0, to_sun="sunrise"), (3.5, 22.1), []),
        (ScheduleCondition(from_s=5 * HOUR_S, to_s=0.0, to_sun="sunrise"), (8.7, 14.8), [5, 6, 7, 8]),
        # What begins in the afternoon and ends in the morning goes over midnight in every season.
        (ScheduleCondition(from_s=0.0, to_s=2 * HOUR_S, from_sun="sunset"), (3.5, 22.1), [0, 1, 23]),
        (ScheduleCondition(from_s=22 * HOUR_S, to_s=0.0, to_sun="sunrise"), (3.5, 22.1), [0, 1, 2, 3, 22, 23]),
        (ScheduleCondition(from_s=0.0, to_s=0.0, from_sun="sunset"), (3.5, 20.5), [21, 22, 23]),
        (ScheduleCondition(from_s=0.0, to_s=-HOUR_S, from_sun="sunset", to_sun="sunset"), (6.0, 18.0), []),
    ],
)
def test_only_what_begins_in_the_afternoon_and_ends_in_the_morning_goes_over_midnight(schedule, sun, expected):
    day = date(2026, 6, 15)
    assert [hour for hour in range(24) if schedule.covers(at(day, float(hour), seconds(*sun)))] == expected


def test_an_offset_may_reach_over_midnight():
    late = ScheduleCondition(from_s=0.5 * HOUR_S, to_s=0.0, from_sun="sunset", to_sun="sunrise")
    sun = seconds(3.0, 23.75)  # an evening in the far north: it begins at 00:15
    day = date(2026, 6, 1)
    assert [late.covers(at(day, hour, sun)) for hour in (0.1, 0.3, 2.9, 3.1, 23.9)] == [False, True, True, False, False]
    early = ScheduleCondition(from_s=-4 * HOUR_S, to_s=0.0, from_sun="sunrise", to_sun="sunrise")
    assert [early.covers(at(day, hour, sun)) for hour in (22.9, 23.1, 0.1, 3.1)] == [False, True, True, False]


def test_without_a_place_one_by_the_sun_is_not_known():
    assert NIGHT.covers(at(date(2026, 3, 1), 12.0)) is None


def test_words_say_what_the_sun_does_today():
    delayed = ScheduleCondition(from_s=1800.0, to_s=-HOUR_S, from_sun="sunset", to_sun="sunrise", dates=(CHRISTMAS,))
    assert delayed.hours == "between 30 min after sunset and 1 h before sunrise on 12-24 to 12-26"
    assert NIGHT.verdict(
        inputs(at(date(2026, 3, 1), 12.0, seconds(6.5, 18.5))), False, names_target=True, with_probability=False
    ).endswith("(sunrise 06:30, sunset 18:30)")
    assert NIGHT.verdict(
        inputs(at(date(2026, 3, 1), 12.0, POLAR_DAY)), False, names_target=True, with_probability=False
    ).endswith("(the sun is up all day)")
