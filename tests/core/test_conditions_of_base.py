"""Conditions on what the base reports: its bumper, what is below it, its battery."""

import pytest

from stadimeter.core.command import BaseReport
from stadimeter.core.conditions.evidence import describe_begin, describe_verdict
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.of_rules import BATTERY_DEADBAND_V, BatteryCondition, ContactSensorCondition
from support.each_case import each_case

LOW = BatteryCondition(below=11.0)
BUMPED = ContactSensorCondition(sensor="is_bumped")


def inputs(**figures):
    return RuleInputs(tracks={}, now_s=0.0, base=BaseReport(at_s=0.0, **figures))


@each_case("answer", [True, False, None])
@each_case("sensor", ["is_bumped", "is_at_cliff"])
def test_a_contact_sensor_answers_yes_no_or_is_not_there(sensor, answer):
    assert ContactSensorCondition(sensor=sensor).holds(inputs(**{sensor: answer}), is_on=False) is answer


@pytest.mark.parametrize("condition", [LOW, BUMPED])
def test_without_a_base_nothing_is_known(condition):
    nothing = RuleInputs(tracks={}, now_s=0.0)
    assert condition.holds(nothing, is_on=False) is None
    words = describe_verdict(condition, nothing, (), is_active=False)
    assert "unknown" in words or "does not report" in words


def test_a_low_battery_is_not_full_again_because_a_motor_let_it_go():
    assert LOW.holds(inputs(battery_v=10.9), is_on=False) is True
    assert LOW.holds(inputs(battery_v=11.0), is_on=False) is False
    assert LOW.holds(inputs(battery_v=11.0 + BATTERY_DEADBAND_V / 2), is_on=True) is True
    assert LOW.holds(inputs(battery_v=11.0 + 1.1 * BATTERY_DEADBAND_V), is_on=True) is False


def test_they_are_worded_with_their_figures():
    assert describe_begin(LOW) == "the battery voltage of the base is below 11.00 V"
    assert describe_begin(BUMPED) == "the bumper of the base is pressed"
    assert (
        describe_verdict(LOW, inputs(battery_v=10.5), (), is_active=False) == "battery voltage 10.50 V, below 11.00 V"
    )
    assert (
        describe_verdict(BUMPED, inputs(is_bumped=True), (), is_active=False)
        == "the bumper of the base is pressed: yes"
    )


def test_a_base_says_why_it_must_not_drive():
    assert not BaseReport(at_s=0.0, is_bumped=False, is_at_cliff=False).why_not_drive
    assert BaseReport(at_s=0.0, is_bumped=True).why_not_drive == "its bumper is pressed"
    assert "no floor" in BaseReport(at_s=0.0, is_at_cliff=True).why_not_drive
    assert "hot" in BaseReport(at_s=0.0, errors=("its left motor is hot",)).why_not_drive
