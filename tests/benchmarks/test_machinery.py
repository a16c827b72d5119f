"""The benchmarks of the machinery, and the gate, which lets noise pass and no cost that stays."""

from __future__ import annotations

import json

import pytest

from stadimeter.config.loader import load_configuration

# The benchmark of the machinery runs, and measures what it says.


def test_it_measures_every_row_and_prints_a_table():
    import machinery

    rows = machinery.measure_all(counts=(1, 30), frames=60, rounds=1)
    whats = ("decide", "all but vision, no journal", machinery.WHOLE)
    assert [(row.rules, row.what) for row in rows] == [(count, what) for count in (1, 30) for what in whats]
    assert all(0 < row.median_us <= row.p95_us for row in rows)
    assert machinery.markdown(rows).count("\n|") == 7


@pytest.mark.long
def test_the_configuration_has_as_many_rules_as_it_says_and_they_do_something(tmp_path):
    import machinery

    plan = load_configuration(machinery.configuration(100, tmp_path)).plan
    assert len(plan.rules) == 100
    assert len(plan.outputs) == machinery.OUTPUTS
    journal = tmp_path / "run.jsonl"
    machinery.cycle_times_s(tmp_path / "100-rules.toml", 300, journal)
    text = journal.read_text()
    assert text.count("\n") >= 300
    assert '"kind":"raised"' in text


# The gate against creeping cost lets noise pass, and no cost that stays.


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
