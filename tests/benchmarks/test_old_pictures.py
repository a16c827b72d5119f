"""Each way in which a stream fails and a picture freezes, with the whole program: no robot moves on what it shows."""

from __future__ import annotations

import math
import shutil

import pytest

from support.changed_pictures import KINDS, NEVER_TWICE
from support.programs import require

# Each way in which a stream fails, once, with the whole program: no robot moves on what it shows.

STOOD_WITHIN_S = 1.0
"""The benchmark tells the true figure; a machine that does something else besides may take longer."""


def failures():
    return (
        *(f"cut to {share} %{ending}" for share in (10, 40, 70, 95) for ending in ("", ", end appended")),
        "two old pictures in turn",
        "30 old pictures in turn",
        "two old pictures of two sizes in turn",
        *(f"link at {share} %{packets}" for share in (50, 70, 90) for packets in ("", ", packets end with pictures")),
        "H.264 over UDP, 18 % lost",
        "lag of 2 s, unsaid",
        "lag of 2 s, stated",
        "stall of 0.9 s",
        "stall of 3 s, kept by the sender",
        "program paused for 10 s",
    )


@pytest.mark.long
@pytest.mark.parametrize("name", failures())
def test_no_robot_moves_on_pictures_that_are_not_now(name, tmp_path):
    from old_pictures import FAILURES, run_once

    failure = {failure.name: failure for failure in FAILURES}[name]
    if failure.loss is not None:
        require("ffmpeg")
    outcome = run_once(failure, 0, tmp_path)
    assert outcome.followed is failure.moves, outcome.output
    assert outcome.stood_after_s <= (STOOD_WITHIN_S if failure.moves else 0.0), outcome.output


@pytest.mark.long
def test_the_test_knows_every_failure_of_the_benchmark():
    from old_pictures import FAILURES

    assert sorted(failures()) == sorted(failure.name for failure in FAILURES)


# Live rooms stop no robot, and the benchmark of liveness does what it says.


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
