"""Every configuration that ships carries tests of its rules, and they pass."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.workbench.rule_tests.running import run_rule_test

FILES = sorted((Path(__file__).parents[2] / "config").glob("*.toml"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_what_its_rules_promise_holds(file: Path) -> None:
    configuration = load_configuration(file)
    assert configuration.tests
    assert {test.name: run_rule_test(configuration, test).failures for test in configuration.tests} == {
        test.name: () for test in configuration.tests
    }
