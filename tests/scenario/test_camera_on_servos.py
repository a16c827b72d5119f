"""A camera on servos turns and tilts with its target through the whole program, and stands whenever it should."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from statistics import fmean
from typing import Any

import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.core.decision import EventKind, SafetyMode
from stadimeter.errors import ConfigError
from support.simulated_run import LENS

# A camera on a servo turns with its target through the whole program, and stands whenever it should.

PAGE = (Path(__file__).parents[2] / "docs" / "robots" / "pan-servo.md").read_text(encoding="utf-8")
(GUIDE,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
SIMULATED = GUIDE.replace('port = "/dev/i2c-1"', 'port = "emulated-pca9685"')

# From straight ahead to 40° on the left, to 40° on the right and back, 2 m away, at up to 20° a second.
SWAYS = """
[world]
path = [
  { at = "0 s", x = "2 m", y = "0 m" },
  { at = "4 s", x = "1.5 m", y = "1.3 m" },
  { at = "12 s", x = "1.5 m", y = "-1.3 m" },
  { at = "16 s", x = "2 m", y = "0 m" },
]
"""


def with_world(world: str = SWAYS, guide: str = SIMULATED) -> str:
    camera = f'[camera]\ndriver = "simulated"\nrate = "30 Hz"\nrender = false\n{LENS}\n'
    target = '[targets.ball]\ndetector = "ideal"\n'
    return camera + target + guide + world


def heading_deg(run: Any) -> float:
    return math.degrees(run.world.robot.pose.heading_rad)


def test_a_target_that_walks_by_stays_in_the_middle_of_the_view(scenario: Callable[..., Any]) -> None:
    run = scenario(text=with_world())
    bearings_deg: list[float] = []
    headings_deg: list[float] = []

    def look(_now_s: float) -> None:
        x_m, _, z_m = run.world.target_in_camera()
        bearings_deg.append(math.degrees(math.atan2(x_m, z_m)))
        headings_deg.append(heading_deg(run))

    run.loop.parts.clock.call_every(0.02, look)
    run.run(16.0)
    after_start = bearings_deg[100:]
    assert max(map(abs, after_start)) < 6.0
    assert max(headings_deg) > 36.0
    assert min(headings_deg) < -36.0
    x_m, y_m = run.world.robot.pose.x_m, run.world.robot.pose.y_m
    assert math.hypot(x_m, y_m) < 1e-6, "it drives nowhere"


def test_a_target_that_has_left_is_looked_for_within_the_travel_of_the_servo(scenario: Callable[..., Any]) -> None:
    gone = (
        '[world]\nloop = false\npath = [{ at = "0 s", x = "2 m", y = "0 m" }, { at = "3 s", x = "1.5 m", y = "1 m" }, '
        '{ at = "3.5 s", x = "-1.5 m", y = "3 m" }]\n'
    )
    run = scenario(text=with_world(gone))
    headings_deg: list[float] = []
    run.loop.parts.clock.call_every(0.02, lambda _now_s: headings_deg.append(heading_deg(run)))
    run.run(30.0)
    assert max(headings_deg) == pytest.approx(80.0, abs=1.0)
    events = [event.kind for record in run.records for event in record.decision.events]
    assert events.count("search_begun") == events.count("search_ended") == 1
    assert headings_deg[-200:] == pytest.approx([headings_deg[-1]] * 200, abs=0.01)


def test_a_rule_that_would_drive_it_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    path.write_text(with_world(guide=SIMULATED.replace('max_speed = "0 m/s"', 'max_speed = "0.1 m/s"')))
    with pytest.raises(ConfigError, match="turns and drives nowhere"):
        load_configuration(path)


# A camera that turns and tilts keeps its target in the middle of the view, and a tilt upsets nothing else.

GUIDE_THAT_TILTS = GUIDE.replace("#tilt", "tilt")

# From level to 29° up, to 6° down and back in 8 s, 2 m away: by up to 21° a second.
BOBS = """
[world]
path = [
  { at = "0 s", x = "2 m", y = "0 m", z = "0.25 m" },
  { at = "2 s", x = "2 m", y = "0 m", z = "1.25 m" },
  { at = "6 s", x = "2 m", y = "0 m", z = "0.05 m" },
  { at = "8 s", x = "2 m", y = "0 m", z = "0.25 m" },
]
"""
# Likewise from side to side.
SWAYS_HIGH = """
[world]
path = [
  { at = "0 s", x = "2 m", y = "0 m", z = "0.5 m" },
  { at = "3 s", x = "1.5 m", y = "1.2 m", z = "1.5 m" },
  { at = "9 s", x = "1.5 m", y = "-1.2 m", z = "1 m" },
  { at = "12 s", x = "2 m", y = "0 m", z = "0.5 m" },
]
"""
# Rising without end, as far as the travel of the servo goes.
RISES = """
[world]
loop = false
path = [{ at = "0 s", x = "2 m", y = "0 m", z = "0.25 m" }, { at = "6 s", x = "2 m", y = "0 m", z = "2.4 m" }]
"""
TRAVEL_DEG = 40.0


def with_tilting(world: str = BOBS, latency_ms: int = 30, camera: str = "render = false", search: str = "") -> str:
    guide = GUIDE_THAT_TILTS.replace('port = "/dev/i2c-1"', 'port = "emulated-pca9685"').replace(
        "distance =", f"{search}distance ="
    )
    head = f'[camera]\ndriver = "simulated"\nrate = "30 Hz"\nlatency = "{latency_ms} ms"\n{camera}\n{LENS}\n'
    # With the latency of an IP camera, frames may be older than usual.
    safety = '[safety]\nmax_frame_age = "300 ms"\n'
    return f'{head}[targets.ball]\ndetector = "ideal"\n{guide}\n{safety}{world}'


def elevation_deg(run: Any) -> float:
    x_m, y_m, z_m = run.world.target_in_camera()
    return math.degrees(math.atan2(-y_m, math.hypot(x_m, z_m)))


def tilt_deg(run: Any) -> float:
    return math.degrees(run.world.tilt_joint.pose.heading_rad)


def watched(run: Any, figure: Callable[[Any], float]) -> list[float]:
    """Return what a figure will have been every 20 ms once the run is over."""
    figures: list[float] = []
    run.loop.parts.clock.call_every(0.02, lambda _now_s: figures.append(figure(run)))
    return figures


def disarmed(run: Any) -> list[str]:
    return [each.reason for record in run.records for each in record.decision.events if each.kind is EventKind.DISARMED]


@pytest.mark.long
@pytest.mark.parametrize(("latency_ms", "rms_deg", "most_deg"), [(30, 1.6, 4.0), (190, 3.5, 7.0)])
def test_a_target_that_moves_up_and_down_stays_near_the_middle_of_the_view(
    scenario: Callable[..., Any], latency_ms: int, rms_deg: float, most_deg: float
) -> None:
    run = scenario(text=with_tilting(latency_ms=latency_ms))
    elevations_deg, tilts_deg = watched(run, elevation_deg), watched(run, tilt_deg)
    run.run(24.0)
    after_start = elevations_deg[150:]
    assert math.sqrt(fmean(each**2 for each in after_start)) < rms_deg
    assert max(map(abs, after_start)) < most_deg
    assert max(tilts_deg) > 25.0
    rates_radps = [command.tilt_radps for record in run.records for command in record.applied]
    assert max(map(abs, rates_radps)) <= math.radians(60) + 1e-9
    commanded = [record.decision.commands[0].tilt_radps for record in run.records]
    faster = [abs(after) - abs(before) for before, after in pairwise(commanded)]
    assert max(faster) <= 4.0 / 30 + 0.02, "it speeds up no faster than turn_acceleration"


@pytest.mark.long
def test_it_turns_after_a_target_high_above_it_as_far_as_that_goes_round(scenario: Callable[..., Any]) -> None:
    run = scenario(text=with_tilting(SWAYS_HIGH))

    def bearing_deg(run: Any) -> float:
        x_m, _, z_m = run.world.target_in_camera()
        return math.degrees(math.atan2(x_m, z_m))

    bearings_deg, elevations_deg = watched(run, bearing_deg), watched(run, elevation_deg)
    run.run(24.0)
    assert max(map(abs, bearings_deg[150:])) < 5.0
    assert max(map(abs, elevations_deg[150:])) < 4.0


@pytest.mark.parametrize("fault", ["camera_blocked", "camera_frozen", "target_hidden"])
@pytest.mark.parametrize("part", ["pan", "tilt"])
def test_the_camera_stands_within_half_a_second_after_something_went_wrong(
    scenario: Callable[..., Any], part: str, fault: str
) -> None:
    if part == "pan":
        text, angle_deg = with_world(guide=SIMULATED.replace("max_speed", 'search = "off", max_speed')), heading_deg
    else:
        text, angle_deg = with_tilting(search='search = "off", '), tilt_deg
    run = scenario(text=text)
    stood: list[float] = []
    at_fault_s = {"pan": 3.0, "tilt": 3.5}[part]
    run.at(at_fault_s, lambda: setattr(run.world.faults, fault, True))
    for later_s in (-0.7, -0.1, 0.5, 3.0):
        run.at(at_fault_s + later_s, lambda: stood.append(angle_deg(run)))
    run.run(at_fault_s + 3.5)
    before, at_fault, soon, later = stood
    assert abs(at_fault - before) > 3.0, "it turned"
    assert later == pytest.approx(soon, abs=0.01)


def test_while_it_searches_it_stays_tilted_as_it_was(scenario: Callable[..., Any]) -> None:
    run = scenario(text=with_tilting(SWAYS_HIGH))
    seen: list[float] = []
    run.at(4.0, lambda: setattr(run.world.faults, "target_hidden", True))
    for at_s in (4.6, 12.0):
        run.at(at_s, lambda: seen.append(tilt_deg(run)))
    run.run(13.0)
    events = [event.kind for record in run.records for event in record.decision.events]
    assert "search_begun" in events
    assert seen[0] > 20.0
    assert seen[1] == pytest.approx(seen[0], abs=0.01)


# Liveness by motion


IN_A_ROOM = 'room = "textured"'


@pytest.mark.long
@pytest.mark.parametrize("world", [BOBS, SWAYS_HIGH], ids=["up and down", "high from side to side"])
def test_a_camera_that_tilts_is_not_taken_for_a_frozen_one(scenario: Callable[..., Any], world: str) -> None:
    run = scenario(text=with_tilting(world, camera=IN_A_ROOM)).run(13.0)
    assert disarmed(run) == []
    assert run.records[-1].decision.safety is SafetyMode.ACTIVE


@pytest.mark.long
@pytest.mark.parametrize("knob", ["frozen_under_clock", "frozen_under_noise"])
def test_a_picture_that_freezes_while_it_turns_is_found_tilted_as_well(scenario: Callable[..., Any], knob: str) -> None:
    run = scenario(text=with_tilting(SWAYS_HIGH, camera=IN_A_ROOM))
    run.at(5.5, lambda: setattr(run.world.faults, knob, True))
    run.run(7.0)
    assert [words for words in disarmed(run) if "the picture stands still" in words]


@pytest.mark.long
def test_of_a_picture_that_freezes_while_it_only_tilts_nothing_is_claimed_and_it_ends_with_its_travel(
    scenario: Callable[..., Any],
) -> None:
    run = scenario(text=with_tilting(RISES, camera=IN_A_ROOM))
    tilts_deg = watched(run, tilt_deg)
    run.at(1.5, lambda: setattr(run.world.faults, "frozen_under_noise", True))
    run.run(8.0)
    assert disarmed(run) == []
    assert max(tilts_deg) <= TRAVEL_DEG + 0.5
    assert tilts_deg[-1] == pytest.approx(tilts_deg[-50], abs=0.01)
