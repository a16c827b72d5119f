"""The outlines that the ball of the video is judged by."""

import csv
import statistics
from itertools import pairwise
from pathlib import Path

import pytest


def outlines(name):
    with (Path(__file__).parent / f"ball_video_{name}.csv").open(newline="", encoding="utf-8") as file:
        return {
            int(row.pop("frame")): {key: float(value) for key, value in row.items()} for row in csv.DictReader(file)
        }


@pytest.fixture
def by_eye():
    return outlines("by_eye")


def test_frames_outlined_by_eye_are_evenly_spaced_wherever_the_ball_is_in_sight(by_eye):
    gaps = [after - before for before, after in pairwise(by_eye)]
    assert len(by_eye) == 60
    assert sum(gap > 15 for gap in gaps) == 2, "the ball leaves the picture twice"
    assert min(gaps) > 10


def test_both_passes_by_eye_agree_far_better_than_what_counts_as_wrong(by_eye):
    shares = [row["radius_spread_px"] / row["radius_px"] for row in by_eye.values()]
    assert statistics.median(shares) < 0.01
    assert max(shares) < 0.04


def test_outlines_by_eye_and_fitted_ones_agree_in_the_frames_that_have_both(by_eye):
    fitted = outlines("outline")
    common = by_eye.keys() & fitted.keys()
    assert len(common) > 5
    for frame in common:
        assert fitted[frame]["radius_px"] == pytest.approx(by_eye[frame]["radius_px"], rel=0.04)


def test_the_benchmark_reads_both_outlines_and_states_how_far_the_passes_are_apart(by_eye):
    from ball_video import BY_EYE, FITTED, _outline, _spread

    assert _outline(BY_EYE) == {frame: row["radius_px"] for frame, row in by_eye.items()}
    assert len(_outline(FITTED)) == 125
    assert "60 evenly spaced frames" in _spread()
    assert "differ by 0.6% (p90 1.6%)" in _spread()
