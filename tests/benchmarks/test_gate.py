"""The gate against creeping cost lets noise pass, and no cost that stays."""

import json

import pytest


@pytest.fixture
def gate():
    import gate

    return gate


def test_a_ratio_within_the_margin_passes_at_the_first_measurement(gate):
    measured = iter([{"start": 2.9}])
    assert gate.judged({"start": 2.0}, lambda: next(measured)) == ({"start": 2.9}, [])


def test_a_ratio_that_is_too_large_once_is_measured_again(gate):
    measured = iter([{"start": 3.1, "cycle": 1.0}, {"start": 2.2, "cycle": 9.0}])
    best, wrong = gate.judged({"start": 2.0, "cycle": 1.0}, lambda: next(measured))
    assert (best, wrong) == ({"start": 2.2, "cycle": 1.0}, [])


def test_a_ratio_that_stays_too_large_fails(gate):
    _, wrong = gate.judged({"start": 2.0}, lambda: {"start": 3.1})
    assert wrong == ["start: 3.10, kept 2.00, at most 3.00"]


@pytest.mark.parametrize("kept", [{}, {"start": 2.0, "memory": 1.5}])
def test_what_is_measured_and_what_is_kept_must_be_the_same_figures(gate, kept):
    _, wrong = gate.judged(kept, lambda: {"start": 2.0})
    assert len(wrong) == 1


@pytest.mark.long
def test_every_kept_ratio_is_measured_and_more_than_nothing(gate):
    ratios = gate.measure(rounds=1)
    assert set(ratios) == set(json.loads(gate.KEPT.read_text()))
    assert all(ratio > 0.1 for ratio in ratios.values())
