"""The strip chart, read back from its characters."""

from __future__ import annotations

import re
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.app.live.history import DistanceSample
from stadimeter.cli.run_panels import LIMIT, LINE, STYLES, StripChart, chart_scale


def samples(distances_m: list[float | None], period_s: float = 0.1, sigma_m: float = 0.0) -> list[DistanceSample]:
    return [
        DistanceSample(at_s=number * period_s, distance_m=distance_m, sigma_m=sigma_m)
        for number, distance_m in enumerate(distances_m)
    ]


def plot(chart: StripChart, taken: list[DistanceSample], now_s: float) -> list[str]:
    """Return the rows right of the axis, without the axis of time."""
    rows = [line.plain for line in chart.render(taken, now_s)]
    axis = rows[-1].index("└")
    return [row[axis + 1 :].ljust(chart.width - axis - 1) for row in rows[:-1]]


def test_a_target_at_rest_is_a_level_line_at_its_label() -> None:
    chart = StripChart(width=60, height=10)
    rows = [line.plain for line in chart.render(samples([2.0] * 301), 30.0)]
    (row,) = [row for row in rows if row.startswith("2.0 m")]
    assert set(row.partition("┤")[2]) == {"⠒"} or set(row.partition("┤")[2]) == {"⠤"}
    assert not any(set(other.partition("│")[2]) & {"⠒", "⠤"} for other in rows if other is not row)


def test_time_without_a_distance_is_a_gap_of_that_length() -> None:
    taken = samples([2.0] * 100 + [None] * 100 + [2.0] * 101)
    rows = plot(StripChart(width=68, height=8), taken, 30.0)
    empty = [column for column in range(len(rows[0])) if all(row[column] == " " for row in rows)]
    assert empty == list(range(empty[0], empty[-1] + 1))
    assert len(empty) == pytest.approx(len(rows[0]) / 3, abs=2)
    assert empty[0] == pytest.approx(len(rows[0]) / 3, abs=2)


def test_a_target_that_leaves_goes_up_to_the_right() -> None:
    rows = plot(StripChart(width=60, height=12), samples([1.0 + number / 100 for number in range(301)]), 30.0)
    tops = [next(number for number, row in enumerate(rows) if row[column] != " ") for column in range(2, 50)]
    assert tops == sorted(tops, reverse=True)
    assert tops[0] - tops[-1] >= 6


def test_a_limit_is_a_dotted_line_on_the_scale() -> None:
    chart = StripChart(width=60, height=8, limits_m=(2.8,))
    lines = chart.render(samples([2.0] * 301), 30.0)
    (row,) = [line for line in lines[:-1] if any(span.style == STYLES[LIMIT] for span in line.spans)]
    assert re.fullmatch(r"2\.8 m ┤[⠂-⣿ ]{40,}", row.plain)
    assert not any(span.style == STYLES[LINE] for span in row.spans)


@given(
    st.lists(st.none() | st.floats(), max_size=30), st.floats(allow_nan=True), st.integers(0, 90), st.integers(0, 30)
)
def test_whatever_the_figures_the_chart_fits(
    distances_m: list[float | None], sigma_m: float, width: int, height: int
) -> None:
    taken = samples(distances_m, period_s=1.0, sigma_m=sigma_m)
    rows = StripChart(width=width, height=height).render(taken, 30.0)
    assert len(rows) in {0, height}
    assert all(row.cell_len <= width for row in rows)


@given(st.lists(st.floats(0, 1e4), min_size=1), st.floats(0.01, 10), st.integers(2, 40))
def test_a_scale_holds_all_figures_and_labels_are_evenly_spaced(values: list[float], span: float, rows: int) -> None:
    scale = chart_scale(values, span, rows)
    assert all(-1e-6 <= scale.position(value) <= rows - 1 + 1e-6 for value in values)
    labels = list(scale.labels())
    assert len(labels) >= 2
    assert {one - other for (one, _), (other, _) in pairwise(labels)} == {scale.rows_per_step}
    assert scale.low >= 0
