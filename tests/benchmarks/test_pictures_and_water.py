"""The tables of posters, of circles and of targets under water count what was measured."""

from __future__ import annotations

import numpy as np
import pytest

from support.scenes import draw


@pytest.mark.long
@pytest.mark.vision
def test_posters_are_counted_by_size_and_another_one_is_not_found() -> None:
    import picture_accuracy

    rows = {each.row: each for each in picture_accuracy.samples_of(3)}
    assert rows["300 px"].measured_m == pytest.approx(rows["300 px"].true_m, rel=0.005)
    assert rows["another poster"].measured_m is None


@pytest.mark.long
@pytest.mark.vision
def test_circles_are_counted_by_size_and_those_of_another_spacing_are_not_found() -> None:
    import circles_accuracy
    from by_row import facts_by_row, table_by_row

    samples = circles_accuracy.samples_of(3)
    rows = {each.row: each for each in samples}
    assert rows["200 px"].measured_m == pytest.approx(rows["200 px"].true_m, rel=0.005)
    assert rows["14 cm apart"].measured_m is None
    facts = facts_by_row("circles", samples)
    assert abs(facts["circles 200 px bias"]) == facts["circles 200 px median"]
    assert (facts["circles 200 px found"], facts["circles 14 cm apart found"]) == (1.0, 0.0)
    assert len(table_by_row("side", samples).splitlines()) == 2 + len(rows)


def test_rays_through_the_window_come_back_to_their_pixels() -> None:
    import under_water

    from support.scenes.water import CAMERA, INDEX

    pixels = np.array([[10.0, 20.0], [319.5, 239.5], [600.0, 470.0]])
    assert CAMERA.project(CAMERA.directions(pixels)) == pytest.approx(pixels)
    assert under_water.TOLD.fx_px == pytest.approx(INDEX * draw.CAMERA.fx_px)
