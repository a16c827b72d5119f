"""The benchmark of the machinery runs, and measures what it says."""

import importlib.util
import sys
from pathlib import Path

import pytest

from stadimeter.config.loader import load_configuration
from support.programs import path_of


def _benchmark(name):
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


@pytest.fixture(scope="module")
def machinery():
    yield from _benchmark("machinery")


@pytest.fixture(scope="module")
def start_up():
    yield from _benchmark("start_up")


@pytest.mark.long
def test_it_measures_every_row_and_prints_a_table(machinery):
    rows = machinery.measure_all(counts=(1, 30), frames=60, rounds=1)
    whats = ("decide", "all but vision, no journal", machinery.WHOLE)
    with_broker = [(30, machinery.WITH_BROKER)] if path_of("mosquitto") else []
    assert [(row.rules, row.what) for row in rows] == [
        *((count, what) for count in (1, 30) for what in whats),
        *with_broker,
    ]
    assert all(0 < row.median_us <= row.p95_us for row in rows)
    assert machinery.markdown(rows).count("\n|") == 7 + len(with_broker)


@pytest.mark.long
def test_the_configuration_has_as_many_rules_as_it_says_and_they_do_something(machinery, tmp_path):
    plan = load_configuration(machinery.configuration(100, tmp_path)).plan
    assert len(plan.rules) == 100
    assert len(plan.outputs) == machinery.OUTPUTS
    journal = tmp_path / "run.jsonl"
    machinery.cycle_times_s(tmp_path / "100-rules.toml", 300, journal)
    text = journal.read_text()
    assert text.count("\n") >= 300
    assert '"kind":"raised"' in text


@pytest.mark.long
def test_the_start_of_every_command_is_timed_against_the_bare_import(start_up):
    rows = start_up.measure_all(processes=1)
    assert [row.what for row in rows][:2] == [start_up.BARE, "stadimeter --help"]
    assert all(row.median_s > 0 for row in rows)
    assert rows[0].ratio == 1
    assert set(start_up.facts(rows)) == {"start-up help", "start-up measure", "start-up run"}
    assert start_up.markdown(rows).count("\n") == len(rows) + 1
