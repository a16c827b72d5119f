"""The simulated robot is the one that its base describes."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.app.bootstrap import build
from stadimeter.config.loader import load_configuration
from stadimeter.core.command import TwistCommand
from support.simulated_run import SIMULATED_BALL

LINEAR_MPS, ANGULAR_RADPS = 0.3, 0.5


def driven(folder: Path, driver: str, world: str = "") -> tuple[float, float]:
    """Command a base for 2 s, and return how fast its robot then moves, in m/s and rad/s."""
    path = folder / "robot.toml"
    path.write_text(
        f"""{SIMULATED_BALL}
[base]
driver = "{driver}"
port = "emulated-{driver}"
wheel_diameter = "6.5 cm"
ticks_per_turn = 1440
track_width = "16 cm"

[rules.follow]
actuator = "base"
follow = {{ distance = "1 m", max_speed = "0.4 m/s" }}

[world]
{world}
"""
    )
    parts = build(load_configuration(path), speed=None)
    clock, robot = parts.clock, parts.shared.parts["world"].robot
    (output,) = (each for each in parts.outputs if each.name == "base")
    output.open()
    for _ in range(40):
        command = {"linear_mps": LINEAR_MPS, "angular_radps": ANGULAR_RADPS, "captured_at_s": clock.now_s()}
        output.apply(TwistCommand(output="base", **command))
        clock.sleep_until_s(clock.now_s() + 0.05)
        output.check(clock.now_s())
    left_mps, right_mps = robot.wheels_mps
    output.close()
    for close in reversed(parts.shared.closers):
        close()
    return (left_mps + right_mps) / 2, (right_mps - left_mps) / robot.track_width_m


@pytest.mark.parametrize("driver", ["roboclaw", "ros-arduino-bridge"])
def test_an_emulated_robot_moves_as_commanded_whatever_wheels_its_base_says_it_has(tmp_path: Path, driver: str) -> None:
    # A command is rounded to whole ticks.
    assert driven(tmp_path, driver) == pytest.approx((LINEAR_MPS, ANGULAR_RADPS), rel=0.05)


def test_a_robot_that_differs_from_what_its_base_says_is_written_in_its_world(tmp_path: Path) -> None:
    half = f"ticks_per_metre = {1440 / (3.14159 * 0.065) / 2}"
    linear_mps, _ = driven(tmp_path, "roboclaw", half)
    assert linear_mps == pytest.approx(2 * LINEAR_MPS, rel=0.02)
