"""The part of the report on objects that a network finds."""

from __future__ import annotations

import pytest

from support.scenes import draw

pytestmark = pytest.mark.vision


@pytest.mark.long
def test_people_are_measured_within_what_people_and_boxes_differ() -> None:
    import objects

    samples = [each for seed in draw.TUNING_SEEDS[500:508] for each in objects.samples_of(seed)]
    assert {each.row for each in samples} == {row.name for row in objects.ROWS}
    assert all(each.measured_m is not None for each in samples)
    assert all(abs(each.error) < 4 * each.sigma_m / each.measured_m for each in samples)
    assert all(0.04 < each.sigma_m / each.measured_m < 0.12 for each in samples)


@pytest.mark.long
def test_the_part_has_a_line_and_figures_for_each_row() -> None:
    import objects

    part = objects.run(2, 1, draw.TUNING_SEEDS.start)
    for row in objects.ROWS:
        assert f"| {row.name} | 2 |" in part.text
        assert {f"object {row.name} median", f"object {row.name} held"} <= set(part.facts)
