"""Schedules, places and orders of rules as they are written, and what is wrong with them."""

import importlib.util
import re

import pytest

from stadimeter.config import extras
from stadimeter.config.loader import load_configuration
from stadimeter.core.conditions.of_rules import SequenceCondition
from stadimeter.core.conditions.schedule import DateSpan, ScheduleCondition
from stadimeter.core.observation import MonthDay
from stadimeter.errors import ConfigError
from support.simulated_run import SIMULATED_BALL

PLACE = "[place]\nlatitude = 52.5\nlongitude = 13.4\ntime_zone = 'Europe/Berlin'\n"


@pytest.fixture
def load(tmp_path):
    def load(rules, place=PLACE):
        path = tmp_path / "rules.toml"
        path.write_text(f"{SIMULATED_BALL}\n[world]\n{place}{rules}")
        return load_configuration(path)

    return load


def near(time):
    return f"[rules.near]\nwhen = {{ time = {time} }}\n"


@pytest.mark.parametrize(
    ("time", "expected"),
    [
        ("{ between = ['22:00', '06:00'] }", ScheduleCondition(from_s=79200.0, to_s=21600.0)),
        (
            "{ between = ['sunset + 30 min', 'sunrise - 1 h'] }",
            ScheduleCondition(from_s=1800.0, to_s=-3600.0, from_sun="sunset", to_sun="sunrise"),
        ),
        (
            "{ between = ['sunset', '23:00'], dates = ['12-24..12-26', '02-29'], days = ['sat'] }",
            ScheduleCondition(
                from_s=0.0,
                to_s=82800.0,
                from_sun="sunset",
                weekdays=(5,),
                dates=(DateSpan(MonthDay(12, 24), MonthDay(12, 26)), DateSpan(MonthDay(2, 29), MonthDay(2, 29))),
            ),
        ),
    ],
)
def test_a_schedule_is_read_as_it_is_written(load, time, expected):
    (rule,) = load(near(time)).plan.rules
    assert rule.condition == expected


def test_an_order_of_rules_is_read_as_it_is_written(load):
    both = "[rules.left]\nwhen = { below = '1 m' }\n[rules.right]\nwhen = { above = '2 m' }\n"
    order = "[rules.order]\nwhen = { sequence_of = { rules = ['left', 'right'], within = '2 s', for = '5 s' } }\n"
    rule = load(both + order).plan.rules[2]
    assert rule.condition == SequenceCondition(rules=("left", "right"), within_s=2.0, for_s=5.0)
    assert rule.on_delay.frames == 0  # there is no noise in it


@pytest.mark.parametrize(
    ("rules", "place", "said"),
    [
        (near("{ between = ['sunst', 'sunrise'] }"), PLACE, "'sunst' is not a time of day"),
        (near("{ between = ['sunset + 14 h', 'sunrise'] }"), PLACE, "more than 12 h away from the sunset"),
        (near("{ between = ['08:00', '09:00'], dates = ['02-30'] }"), PLACE, "02-30 is on no calendar"),
        (near("{ between = ['08:00', '09:00'], dates = ['24.12.'] }"), PLACE, "'24.12.' is no span of days"),
        (near("{ between = ['sunset', 'sunset'] }"), PLACE, "the time ends when it begins"),
        (near("{ between = ['sunset', 'sunrise'] }"), "", "add a section [place] with latitude and longitude"),
        ("", "[place]\nlatitude = 91\nlongitude = 0\n", "place.latitude"),
        ("", "[place]\ntime_zone = 'Europe/Berln'\n", "did you mean 'Europe/Berlin'?"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_words(load, rules, place, said):
    with pytest.raises(ConfigError) as caught:
        load(rules, place)
    assert said in str(caught.value)


def test_without_the_library_a_schedule_by_the_sun_is_refused_with_the_line_that_installs_it(load, monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name == "astral" else found(name))
    with pytest.raises(ConfigError, match=r"pip install 'stadimeter\[sun\]'"):
        load(near("{ between = ['sunset', 'sunrise'] }"))
    load(near("{ between = ['20:00', '22:00'] }"))


def test_a_test_has_a_date_only_with_a_time_of_day_and_without_a_day_of_the_week(load):
    test = (
        "[[tests]]\n"
        "input = { hover = { at = '1 m', for = '1 s' }, date = '2026-12-24'%s }\nexpect.near = { raised = 0 }"
    )
    rule = near("{ between = ['22:00', '06:00'] }")
    with pytest.raises(ConfigError, match="a date goes with clock"):
        load(rule + test % "")
    with pytest.raises(ConfigError, match="has a day of the week of its own"):
        load(rule + test % ", clock = '12:00', day = 'mon'")


STOCKHOLM = "[place]\nlatitude = 59.3\nlongitude = 18.1\ntime_zone = 'Europe/Stockholm'\n"


@pytest.mark.parametrize(
    ("between", "words"),
    [
        (
            "'sunset', '22:00'",
            r"this never comes on (2\d|3\d) of the next 366 days on which it may hold, from 06-\d\d to 07-\d\d",
        ),
        ("'sunset', 'sunset - 1 h'", r"this never comes on 366 of the next 366 days"),
    ],
)
def test_days_on_which_a_schedule_by_the_sun_is_empty_are_named(load, between, words):
    (warning,) = [
        each for each in load(near(f"{{ between = [{between}] }}"), STOCKHOLM).warnings if each.code == "empty-days"
    ]
    assert re.match(words, warning.message)
