"""Rules, sensors and several targets in whole runs."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from stadimeter.app.recordings.journal import read_journal
from stadimeter.cli.main import app
from stadimeter.config.loader import load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.decision import EventKind
from stadimeter.workbench.rule_tests import run_rule_test
from support.recordings import records_of
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.cut_sheet import GroupTarget
from support.scenes.render import render
from support.scenes.scene import Scene
from support.simulated_run import SIMULATED_BALL

pytestmark = [pytest.mark.vision, pytest.mark.timeout(180)]


# Rules, messages and journals in whole runs.

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


# Range sensors in a run: a target of their own, a second opinion on another, and what keeps the robot from bumping.

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


FRAMES, JUMP_AT = 36, 24


# Several balls in a whole run: each keeps its name, and rules see the nearest, any, all, and how many there are.

LENS = CameraModel.with_focal_length(600.0, 640, 480)
LEFT, RIGHT, NEAR_RIGHT = (-0.3, 0.0, 1.6), (0.4, 0.05, 2.0), (0.3, 0.05, 1.0)

CONFIGURATION = """
[camera]
driver = "images"
paths = ["*.png"]
rate = "10 Hz"
dwell = "2 s"
[camera.model]
width_px = 640
height_px = 480
fx_px = 600.0
[targets.balls]
detector = "ball"
diameter = "20 cm"
hsv = "20,60,40:50,255,255"
count = 3
[actuators.buzzer]
driver = "simulated"
[world]
[rules.one-near]
when = { any_of = "balls", below = "1.2 m" }
[rules.all-far]
when = { all_of = "balls", lost = true }
[rules.both]
when = { count = { of = ["balls"], at_least = 2 } }
[rules.nearest]
actuator = "buzzer"
target = "balls-nearest"
ramp = { from = "1.5 m", to = "50 cm" }
"""


def _picture(path: Path, *places: tuple[float, float, float]) -> None:
    first, *others = (BallTarget(position_m=place, diameter_m=0.2) for place in sorted(places, key=lambda at: at[2]))
    target = GroupTarget(first=first, others=tuple(others)) if others else first
    cv2.imwrite(str(path), render(Scene(camera=LENS, target=target, seed=1, backdrop=PlainBackdrop())).image)


@pytest.mark.long
def test_each_keeps_its_name_and_rules_see_the_nearest_any_and_how_many(tmp_path: Path) -> None:
    _picture(tmp_path / "1-both-far.png", LEFT, RIGHT)
    _picture(tmp_path / "2-one-near.png", LEFT, NEAR_RIGHT)
    _picture(tmp_path / "3-one-left.png", LEFT)
    file, journal = tmp_path / "several.toml", tmp_path / "journal.jsonl"
    file.write_text(CONFIGURATION, encoding="utf-8")
    given = ["run", str(file), "--no-state", "--speed", "0", "--journal", str(journal)]
    told = CliRunner().invoke(app, given)
    assert told.exit_code == 0, told.output
    records = list(records_of(read_journal(journal)))
    raised = [event.source for record in records for event in record.decision.events if event.kind is EventKind.RAISED]
    assert raised == ["both", "one-near"], "all of them were never gone"
    last = {track.target: track for track in records[-1].decision.tracks}
    assert last["balls-1"].is_valid, "the ball at the left has kept its name"
    assert last["balls-nearest"].distance_m == last["balls-1"].distance_m
    levels = [record.decision.commands[0].level for record in records]
    assert max(levels) == pytest.approx(0.45, abs=0.05), "1.05 m on the way from 1.5 m to 50 cm"
    assert levels[-1] == 0.0


# One frame that is grossly wrong raises nothing, also near the camera, where noise is far smaller than the error.

HOVERING = """
[world]
ball_diameter = "6.4 cm"

[rules.near]
actuator = "motor"
severity = "{severity}"
when = {{ below = "50 cm" }}

[[tests]]
input = {{ hover = {{ at = "{distance}", for = "60 s" }}, dropouts = 0.05, outliers = 0.01 }}
expect.near = {{ raised = 0 }}
"""


@pytest.mark.long
@pytest.mark.parametrize("severity", ["warning", "safety"])
@pytest.mark.parametrize("distance", ["51 cm", "52 cm", "55 cm"])
def test_a_ball_that_stands_just_outside_is_not_taken_for_one_that_comes_in(
    distance: str, severity: str, tmp_path: Path
) -> None:
    file = tmp_path / "standing.toml"
    file.write_text(SIMULATED_BALL + HOVERING.format(distance=distance, severity=severity), encoding="utf-8")
    configuration = load_configuration(file)
    (test,) = configuration.tests
    for seed in range(201, 203):
        seeded = replace(test, input=test.input.model_copy(update={"seed": seed}))
        assert run_rule_test(configuration, seeded).failures == ()
