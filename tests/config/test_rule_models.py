"""Rules as they are written become rules as the core knows them."""

from __future__ import annotations

import math
import tomllib

import pytest

from stadimeter.config import models
from stadimeter.config.rules.tables import RuleTable
from stadimeter.core import plan
from stadimeter.core import rule as core
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decision import Severity
from support.conditions import closing
from support.each_case import each_case


def rule(text: str) -> core.AnyRule:
    table = RuleTable.model_validate(tomllib.loads(text))
    (compiled,) = table.to_plans("it", ("ball",), table.conditions())
    return compiled


def alarm(text: str) -> core.AlarmRule:
    found = rule(text)
    assert isinstance(found, core.AlarmRule)
    return found


@each_case(
    ("when", "is_waiting"),
    [
        ('{ below = "1 m" }', False),
        ('{ below = "1 m", probability = "none" }', True),
        ('{ closing_speed = { above = "1 m/s" } }', False),
        ('{ bearing = { above = "20 deg" } }', True),
        ("{ seen = true }", True),
        ("{ count = { at_least = 2 } }", True),
        ('{ all = [ { below = "1 m" }, { time = { between = ["22:00", "06:00"] } } ] }', False),
        ('{ any = [ { below = "1 m" }, { not = { seen = true } } ] }', True),
    ],
)
def test_only_what_is_judged_without_a_probability_must_hold_in_three_of_five_frames(
    when: str, is_waiting: bool
) -> None:
    expected = core.OnDelay(frames=3, of_frames=5) if is_waiting else core.OnDelay()
    assert alarm(f"when = {when}").on_delay == expected


def test_a_safety_rule_acts_at_even_odds_and_at_once() -> None:
    found = alarm('severity = "safety"\nwhen = { below = "1 m" }')
    assert found.severity is Severity.SAFETY
    assert found.on_delay == core.OnDelay()
    assert found.condition == DistanceCondition(below=1.0, probability_on=0.5, target="ball")


def test_a_safety_rule_about_speed_asks_for_an_estimate_that_has_settled() -> None:
    found = alarm('severity = "safety"\nwhen = { closing_speed = { above = "1 m/s" } }').condition
    assert found == closing(above=1.0, probability_on=0.8, target="ball")
    found = alarm('severity = "safety"\nwhen = { closing_speed = { above = "1 m/s", probability = 0.5 } }').condition
    assert found == closing(above=1.0, probability_on=0.5, target="ball")


def test_what_a_safety_rule_says_itself_counts() -> None:
    found = alarm('severity = "safety"\nwhen = { below = "1 m", probability = 0.8 }')
    assert found.condition == DistanceCondition(below=1.0, probability_on=0.8, target="ball")


def test_every_key_of_an_alarm_reaches_the_core() -> None:
    found = alarm(
        'actuator = "lamp"\npriority = 7\nseverity = "alarm"\nwhen = { above = "1 m" }\n'
        "on_delay = { frames = 2, of = 4 }\noff_delay = \"0 s\"\nlevel = 0.5\nat_start = 'announce'\n"
        'lost = { grace = "1 s", policy = "assert", fault_after = "9 s" }'
    )
    assert found == core.AlarmRule(
        name="it",
        target="ball",
        output="lamp",
        priority=7,
        severity=Severity.ALARM,
        lost=core.Lost(grace_s=1.0, policy=core.LostPolicy.ASSERT, fault_after_s=9.0),
        condition=DistanceCondition(above=1.0),
        on_delay=core.OnDelay(frames=2, of_frames=4),
        off_delay_s=0.0,
        level=0.5,
        at_start="announce",
    )


def test_every_key_of_a_ramp_reaches_the_core() -> None:
    found = rule(
        'actuator = "motor"\n'
        'ramp = { from = "2 m", to = "0 m", of = "depth", min = 0.2, max = 0.9, gamma = 2, bias = "quiet" }'
    )
    assert found == core.RampRule(
        name="it",
        target="ball",
        output="motor",
        start=2.0,
        full=0.0,
        quantity="depth",
        level_min=0.2,
        level_max=0.9,
        gamma=2.0,
        bias="quiet",
    )


def test_every_key_of_following_reaches_the_core() -> None:
    found = rule(
        'actuator = "base"\nfollow = { distance = "2 m", gain = 2, turn_gain = 3, max_speed = "1 m/s", '
        'max_reverse_speed = "10 cm/s", max_turn_rate = "180 deg/s", deadband = "0 m", turn_deadband = "0 deg" }'
    )
    assert found == core.FollowRule(
        name="it",
        target="ball",
        output="base",
        distance_m=2.0,
        gain_per_s=2.0,
        turn_gain_per_s=3.0,
        linear_max_mps=1.0,
        reverse_max_mps=pytest.approx(0.1),
        angular_max_radps=pytest.approx(math.pi),
        deadband_m=0.0,
        deadband_rad=0.0,
    )


def test_the_defaults_of_every_section_are_those_of_the_plan() -> None:
    assert models.TrackingTable().to_plan() == plan.Tracking()
    assert models.SafetyTable().to_plan() == plan.Safety()
    assert models.ActuatorTable().to_plan("motor") == plan.LevelOutput(name="motor")
    assert models.BaseTable().to_plan("base") == plan.BaseOutput(name="base")


def test_every_key_of_an_output_reaches_the_core() -> None:
    actuator = models.ActuatorTable(safe=0.2, rise_per_s=4.0, fall_per_s=8.0)
    assert actuator.to_plan("motor") == plan.LevelOutput(name="motor", safe_level=0.2, rise_per_s=4.0, fall_per_s=8.0)
    base = models.BaseTable.model_validate(
        {"max_speed": "1 m/s", "max_turn_rate": "2 rad/s", "acceleration": "3 m/s2", "turn_acceleration": "4 rad/s2"}
    )
    assert base.to_plan("base") == plan.BaseOutput(
        name="base", linear_max_mps=1.0, angular_max_radps=2.0, linear_accel_mps2=3.0, angular_accel_radps2=4.0
    )
