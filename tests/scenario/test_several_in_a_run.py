"""Several balls in a whole run: each keeps its name, and rules see the nearest, any, all, and how many there are."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest
from typer.testing import CliRunner

from stadimeter.app.recordings.journal import read_journal
from stadimeter.cli.main import app
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.decision import EventKind
from support.recordings import records_of
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.cut_sheet import GroupTarget
from support.scenes.render import render
from support.scenes.scene import Scene

pytestmark = [pytest.mark.vision, pytest.mark.timeout(180)]

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
