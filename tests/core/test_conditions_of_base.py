"""Conditions that watch no target: what the base reports, alarms that wait, and the order of rules."""

import pytest
from msgspec.structs import replace

from stadimeter.app.persistence.resumption import read_state, state_text
from stadimeter.core.command import BaseReport
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.evidence import describe_verdict
from stadimeter.core.conditions.leaf import RuleInputs
from stadimeter.core.conditions.of_rules import (
    BATTERY_DEADBAND_V,
    BatteryCondition,
    ContactSensorCondition,
    SequenceCondition,
    UndeliveredCondition,
)
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.persistence import restore_alarms, snapshot_alarms
from stadimeter.core.plan import Plan, Safety, Tracking
from stadimeter.core.rule import AlarmRule
from support.each_case import each_case
from support.observing import measured

# Conditions on what the base reports: its bumper, what is below it, its battery.

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


def test_a_base_says_why_it_must_not_drive():
    assert not BaseReport(at_s=0.0, is_bumped=False, is_at_cliff=False).why_not_drive
    assert BaseReport(at_s=0.0, is_bumped=True).why_not_drive == "its bumper is pressed"
    assert "no floor" in BaseReport(at_s=0.0, is_at_cliff=True).why_not_drive
    assert "hot" in BaseReport(at_s=0.0, errors=("its left motor is hot",)).why_not_drive


# Whether an alarm has not reached those who are to hear of it.

LATE = UndeliveredCondition(for_s=5.0)


def waiting_since(since_s, now_s=100.0):
    return RuleInputs(tracks={}, now_s=now_s, undelivered_since_s=since_s)


@pytest.mark.parametrize(
    ("since_s", "holds"), [(None, False), (100.0, False), (95.1, False), (95.0, True), (0.0, True)]
)
def test_it_holds_while_an_alarm_has_waited_for_its_time(since_s, holds):
    assert LATE.holds(waiting_since(since_s), is_on=False) is holds


# The order in which rules were raised.

LEFT, RIGHT = (
    AlarmRule(name=name, target=name, condition=DistanceCondition(below=1.0), off_delay_s=0.0)
    for name in ("left", "right")
)
ORDER = SequenceCondition(rules=("left", "right"), within_s=2.0)


class Run:
    """A run of two balls, at 10 Hz."""

    def __init__(self, condition=ORDER):
        order = AlarmRule(name="order", target="left", condition=condition, off_delay_s=0.0)
        tracking = Tracking(confirm_frames=1, outliers_max=0, acceleration_mps2=500.0, autocorrelation=0.0)
        self.plan = Plan(
            targets=("left", "right"), rules=(order, LEFT, RIGHT), tracking=tracking, safety=Safety(good_frames=1)
        )
        self.state = initial_state(self.plan)
        self.now_s, self.frames = 0.0, 0

    def see(self, left_m, right_m, for_s=0.5):
        """Return whether the order is active after some time in which the balls stand there."""
        for _ in range(round(for_s * 10)):
            self.now_s = round(self.now_s + 0.1, 9)
            self.frames += 1
            seen = (measured("left", self.now_s, left_m, 0.001), measured("right", self.now_s, right_m, 0.001))
            stamp = FrameStamp(sequence=self.frames, captured_at_s=self.now_s)
            observation = Observation(now_s=self.now_s, frame=stamp, measurements=seen)
            self.state, self.decision = decide(self.state, observation)
        return self.decision.rules[0].active


FAR, CLOSE = 3.0, 0.5


def test_it_holds_from_the_last_raise_on_while_the_last_rule_is_active():
    run = Run()
    assert run.see(FAR, FAR) is False
    assert run.see(CLOSE, FAR) is False
    assert run.see(CLOSE, CLOSE) is True
    assert run.see(FAR, CLOSE, 5.0) is True
    assert run.see(FAR, FAR) is False


@pytest.mark.parametrize(
    ("scenes", "is_ordered"),
    [
        pytest.param([(FAR, CLOSE), (CLOSE, CLOSE, 5.0)], False, id="the other order"),
        pytest.param([(CLOSE, FAR, 3.0), (CLOSE, CLOSE)], False, id="one that takes too long"),
        pytest.param([(CLOSE, CLOSE, 3.0)], False, id="both in one picture"),
        pytest.param([(CLOSE, FAR), (FAR, FAR), (FAR, CLOSE)], True, id="the first is over when the last comes"),
        pytest.param([(CLOSE, FAR), (FAR, CLOSE), (CLOSE, CLOSE)], True, id="the first comes again"),
        pytest.param([(CLOSE, FAR), (FAR, CLOSE), (FAR, FAR, 3.0), (FAR, CLOSE)], False, id="the last alone again"),
    ],
)
def test_only_a_rule_that_is_raised_after_the_other_in_time_is_in_order(scenes, is_ordered):
    run = Run()
    run.see(FAR, FAR)
    assert [run.see(*scene) for scene in scenes][-1] is is_ordered


def test_with_a_time_it_holds_for_that_long_whatever_comes():
    run = Run(replace(ORDER, for_s=2.0))
    run.see(FAR, FAR)
    run.see(CLOSE, FAR)
    assert run.see(FAR, CLOSE) is True
    assert run.see(FAR, FAR, 1.0) is True
    assert run.see(FAR, FAR, 1.0) is False
    run = Run(replace(ORDER, for_s=1.0))
    run.see(FAR, FAR)
    run.see(CLOSE, FAR)
    assert run.see(FAR, CLOSE, 3.0) is False


def test_it_is_remembered_beyond_a_restart_and_in_a_recording():
    run = Run()
    run.see(FAR, FAR)
    run.see(CLOSE, FAR)
    run.see(CLOSE, CLOSE)
    begun = initial_state(run.plan)
    recorded = read_state(state_text(run.state), begun)
    assert recorded.rules.raised_at_s == run.state.rules.raised_at_s
    snapshot = snapshot_alarms(run.state)
    run.state = restore_alarms(begun, snapshot, shift_s=100.0, from_s=run.now_s + 100, now_s=run.now_s + 100)
    run.now_s += 100.0
    assert run.see(CLOSE, CLOSE) is True
