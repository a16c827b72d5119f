"""The benchmark of the machinery runs, and measures what it says."""

import importlib.util
import sys
from pathlib import Path

import pytest

from stadimeter.config.loader import load_configuration


@pytest.fixture(scope="module")
def machinery():
    spec = importlib.util.spec_from_file_location("machinery", Path(__file__).with_name("machinery.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def test_it_measures_every_row_and_prints_a_table(machinery):
    rows = machinery.measure_all(counts=(1, 30), frames=60, rounds=1)
    assert [(row.rules, row.what) for row in rows] == [
        (count, what) for count in (1, 30) for what in ("decide", "all but vision, no journal", "all but vision")
    ]
    assert all(0 < row.median_us <= row.p95_us for row in rows)
    assert len(machinery.markdown(rows).splitlines()) == 8


def test_the_configuration_has_as_many_rules_as_it_says_and_they_do_something(machinery, tmp_path):
    plan = load_configuration(machinery.configuration(100, tmp_path)).plan
    assert len(plan.rules) == 100
    assert len(plan.outputs) == machinery.OUTPUTS
    journal = tmp_path / "run.jsonl"
    machinery.turn_times_s(tmp_path / "100-rules.toml", 300, journal)
    text = journal.read_text()
    assert text.count("\n") >= 300
    assert '"kind":"raised"' in text
