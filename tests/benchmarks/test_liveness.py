"""Live rooms stop no robot, and the benchmark of liveness does what it says."""

from __future__ import annotations

import math
import shutil

import pytest

from support.changed_pictures import KINDS, NEVER_TWICE


@pytest.mark.long
@pytest.mark.parametrize("number", range(4))
def test_in_rooms_with_texture_a_robot_that_follows_is_not_stopped(number: int) -> None:
    from liveness import Walk, walk

    walked = walk((number, "textured", 300.0))
    assert walked == Walk(walked.drove_s, 0, is_said_plain=False)
    assert walked.drove_s > 60


@pytest.mark.long
@pytest.mark.parametrize("fault", ["frozen_under_clock", "frozen_under_noise"])
def test_a_frozen_sensor_stops_the_wheels_within_half_a_second(fault: str) -> None:
    from liveness import freeze, row

    stops = [freeze((number, fault, "simulated", False)) for number in range(3)]
    assert max(each.stood_s for each in stops) <= 0.5
    assert row("frozen", stops).startswith("| frozen | 3 of 3 | ")


@pytest.mark.long
@pytest.mark.parametrize("is_turning", [False, True], ids=["ahead", "turning"])
@pytest.mark.parametrize("kind", [each for each in KINDS if each != NEVER_TWICE])
def test_old_pictures_in_which_something_changes_stop_a_robot_within_two_seconds(kind: str, is_turning: bool) -> None:
    from liveness import replay

    if "H.264" in kind and not shutil.which("ffmpeg"):
        pytest.skip("no ffmpeg")
    assert replay((2, kind, "simulated", is_turning)).commanded_s <= 2.0


def test_a_robot_that_never_stops_is_no_stop_of_the_table() -> None:
    from liveness import Stop, row

    assert "1 of 2" in row("x", [Stop(0.2, 0.2, 0.1), Stop(math.inf, math.inf, 0.1)])
