"""The robot follows the ball through real serial bytes, and stops when it cannot see."""

import pytest

from stadimeter.core.decision import SafetyMode

STILL_BALL = """
path = [{ at = "0 s", x = "2.2 m", y = "0.5 m" }]
loop = false
"""


def wheels_stand(scenario):
    return all(abs(speed) < 1e-3 for speed in scenario.world.robot.wheels_mps)


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


def test_after_a_fault_the_robot_goes_on_when_it_sees_again(scenario):
    run = scenario(STILL_BALL + 'faults = [{ at = "1 s", for = "1 s", kind = "freeze-camera" }]\n').run(15)
    assert run.world.distance_m() == pytest.approx(1.0, abs=0.05)
    assert [kind for source, kind in run.events() if source == "camera"] == ["fault", "fault_cleared"]


def test_a_base_that_is_unplugged_stops_by_itself_and_stays_off_while_the_rest_goes_on(scenario):
    run = scenario(STILL_BALL)

    def unplug():
        run.world.faults.base_unplugged = True

    def plug_in():
        run.world.faults.base_unplugged = False

    run.at(1.5, unplug)
    run.at(5.0, plug_in)
    run.run(8)
    assert ("base", "fault") in run.events()
    assert wheels_stand(run)
    assert run.base_speeds(5.0, 8) == []
    motor = [command for command in run.records[-1].applied if command.output == "motor"]
    assert motor, "the motor still gets its commands"
    fault = run.records[-1].observation.output_faults[0]
    assert fault.output == "base"


def test_at_the_end_of_a_run_the_wheels_stand(scenario):
    run = scenario(STILL_BALL).run(1.5)
    before_mps = run.base_speeds(1.4, 1.6)[-1]
    assert before_mps > 0.2
    assert all(0 <= speed_mps < before_mps / 2 for speed_mps in run.world.robot.wheels_mps), "they run down"
