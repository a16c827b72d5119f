"""The contract suites catch the mistakes that `planted_mistakes.py` plants in drivers which pass them."""

from __future__ import annotations

import subprocess
import sys
from collections import defaultdict
from xml.etree import ElementTree as ET

import pytest

from support import planted_mistakes
from support.planted_mistakes import CANNOT_OPEN, FAILS, MISTAKES, RELEASED, TICKS

pytestmark = pytest.mark.long  # a suite of its own, against every mistake


@pytest.fixture(scope="module")
def failures(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, str]]:
    """Run planted mistakes once; return for each the tests that failed, with their messages."""
    report = tmp_path_factory.mktemp("planted") / "report.xml"
    chosen = [f"({mistake.caught_by} and {name})" for name, mistake in MISTAKES.items()]
    arguments = ["-q", "--noconftest", "--tb=no", f"--junitxml={report}", "-n", "0", "-m", "long or not long"]
    words = [sys.executable, "-m", "pytest", *arguments, "-k", " or ".join(["NamesNoFaults", *chosen])]
    done = subprocess.run([*words, planted_mistakes.__file__], capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 1, done.stdout
    failed: dict[str, dict[str, str]] = defaultdict(dict)
    for case in ET.parse(report).iter("testcase"):  # noqa: S314 - our own pytest wrote it
        test, _, parameters = case.get("name", "").partition("[")
        name = next((name for name in MISTAKES if name in parameters), "no mistake")
        for failure in (*case.iter("failure"), *case.iter("error")):
            failed[name][test] = failure.get("message", "")
    return failed


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_caught(failures: dict[str, dict[str, str]], name: str) -> None:
    assert MISTAKES[name].caught_by in failures[name]


def test_a_slow_driver_fails_at_once_and_says_which_call_is_slow(failures: dict[str, dict[str, str]]) -> None:
    assert "ticks-slowly.tick() is too slow" in failures["ticks-slowly"][TICKS]
    assert "waits-for-each-answer.apply() is too slow" in failures["waits-for-each-answer"][TICKS]


def test_a_rig_that_names_no_fault_fails_the_tests_that_need_it(failures: dict[str, dict[str, str]]) -> None:
    assert set(failures["no mistake"]) == {CANNOT_OPEN, FAILS, RELEASED}
