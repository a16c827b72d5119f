"""Each way in which a stream fails, once, with the whole program: no robot moves on what it shows."""

import pytest

from support.programs import require

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
