"""A camera on a servo turns with its target through the whole program, and stands whenever it should."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.errors import ConfigError
from support.simulated_run import LENS

PAGE = (Path(__file__).parents[2] / "docs" / "robots.md").read_text(encoding="utf-8")
(GUIDE,) = re.findall(r"## A camera on a servo\n.*?```toml\n(.*?)```", PAGE, re.DOTALL)
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


@pytest.mark.parametrize("fault", ["camera_blocked", "camera_frozen", "target_hidden"])
def test_the_camera_stands_within_half_a_second_after_something_went_wrong(
    scenario: Callable[..., Any], fault: str
) -> None:
    run = scenario(text=with_world(guide=SIMULATED.replace("max_speed", 'search = "off", max_speed')))
    stood: list[float] = []
    run.at(3.0, lambda: setattr(run.world.faults, fault, True))
    for at_s in (2.0, 2.9, 3.5, 6.0):
        run.at(at_s, lambda: stood.append(heading_deg(run)))
    run.run(6.5)
    before, at_fault, soon, later = stood
    assert at_fault - before > 5.0, "it turned"
    assert later == pytest.approx(soon, abs=0.01)


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
