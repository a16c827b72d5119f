"""The page on safety promises nothing that no test asserts."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
ROWS = [line for line in PAGE.splitlines() if line.startswith("| ") and "| --- |" not in line]
PROMISES = [row for row in ROWS if not row.endswith("| asserted by |")]
TEST = re.compile(r"`([\w/]+\.py)::([\w:]+)`")


CONTRACTS = sorted((ROOT / "src" / "stadimeter" / "testing").glob("*_contract.py"))
"""Suites that the classes of other files inherit tests from."""


@cache
def names_in(file):
    """Return the names of the functions and classes of a file."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.ClassDef)}


@pytest.mark.long
def test_each_promise_names_tests_that_there_are():
    for row in PROMISES:
        named = TEST.findall(row.rsplit("|", 2)[1])
        assert named, f"no test asserts this: {row}"
        for file, names in named:
            there = set().union(*map(names_in, (ROOT / "tests" / file, *CONTRACTS)))
            assert set(names.split("::")) <= there, f"{file}: there is no {names}"


def test_every_table_says_what_asserts_it():
    headings = [
        before for before, line in zip(PAGE.splitlines(), PAGE.splitlines()[1:], strict=False) if "| --- |" in line
    ]
    assert len(headings) >= 5
    assert all(heading.endswith("| asserted by |") for heading in headings)
