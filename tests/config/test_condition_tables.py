"""Conditions as they are written become those that the core knows, or are refused with what to write instead."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from datetime import time

import pytest

from stadimeter.config.rules.conditions import WhenTable, kinds_in
from stadimeter.config.units import parse_time_of_day
from stadimeter.core.conditions.compounds import AllOf, AnyOf, Condition, Not, leaves
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.conditions.of_rules import (
    BatteryCondition,
    ContactSensorCondition,
    RuleCondition,
    UndeliveredCondition,
)
from stadimeter.core.conditions.schedule import ScheduleCondition
from stadimeter.core.conditions.sight import CountCondition, PresenceCondition
from stadimeter.core.decision import Severity
from support.conditions import closing, direction, separation, still

Told = Callable[[str], list[str]]


def table(text: str) -> WhenTable:
    return WhenTable.model_validate(tomllib.loads(f"when = {text}")["when"])


def plan(text: str, severity: Severity = Severity.WARNING) -> Condition:
    return table(text).to_plan(severity)


ENTRIES: list[tuple[str, Condition]] = [
    ('{ below = "50 cm" }', DistanceCondition(below=0.5)),
    ('{ above = "1 m", below = "2 m" }', DistanceCondition(above=1.0, below=2.0)),
    ('{ between = ["1 m", "2 m"], of = "depth", deadband = "10 cm", deadband_sigmas = 2, target = "tag" }',
     DistanceCondition(above=1.0, below=2.0, quantity="depth", deadband=0.1, deadband_sigmas=2.0, target="tag")),
    ('{ below = "1 m", probability = "none", probability_off = 0.3 }',
     DistanceCondition(below=1.0, probability_on=None, probability_off=0.3)),
    ("{ seen = true }", PresenceCondition(seen=True)),
    ('{ lost = true, target = "tag" }', PresenceCondition(seen=False, target="tag")),
    ('{ seen = "5 s" }', PresenceCondition(seen=True, for_s=5.0)),
    ('{ lost = "5 min" }', PresenceCondition(seen=False, for_s=300.0)),
    ('{ bearing = { above = "-10 deg", deadband = "2 deg" } }',
     direction(above=math.radians(-10), deadband=math.radians(2))),
    ('{ elevation = { between = ["0 deg", "90 deg"] }, target = "tag" }',
     direction(quantity="elevation", above=0.0, below=math.pi / 2, target="tag")),
    ('{ closing_speed = { above = "0.5 m/s", deadband = "0.1 m/s", probability = 0.9 } }',
     closing(above=0.5, deadband=0.1, probability_on=0.9)),
    ('{ closing_speed = { below = "-1 m/s" } }', closing(below=-1.0)),
    ('{ time_to_contact = { below = "2 s", contact = "10 cm", deadband = "1 s" } }',
     TimeToContactCondition(below_s=2.0, contact_m=0.1, deadband_s=1.0)),
    ('{ separation = { of = ["ball", "tag"], below = "1 m" } }', separation(targets=("ball", "tag"), below=1.0)),
    ('{ place = { axis = "height", above = "2 m" } }', FigureCondition(quantity="height", above=2.0)),
    ('{ place = { axis = "x", between = ["-1 m", "50 cm"], deadband = "5 cm" }, target = "tag" }',
     FigureCondition(quantity="x", above=-1.0, below=0.5, deadband=0.05, target="tag")),
    ('{ speed = { above = "2 m/s" } }',
     FigureCondition(quantity="speed", above=2.0, deadband_sigmas=2.0, probability_on=0.95)),
    ('{ speed = { axis = "sideways", below = "-1 m/s" } }',
     FigureCondition(quantity="sideways_speed", below=-1.0, deadband_sigmas=2.0, probability_on=0.95)),
    ('{ size = { above = "20 %" } }', FigureCondition(quantity="size", above=0.2)),
    ('{ still = { for = "10 min", within = "5 cm" } }', still(600.0, within_m=0.05)),
    ('{ nearer_than = "tag" }', FigureCondition(quantity="distance", below=0.0, other="tag")),
    ('{ target = "ball", left_of = { target = "tag", by = "10 deg", deadband = "1 deg" } }',
     FigureCondition(
         quantity="bearing", below=-math.radians(10), deadband=math.radians(1), target="ball", other="tag"
     )),
    ('{ higher_than = { target = "tag", by = "20 cm", probability = 0.9 } }',
     FigureCondition(quantity="height_above_camera", above=0.2, probability_on=0.9, other="tag")),
    ("{ count = { at_least = 2 } }", CountCondition(at_least=2)),
    ('{ count = { at_most = 1, of = ["ball", "tag"] } }', CountCondition(at_most=1, targets=("ball", "tag"))),
    ('{ rule = "too-close" }', RuleCondition(rule="too-close")),
    ('{ time = { between = ["22:00", "06:00"], days = ["sun", "mon", "mon"] } }',
     ScheduleCondition(from_s=79200.0, to_s=21600.0, weekdays=(0, 6))),
    ('{ base = "bumped" }', ContactSensorCondition(sensor="is_bumped")),
    ('{ base = "at_cliff" }', ContactSensorCondition(sensor="is_at_cliff")),
    ('{ base = { battery_below = "10800 mV" } }', BatteryCondition(below=10.8)),
    ('{ undelivered_for = "5 s" }', UndeliveredCondition(for_s=5.0)),
    ("{ time = { between = [22:00:00, 06:30:00] } }", ScheduleCondition(from_s=79200.0, to_s=23400.0)),
    ('{ all = [ { below = "1 m" }, { not = { seen = true } } ] }',
     AllOf(conditions=(DistanceCondition(below=1.0), Not(condition=PresenceCondition(seen=True))))),
    ('{ any = [ { rule = "a" } ] }', AnyOf(conditions=(RuleCondition(rule="a"),))),
]  # fmt: skip


def test_a_condition_means_what_is_written(subtests: pytest.Subtests) -> None:
    for text, expected in ENTRIES:
        with subtests.test(text=text, expected=expected):
            assert plan(text) == expected


DANGERS = [
    '{ below = "1 m" }',
    '{ time_to_contact = { below = "1 s" } }',
    '{ separation = { of = ["ball", "tag"], below = "1 m" } }',
]


def test_a_safety_rule_acts_as_soon_as_danger_is_as_likely_as_not(subtests: pytest.Subtests) -> None:
    for text in DANGERS:
        with subtests.test(text=text):
            assert getattr(plan(text, Severity.SAFETY), "probability_on") == 0.5  # noqa: B009 - not all conditions have it
            nested = plan(f"{{ all = [ {text} ] }}", Severity.SAFETY)
            assert getattr(next(leaves(nested)), "probability_on") == 0.5  # noqa: B009


def test_several_conditions_in_one_table_are_short_for_all_of_them() -> None:
    time = 'time = { between = ["22:00", "06:00"] }'
    text = f'{{ {time}, below = "1 m", deadband = "5 cm", seen = "2 s", target = "tag" }}'
    long = (
        '{ all = [{ below = "1 m", deadband = "5 cm", target = "tag" }, { seen = "2 s", target = "tag" }, '
        f"{{ {time} }}] }}"
    )
    assert plan(text) == plan(long)
    assert len(kinds_in(tomllib.loads(f"when = {text}")["when"])) == 3


WRONG = [
    ('{ above = "1 m", between = ["2 m", "3 m"] }',
     "rules.it.when: above and below have no meaning beside between, which says both"),
    ('{ seen = true, rule = "it", of = "depth" }',
     "rules.it.when: 'of' has no meaning beside 'seen' and 'rule'; write it inside, or leave it out"),
    ('{ seen = true, probability = 0.9 }',
     "rules.it.when: 'probability' has no meaning beside 'seen'; write it inside, or leave it out"),
    ('{ closing_speed = { above = "1 m/s" }, deadband = "1 m" }', "'deadband' has no meaning beside 'closing_speed'"),
    ('{ any = [ { seen = true } ], target = "ball" }', "'target' has no meaning beside 'any'"),
    ("{ bearing = {} }", "rules.it.when.bearing: there is no limit; write above, below,"),
    ('{ bearing = { above = "1 deg", between = ["2 deg", "3 deg"] } }',
     "rules.it.when.bearing: above and below have no meaning"),
    ("{ count = {} }", "rules.it.when.count: how many is not said; write at_least, at_most, or both"),
    ("{ count = { at_least = 0 } }", "rules.it.when.count.at_least: 0 is below 1"),
    ('{ time = { between = ["22:00", "22:00"] } }', 'write ["00:00", "24:00"] for the whole day'),
    ('{ time = { between = ["22:00", "25:00"] } }', "'25:00' is no time that a clock shows; write it such as '22:30'"),
    ('{ time = { between = ["22:00", "06:00"], days = ["mon", "tues"] } }', "rules.it.when.time.days.1: 'tues'"),
    ('{ time_to_contact = { contact = "1 m" } }', "rules.it.when.time_to_contact.below: 'below' is missing"),
    ('{ lost = false }', "write true, or a time such as '5 min'; the opposite of 'seen = true' is 'lost = true'"),
    ("{ all = [] }", "rules.it.when.all: [] is a list of fewer than 1 entries"),
    ('{ not = [ { seen = true } ] }', "rules.it.when.not: [a table] is not a table; write it as { … }"),
    ('{ all = [ { bellow = "1 m" } ] }', "rules.it.when.all.0.bellow: unknown key 'bellow' (did you mean 'below'?)"),
    ('{ all = [{ below = "1 m" }, { above = "2 m" }] }', "two limits of this on one figure exclude each other"),
]  # fmt: skip


MISPLACED = [
    ('when = { below = "1 m", for = "10 s" }', "when.for", 'write on_delay = "10 s" beside when'),
    ('when = { below = "1 m", hysteresis = "5 cm" }', "when.hysteresis", "did you mean 'deadband'?"),
    ('when = { below = "1 m" }\ndebounce = "1 s"', "debounce", 'write on_delay = "2 s"'),
    ('below = "1 m"', "below", 'write it inside when, such as when = { below = "50 cm" }'),
    ('when = { height = { above = "1 m" } }', "when.height", 'write place = { axis = "height", above = … }'),
    ('ramp = { from = "2 m", to = "1 m" }\nlevle = 1', "levle", "did you mean 'level'"),
]


def test_a_key_that_belongs_elsewhere_is_answered_with_its_place(
    told: Told, sound: str, subtests: pytest.Subtests
) -> None:
    for rule, key, hint in MISPLACED:
        with subtests.test(rule=rule, key=key):
            lines = told(f'{sound}[rules.it]\nactuator = "buzzer"\n{rule}\n')
            assert any(line.startswith(f"rules.it.{key}: ") and hint in line for line in lines), lines


def test_a_condition_that_says_nothing_clear_is_refused(told: Told, sound: str, subtests: pytest.Subtests) -> None:
    for when, words in WRONG:
        with subtests.test(when=when):
            lines = told(f'{sound}[rules.it]\nactuator = "buzzer"\nwhen = {when}\n')
            assert any(words in line for line in lines), lines


def test_what_suppresses_a_rule_is_checked_like_what_raises_it(told: Told, sound: str) -> None:
    when, words = WRONG[0]
    rule = f'[rules.it]\nactuator = "buzzer"\nwhen = {{ below = "1 m" }}\nsuppress_when = {when}\n'
    assert words.replace("it.when", "it.suppress_when") in told(sound + rule)


TIMES = [("22:30", 81000.0), ("6:05", 21900.0), ("24:00", 86400.0), ("00:00:30", 30.0), (time(22, 30), 81000.0)]


def test_a_time_of_day_is_read(subtests: pytest.Subtests) -> None:
    for written, second in TIMES:
        with subtests.test(written=written, second=second):
            assert parse_time_of_day(written) == second


NO_TIMES = ["22", "22.30", "24:01", "12:60", "noon", 22, None]


def test_what_no_clock_shows_is_refused(subtests: pytest.Subtests) -> None:
    for written in NO_TIMES:
        with subtests.test(written=written), pytest.raises(ValueError, match="write it such as '22:30'"):
            parse_time_of_day(written)
