"""The part of the report on the floor compares what it says it does."""

from __future__ import annotations

import math

import pytest

from support.scenes.on_floor import HEIGHT_M, ball_on_floor, sheet_on_floor, tag_lying


def test_what_is_drawn_stands_on_the_floor() -> None:
    for drawn, distance_m in ((ball_on_floor(1, 2.0), 2.0), (tag_lying(1, 0.7), 0.7)):
        x, y, z = drawn.scene.target.position_m
        # Down from the camera is (0, cos t, -sin t), but for the roll.
        below_m = y * math.cos(drawn.tilt_rad) - z * math.sin(drawn.tilt_rad)
        radius_m = getattr(drawn.scene.target, "diameter_m", 0.0) / 2
        assert below_m + radius_m == pytest.approx(drawn.height_m, abs=0.005)
        assert math.sqrt(x * x + y * y + z * z - below_m**2) == pytest.approx(distance_m, rel=1e-3)
    corners = sheet_on_floor(1, 1.0).scene.target.outline_m()
    assert len(corners) == 4
    assert abs(HEIGHT_M - sheet_on_floor(1, 1.0).height_m) < 0.02


@pytest.mark.long
def test_each_cell_has_three_figures_and_the_floor_s_are_those_of_the_floor() -> None:
    from floor import BOTH, DISTANCES_M, FLOOR, KINDS, SIZE, facts_of, samples_of

    samples = samples_of(1)
    assert len(samples) == 3 * len(KINDS) * len(DISTANCES_M)
    ball = {each.method: each for each in samples if each.row == "ball, 1 m"}
    assert ball[SIZE].measured_m != ball[FLOOR].measured_m
    assert min(ball[SIZE].measured_m, ball[FLOOR].measured_m) <= ball[BOTH].measured_m
    assert facts_of(samples)["floor median"] < 0.2
