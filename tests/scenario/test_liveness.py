"""A robot whose camera only pretends to be live stops, and one that drives through a room that can be seen does not."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import EventKind, SafetyMode
from stadimeter.operator_actions import OperatorAction, OperatorCommand
from support.changed_pictures import KINDS, NEVER_TWICE, ChangedCamera
from support.programs import require

ROOM = """
[camera]
driver = "simulated"
rate = "30 Hz"
room = "textured"

[camera.model]
width_px = 320
height_px = 240
fx_px = 300.0

[targets.ball]
detector = "ball"
diameter = "20 cm"
hsv = "29,86,6:64,255,255"

[base]
driver = "simulated"

[rules.follow]
actuator = "base"
follow = { distance = "1 m", max_speed = "0.3 m/s" }

[world]
camera_height = "12 cm"
ticks_per_metre = 3917.7
"""

# The same robot with a base that reports its wheels five times a second, and whose wheels run down in 0.3 s.
EMULATED = """[base]
driver = "ros-arduino-bridge"
port = "emulated-ros-arduino-bridge"
wheel_diameter = "6.5 cm"
ticks_per_turn = 800
track_width = "20 cm"
"""
WITH_FIRMWARE = ROOM.replace('[base]\ndriver = "simulated"\n', EMULATED)

# A ball that keeps ahead of a robot of 0.3 m/s, one that stands aside, and one in a picture that makes it turn.
AHEAD = 'path = [{ at = "0 s", x = "2.5 m", y = "0 m" }, { at = "20 s", x = "9 m", y = "1 m" }]\nloop = false\n'
ASIDE = 'path = [{ at = "0 s", x = "3 m", y = "0.9 m" }]\nloop = false\n'

FROZEN_S = 2.0
WITHIN_S = 0.5

Run = Callable[..., Any]


def path_of(points: Sequence[tuple[float, float, float]]) -> str:
    places = ", ".join(f'{{ at = "{at_s:.2f} s", x = "{x:.2f} m", y = "{y:.2f} m" }}' for at_s, x, y in points)
    return f"path = [{places}]\nloop = false\n"


def room(rate_hz: int, noise: float, speed_mps: float) -> str:
    text = ROOM.replace('"30 Hz"', f'"{rate_hz} Hz"\nnoise = {noise}')
    return text.replace('max_speed = "0.3 m/s"', f'max_speed = "{speed_mps:.2f} m/s"')


def set_knob(run: Any, knob: str, value: bool) -> Callable[[], None]:
    return lambda: setattr(run.world.faults, knob, value)


def wheels_stand(run: Any) -> bool:
    return all(abs(speed) < 1e-3 for speed in run.world.robot.wheels_mps)


def reasons(run: Any, kind: EventKind) -> list[str]:
    return [each.reason for record in run.records for each in record.decision.events if each.kind is kind]


KNOBS = pytest.mark.parametrize("knob", ["frozen_under_clock", "frozen_under_noise"])


@pytest.mark.long
@pytest.mark.parametrize("path", [AHEAD, ASIDE], ids=["ahead", "aside"])
@KNOBS
def test_the_wheels_stand_half_a_second_after_the_sensor_froze(scenario: Run, knob: str, path: str) -> None:
    run = scenario(path, text=ROOM)
    stood: list[bool] = []
    run.at(FROZEN_S, set_knob(run, knob, True))
    run.at(FROZEN_S + WITHIN_S, lambda: stood.append(wheels_stand(run)))
    run.run(4.0)
    assert min(run.base_speeds(FROZEN_S - 0.2, FROZEN_S)) > 0.1
    assert stood == [True]
    assert wheels_stand(run)
    assert run.records[-1].decision.safety is SafetyMode.DISARMED
    assert [words for words in reasons(run, EventKind.DISARMED) if "the picture stands still" in words]
    state = initial_state(run.loop.parts.configuration.plan)
    for record in run.records:
        state, decision = decide(state, record.observation)
        assert (decision.commands, decision.events) == (record.decision.commands, record.decision.events), "replayed"


@pytest.mark.long
@KNOBS
def test_a_base_with_firmware_is_told_to_stand_and_its_wheels_run_down(scenario: Run, knob: str) -> None:
    run = scenario(AHEAD, text=WITH_FIRMWARE)
    speeds_mps: list[float] = []
    run.at(FROZEN_S, set_knob(run, knob, True))
    run.at(FROZEN_S + WITHIN_S, lambda: speeds_mps.extend(run.world.robot.wheels_mps))
    run.run(4.0)
    assert min(run.base_speeds(FROZEN_S - 0.2, FROZEN_S)) > 0.1
    assert set(run.base_speeds(FROZEN_S + 0.35, 4.0)) == {0.0}
    assert max(speeds_mps) < 0.1, "it runs down"
    assert wheels_stand(run)


def test_a_sensor_that_is_frozen_from_the_start_stops_the_robot_soon_after_its_wheels_begin_to_turn(
    scenario: Run,
) -> None:
    run = scenario(AHEAD, text=ROOM)
    run.at(0.05, set_knob(run, "frozen_under_noise", True))
    run.run(3.0)
    moved = [record.observation.now_s for record in run.records if speed_mps(record) > 0]
    assert moved
    assert moved[-1] - moved[0] <= WITHIN_S
    assert wheels_stand(run)


def speed_mps(record: Any) -> float:
    return max((abs(command.linear_mps) for command in record.applied), default=0.0)


@pytest.mark.long
def test_a_robot_that_follows_through_a_room_drives_on(scenario: Run) -> None:
    run = scenario(AHEAD, text=ROOM).run(12.0)
    assert reasons(run, EventKind.DISARMED) == []
    assert reasons(run, EventKind.LIVENESS_UNKNOWN) == []
    assert run.records[-1].decision.safety is SafetyMode.ACTIVE
    assert run.world.robot.ticks[0] > 5000


def test_once_the_sensor_works_again_the_robot_drives_when_it_is_armed_and_not_before(scenario: Run) -> None:
    run = scenario(AHEAD, text=ROOM)
    arm = OperatorCommand(id="1", action=OperatorAction.ARM, by="Ada")
    run.at(1.5, set_knob(run, "frozen_under_clock", True))
    run.at(2.5, set_knob(run, "frozen_under_clock", False))
    run.run(3.5)
    assert wheels_stand(run)
    state = initial_state(run.loop.parts.configuration.plan)
    for record in run.records:
        state, _ = decide(state, record.observation)
    last = run.records[-1].observation
    state, decision = decide(state, type(last)(now_s=last.now_s + 0.001, base=last.base, operator_commands=(arm,)))
    assert [each.kind for each in decision.events] == [EventKind.ARMED]
    assert decision.safety is SafetyMode.ACTIVE


def test_a_room_too_plain_to_tell_is_said_when_outputs_may_act(scenario: Run) -> None:
    run = scenario(AHEAD, text=ROOM.replace('"textured"', '"plain"')).run(2.0)
    (words,) = reasons(run, EventKind.LIVENESS_UNKNOWN)
    assert "a frozen picture looks like a live one" in words
    assert reasons(run, EventKind.DISARMED) == []
    assert max(run.base_speeds(0.5, 2.0)) > 0.2


def test_in_a_plain_room_a_robot_that_turns_at_a_frozen_picture_stops_all_the_same(scenario: Run) -> None:
    far_aside = 'path = [{ at = "0 s", x = "2.5 m", y = "1.1 m" }]\nloop = false\n'
    run = scenario(far_aside, text=ROOM.replace('"textured"', '"plain"'))
    run.at(0.1, set_knob(run, "frozen_under_noise", True))
    run.run(12.0)
    (words,) = reasons(run, EventKind.DISARMED)
    assert "'ball' stays in its place in the picture, however the robot turns" in words
    assert wheels_stand(run)


def test_with_liveness_switched_off_nothing_is_judged(scenario: Run) -> None:
    run = scenario("", text=ROOM + AHEAD + "\n[safety]\nliveness = false\n")
    run.at(FROZEN_S, set_knob(run, "frozen_under_noise", True))
    run.run(3.0)
    assert all(record.observation.flow is None for record in run.records)
    assert min(run.base_speeds(2.5, 3.0)) > 0.2


@pytest.mark.long
@pytest.mark.parametrize("number", range(4))
def test_in_rooms_with_texture_a_robot_that_follows_is_not_stopped(scenario: Run, number: int) -> None:
    """A ball wanders about for five minutes; noise, speed and path are others in each run."""
    rng = np.random.default_rng((number, 12))
    points, at_s, place_m = [(0.0, 1.5, 0.0)], 0.0, np.array([1.5, 0.0])
    while at_s < 300.0:
        at_s += rng.uniform(1.5, 6.0)
        way_m = rng.uniform(-4.0, 4.0, 2) - place_m
        place_m = place_m + way_m * min(1.0, rng.uniform(0.3, 1.5) / float(np.hypot(*way_m)))
        points.append((at_s, *place_m))
    text = room(15, rng.uniform(0.5, 5.0), rng.uniform(0.1, 0.45)) + f"seed = {number + 100}\n"
    text = text.replace('"ball"\ndiameter = "20 cm"\nhsv = "29,86,6:64,255,255"', '"ideal"')
    run = scenario(path_of(points), text=text).run(300.0)
    assert reasons(run, EventKind.DISARMED) == []
    assert reasons(run, EventKind.LIVENESS_UNKNOWN) == []
    assert sum(is_driven(record) for record in run.records) / 15 > 60


def is_driven(record: Any) -> bool:
    return any(abs(each.linear_mps) + abs(each.angular_radps) > 0.02 for each in record.applied)


@pytest.mark.long
@pytest.mark.parametrize("is_turning", [False, True], ids=["ahead", "turning"])
@pytest.mark.parametrize("kind", [each for each in KINDS if each != NEVER_TWICE])
def test_old_pictures_in_which_something_changes_stop_a_robot_within_two_seconds(
    scenario: Run, kind: str, is_turning: bool
) -> None:
    if "H.264" in kind:
        require("ffmpeg")
    rng = np.random.default_rng((2, 13))
    text = room(30, rng.uniform(0.5, 5.0), rng.uniform(0.1, 0.4))
    path = circling(rng) if is_turning else ahead(rng)
    fails_s = rng.uniform(3.0, 4.5)
    elsewhere = taken_by(scenario(path + "seed = 503\n", text=text)) if "elsewhere" in kind else []
    run = scenario(path + "seed = 3\n", text=text)
    change(run, kind, fails_s, elsewhere)
    run.run(fails_s + 6.0)
    driven_s = [record.observation.now_s for record in run.records if is_driven(record)]
    assert fails_s - 0.2 < driven_s[-1] <= fails_s + 2.0


def ahead(rng: np.random.Generator) -> str:
    aside_rad, begin_m, end_m = rng.uniform(-0.35, 0.35), rng.uniform(2.0, 3.5), rng.uniform(8.0, 12.0)
    x, y = math.cos(aside_rad), math.sin(aside_rad)
    return path_of([(0.0, begin_m * x, begin_m * y), (20.0, end_m * x, end_m * y)])


def circling(rng: np.random.Generator) -> str:
    radius_m, turn_radps = rng.uniform(1.2, 2.5), rng.choice((-1, 1)) * rng.uniform(0.2, 0.6)
    times_s = np.arange(0.0, 20.0, 0.5)
    return path_of([(at, radius_m * math.cos(turn_radps * at), radius_m * math.sin(turn_radps * at)) for at in times_s])


def change(run: Any, kind: str, fails_s: float, elsewhere: Sequence[Any]) -> ChangedCamera:
    capture = run.loop.parts.capture
    capture._camera = ChangedCamera(capture._camera, kind, fails_s, elsewhere)
    return capture._camera


def taken_by(run: Any) -> Sequence[Any]:
    camera = change(run, NEVER_TWICE, math.inf, [])
    run.run(12.0)
    return camera.taken
