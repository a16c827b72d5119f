"""What pages promise is asserted by tests: `promises/PAGE.toml` names them for each row and sentence of a page.

A key is the first cell of a row of a table, or a sentence as the page has it; its value lists tests, as
``scenario/test_old_pictures.py::test_name``. Pages whose every row must have its tests are those of `WHOLE`.
"""

from __future__ import annotations

import ast
import tomllib
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROMISES = sorted((Path(__file__).parent / "promises").glob("*.toml"))
WHOLE = ("README.md", "docs/safety.md", "docs/what-it-does-not-do.md")
CONTRACTS = sorted((ROOT / "src" / "stadimeter" / "testing").glob("*_contract.py"))
"""Suites that the classes of other files inherit tests from."""


def page_of(promises: Path) -> Path:
    return ROOT / "README.md" if promises.stem == "README" else ROOT / "docs" / f"{promises.stem}.md"


def on_one_line(text: str) -> str:
    return " ".join(text.split())


def rows_of(page: Path) -> list[str]:
    """Return the first cell of each row of a page's tables, without their headings."""
    lines = page.read_text(encoding="utf-8").splitlines()
    below = [line for line, after in zip(lines, [*lines[1:], ""], strict=True) if not after.startswith("| ---")]
    return [line[2:].split(" | ")[0] for line in below if line.startswith("| ") and not line.startswith("| ---")]


@cache
def names_in(file: Path) -> set[str]:
    """Return the names of the functions and classes of a file."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.ClassDef)}


@pytest.mark.parametrize("promises", PROMISES, ids=lambda path: path.stem)
def test_each_promise_stands_on_its_page_and_names_tests_that_there_are(promises):
    page = on_one_line(page_of(promises).read_text(encoding="utf-8"))
    kept = tomllib.loads(promises.read_text(encoding="utf-8"))
    assert [says for says in kept if on_one_line(says) not in page] == []
    for says, tests in kept.items():
        assert tests, f"no test asserts this: {says}"
        for file, _, names in (test.partition("::") for test in tests):
            there = set().union(*map(names_in, (ROOT / "tests" / file, *CONTRACTS)))
            assert set(names.split("::")) <= there, f"{file}: there is no {names}"


@pytest.mark.parametrize("page", WHOLE)
def test_each_row_of_a_page_that_promises_has_its_tests(page):
    path = ROOT / page
    promises = Path(__file__).parent / "promises" / f"{path.stem}.toml"
    kept = set(tomllib.loads(promises.read_text(encoding="utf-8")))
    assert [row for row in rows_of(path) if row not in kept] == []
