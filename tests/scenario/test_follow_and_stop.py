"""The robot follows the ball through real serial bytes, and stops when it cannot see."""

import pytest

from stadimeter.app.guard import REST_S, RESTING
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import SafetyMode

STILL_BALL = """
path = [{ at = "0 s", x = "2.2 m", y = "0.5 m" }]
loop = false
"""


def wheels_stand(scenario):
    return all(abs(speed) < 1e-3 for speed in scenario.world.robot.wheels_mps)


@pytest.mark.long
def test_the_robot_drives_to_one_metre_from_the_ball_and_faces_it(scenario):
    run = scenario(STILL_BALL).run(15)
    track = run.records[-1].decision.tracks[0]
    assert run.world.distance_m() == pytest.approx(1.0, abs=0.05)
    assert track.distance_m == pytest.approx(run.world.distance_m(), abs=0.02)
    assert abs(track.bearing_rad) < 0.04
    assert wheels_stand(run)
    assert run.world.robot.ticks[0] > 3000, "the wheels of the emulated base really turned"


def test_hiding_the_ball_stops_the_robot_within_the_coasting_time(scenario):
    run = scenario(STILL_BALL)
    stood = []

    def hide():
        run.world.faults.target_hidden = True

    run.at(1.5, hide)
    run.at(3.0, lambda: stood.append(wheels_stand(run)))
    run.run(3.2)
    assert min(run.base_speeds(1.0, 1.5)) > 0.2
    assert set(run.base_speeds(1.9, 3.2)) == {0.0}
    assert stood == [True]
    assert ("ball", "target_lost") in run.events()


def test_freezing_the_camera_stops_the_robot_within_the_frame_age(scenario):
    run = scenario(STILL_BALL)

    def freeze():
        run.world.faults.camera_frozen = True

    run.at(1.5, freeze)
    run.run(4.0)
    assert set(run.base_speeds(1.75, 4.0)) == {0.0}
    assert wheels_stand(run)
    assert run.records[-1].decision.safety is SafetyMode.STALE
    assert ("camera", "fault") in run.events()


def test_a_camera_that_gives_nothing_at_all_stops_the_robot_as_well(scenario):
    run = scenario(STILL_BALL)

    def block():
        run.world.faults.camera_blocked = True

    run.at(1.5, block)
    run.run(4.0)
    assert set(run.base_speeds(1.85, 4.0)) == {0.0}
    assert wheels_stand(run)


@pytest.mark.long
def test_after_a_fault_the_robot_goes_on_when_it_sees_again(scenario):
    run = scenario(STILL_BALL + 'faults = [{ at = "1 s", for = "1 s", kind = "freeze-camera" }]\n').run(15)
    assert run.world.distance_m() == pytest.approx(1.0, abs=0.05)
    assert [kind for source, kind in run.events() if source == "camera"] == ["fault", "fault_cleared"]


def unplugged(scenario, base=""):
    run = scenario(STILL_BALL, base=base)

    def unplug():
        run.world.faults.base_unplugged = True

    def plug_in():
        run.world.faults.base_unplugged = False

    run.at(1.5, unplug)
    run.at(4.5, plug_in)
    return run


@pytest.mark.long
def test_a_base_that_is_unplugged_stops_by_itself_while_the_rest_goes_on(scenario):
    run = unplugged(scenario).run(4.4)
    assert ("base", "fault") in run.events()
    assert wheels_stand(run)
    motor = [command for command in run.records[-1].applied if command.output == "motor"]
    assert motor, "the motor still gets its commands"
    fault = run.records[-1].observation.output_faults[0]
    assert fault.output == "base"


@pytest.mark.long
def test_a_robot_that_bumps_into_something_stands_until_it_is_free_whatever_its_rules_want(scenario):
    world = STILL_BALL + 'faults = [{ at = "1.5 s", for = "1 s", kind = "press-bumper" }]\n'
    run = scenario(world, is_base_emulated=False).run(15)
    assert min(run.base_speeds(1.0, 1.5)) > 0.2
    assert set(run.base_speeds(1.6, 2.5)) <= {0.0}
    assert [kind for source, kind in run.events() if source == "base"] == ["fault", "fault_cleared"]
    assert run.world.distance_m() == pytest.approx(1.0, abs=0.05)


@pytest.mark.long
def test_a_base_that_is_plugged_in_again_is_identified_and_rests_before_it_drives_from_standstill(scenario):
    run = unplugged(scenario).run(20)
    events = [event for record in run.records for event in record.decision.events if event.source == "base"]
    assert [event.kind for event in events] == ["fault", "fault", "fault_cleared"]
    identified_s, allowed_s = events[1].at_s, events[2].at_s
    assert events[1].reason == RESTING
    assert 4.5 < identified_s <= allowed_s - REST_S < identified_s + 0.2
    assert run.base_speeds(1.6, allowed_s) == []
    assert run.base_speeds(allowed_s, allowed_s + 0.06)[0] < 0.1, "it sets off from standstill"
    assert run.world.distance_m() == pytest.approx(1.0, abs=0.05)
    assert {record.decision.safety for record in run.records if record.observation.now_s > 1} == {"active"}
    state = initial_state(run.loop.parts.configuration.plan)
    for record in run.records:
        state, decision = decide(state, record.observation)
        assert (decision.commands, decision.events) == (record.decision.commands, record.decision.events), "replayed"


@pytest.mark.long
def test_a_base_that_shall_stay_off_does_so_when_it_is_plugged_in_again(scenario):
    run = unplugged(scenario, base='after_fault = "stay_off"').run(20)
    assert run.base_speeds(1.6, 20) == []
    assert [kind for source, kind in run.events() if source == "base"] == ["fault"]


def test_at_the_end_of_a_run_the_wheels_stand(scenario):
    run = scenario(STILL_BALL).run(1.5)
    before_mps = run.base_speeds(1.4, 1.6)[-1]
    assert before_mps > 0.2
    assert all(0 <= speed_mps < before_mps / 2 for speed_mps in run.world.robot.wheels_mps), "they run down"
