"""Range sensors in a run: a target of their own, a second opinion on another, and what keeps the robot from bumping."""

import pytest

from stadimeter.core.decision import EventKind

BALL = 'path = [{ at = "0 s", x = "2.2 m", y = "0 m" }]\nloop = false\n'
FRONT = '[sensors.front]\ndriver = "simulated"\nmax_range = "4 m"\n'


def test_a_sensor_is_a_target_that_rules_may_watch(scenario):
    rule = '[rules.close]\nactuator = "buzzer"\npriority = 300\ntarget = "front"\nwhen = { below = "1.5 m" }\n'
    run = scenario(BALL + FRONT + rule).run(8)
    front = run.records[-1].decision.tracks[1]
    assert front.target == "front"
    assert front.distance_m == pytest.approx(run.world.distance_m() - 0.1, abs=0.02)
    assert ("close", "raised") in run.events()


@pytest.mark.long
def test_a_base_stands_while_something_is_nearer_than_its_sensor_allows_whatever_the_rules_want(scenario):
    run = scenario(BALL + FRONT + 'stop_below = "1.5 m"\n').run(15)
    assert run.world.distance_m() - 0.1 == pytest.approx(1.5, abs=0.1), "the rule wants to go on to 1 m"
    assert ("base", "fault") in run.events()


def test_a_sensor_that_falls_silent_stops_the_base_it_watches_over(scenario):
    faults = 'faults = [{ at = "1.5 s", for = "2 s", kind = "silence-sensors" }]\n'
    run = scenario(BALL + faults + FRONT + 'stop_below = "50 cm"\n').run(15)
    assert min(run.base_speeds(1.0, 1.5)) > 0.2
    assert set(run.base_speeds(1.7, 3.5)) <= {0.0}
    assert run.world.distance_m() == pytest.approx(1.0, abs=0.05), "it drives on when the sensor answers again"


def test_a_sensor_that_confirms_a_target_makes_it_surer(scenario):
    alone = scenario(BALL + FRONT).run(3).records[-1]
    joined = scenario(BALL + FRONT + 'confirms = "ball"\nto_centre = "10 cm"\n').run(3).records[-1]
    assert joined.decision.tracks[0].sigma_m < alone.decision.tracks[0].sigma_m
    assert joined.decision.tracks[0].distance_m == pytest.approx(alone.decision.tracks[0].distance_m, rel=0.02)


def test_a_sensor_that_contradicts_the_camera_is_an_event_and_changes_no_distance(scenario):
    run = scenario(BALL + FRONT + 'confirms = "ball"\nahead = "-60 cm"\nsigma = "1 mm"\n').run(3)
    kinds = [event.kind for record in run.records for event in record.decision.events if event.source == "front"]
    assert EventKind.FAULT in kinds
    assert run.records[-1].decision.tracks[0].distance_m == pytest.approx(run.world.distance_m(), abs=0.05)
