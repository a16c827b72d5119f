"""Who gets which detection: the least total cost, whatever the costs."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.perception.perceiver import assign

UNASSIGNED = 50.0
COSTS = st.one_of(st.floats(-60, 60), st.integers(0, 3).map(float), st.just(math.inf))


@st.composite
def tables(draw: st.DrawFn) -> list[list[float]]:
    rows, columns = draw(st.integers(0, 5)), draw(st.integers(0, 5))
    return [[draw(COSTS) for _ in range(columns)] for _ in range(rows)]


def total(costs: list[list[float]], given_to: list[int | None] | tuple[int | None, ...]) -> float:
    return sum(UNASSIGNED if j is None else row[j] for row, j in zip(costs, given_to, strict=True))


def least(costs: list[list[float]]) -> float:
    """Return the least total, by trying all ways to share the columns out."""
    columns = len(costs[0]) if costs else 0
    places = [*range(columns), *[None] * len(costs)]
    return min(total(costs, way) for way in set(itertools.permutations(places, len(costs))))


@given(tables())
def test_no_other_way_costs_less(costs: list[list[float]]) -> None:
    given_to = assign(costs, UNASSIGNED)
    taken = [j for j in given_to if j is not None]
    assert len(set(taken)) == len(taken)
    assert total(costs, given_to) == pytest.approx(least(costs))


def test_two_that_want_the_same_are_shared_out_so_that_both_fit_best_together() -> None:
    assert assign([[1.0, 2.0], [1.0, 30.0]], UNASSIGNED) == [1, 0]


def test_what_must_not_be_is_left_out() -> None:
    assert assign([[math.inf, math.inf], [math.inf, 3.0]], UNASSIGNED) == [None, 1]


def test_sixty_four_that_all_want_the_same_each_get_one() -> None:
    costs = [[abs(i - j) * 0.01 + j * 0.5 for j in range(64)] for i in range(64)]
    assert sorted(j for j in assign(costs, UNASSIGNED) if j is not None) == list(range(64))
