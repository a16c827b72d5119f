"""The benchmark of the machinery runs, and measures what it says."""

import pytest

from stadimeter.config.loader import load_configuration


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


@pytest.mark.long
def test_the_start_of_every_command_is_timed_against_the_bare_import():
    import start_up

    rows = start_up.measure_all(processes=1)
    assert [row.what for row in rows][:2] == [start_up.BARE, "stadimeter --help"]
    assert all(row.median_s > 0 for row in rows)
    assert rows[0].ratio == 1
    assert set(start_up.facts(rows)) == {"start-up help", "start-up measure", "start-up run"}
    assert start_up.markdown(rows).count("\n") == len(rows) + 1
