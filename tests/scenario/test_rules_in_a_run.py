"""Rules, messages and journals in whole runs."""

import json

import pytest

from support.simulated_run import SIMULATED_BALL

STANDING = (
    SIMULATED_BALL
    + """
[actuators.buzzer]
driver = "simulated"

[messenger]
driver = "simulated"

[rules.far]
actuator = "motor"
ramp = { from = "1.5 m", to = "3 m" }

[rules.near]
actuator = "buzzer"
when = { below = "50 cm" }

[world]
camera_height = "12 cm"
path = [
  { at = "0 s", x = "1 m", y = "0 m" },
  { at = "3 s", x = "3.5 m", y = "0 m" },
  { at = "6 s", x = "3.5 m", y = "0 m" },
  { at = "9 s", x = "0.4 m", y = "0 m" },
  { at = "11 s", x = "0.4 m", y = "0 m" },
  { at = "14 s", x = "1 m", y = "0 m" },
]
loop = false
"""
)


def levels(run, output, from_s, to_s):
    return [
        command.level
        for record in run.records
        if from_s <= record.observation.now_s < to_s
        for command in record.applied
        if command.output == output
    ]


@pytest.fixture
def standing(scenario):
    return lambda extra="": scenario(extra, text=STANDING)


def test_the_motor_grows_stronger_with_distance_and_the_buzzer_sounds_when_near(standing):
    run = standing().run(16)
    assert set(levels(run, "motor", 0, 0.3)) == {0.0}
    rising = levels(run, "motor", 1.2, 2.2)
    assert rising[0] < rising[len(rising) // 2] < rising[-1]
    assert set(levels(run, "motor", 4, 6)) == {1.0}
    assert set(levels(run, "motor", 9, 16)) == {0.0}
    assert set(levels(run, "buzzer", 0, 8)) == {0.0}
    assert set(levels(run, "buzzer", 9.5, 11)) == {1.0}
    assert set(levels(run, "buzzer", 15, 16)) == {0.0}
    assert [event for event in run.events() if event[0] == "near"] == [("near", "raised"), ("near", "cleared")]


def test_the_broker_hears_of_every_alarm_and_of_the_distance_at_most_twice_a_second(standing):
    run = standing().run(16)
    alarms = [json.loads(s.item.payload) for s in run.loop.parts.messenger.sent if s.item.topic == "event/alarm"]
    assert [(alarm["rule"], alarm["event_type"]) for alarm in alarms] == [("near", "raised"), ("near", "cleared")]
    states = [s.at_s for s in run.loop.parts.messenger.sent if s.item.topic == "target/ball/state"]
    assert 20 <= len(states) <= 2 * 16 + 3
    last = [json.loads(s.item.payload) for s in run.loop.parts.messenger.sent if s.item.topic == "target/ball/state"][
        -1
    ]
    assert last["distance_m"] == pytest.approx(run.world.distance_m(), abs=0.02)


def test_a_broker_that_is_away_does_not_change_a_single_decision(standing):
    near, away = standing(), standing('faults = [{ at = "2 s", for = "9 s", kind = "broker-gone" }]\n')
    near.run(16)
    said = []
    away.at(5.0, lambda: said.append(away.loop.trouble()))
    away.run(16)
    assert [record.decision for record in near.records] == [record.decision for record in away.records]
    assert "broker" in said[0]
    alarms = [s.at_s for s in away.loop.parts.messenger.sent if s.item.topic == "event/alarm"]
    assert len(alarms) == 2, "what was raised meanwhile is told when the broker is back"


@pytest.mark.long
def test_two_runs_are_the_same(standing):
    first, second = standing().run(10), standing().run(10)
    assert [(r.observation, r.decision, r.applied) for r in first.records] == [
        (r.observation, r.decision, r.applied) for r in second.records
    ]


def test_every_command_that_moves_something_names_a_fresh_frame(standing):
    run = standing('faults = [{ at = "4 s", for = "1 s", kind = "freeze-camera" }]\n').run(6)
    for record in run.records:
        for command in record.applied:
            if command.level:
                assert record.observation.now_s - command.captured_at_s <= 0.2 + 1e-6
    assert set(levels(run, "motor", 4.3, 5.0)) == {0.0}
