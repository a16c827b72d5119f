"""The reference is what ``docs/make_reference.py`` writes now; it is complete, and each of its examples is accepted."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import make_reference
import pytest
import reference_code

from stadimeter.config.findings import OF_A_TEST, OTHER
from stadimeter.config.loader import load_configuration
from stadimeter.core import templates

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def pages():
    return make_reference.pages()


@pytest.mark.parametrize("page", ["index", *make_reference.GIVEN["pages"]])
def test_a_page_is_what_the_code_says_now(pages, page):
    shown = (DOCS / "reference" / f"{page}.md").read_text(encoding="utf-8")
    assert shown == pages[page], "run: make reference"


def test_there_is_no_other_page(pages):
    assert {path.stem for path in (DOCS / "reference").glob("*.md")} == set(pages)


def test_every_key_of_every_table_stands_there_with_a_description(pages):
    texts = [text for name, text in pages.items() if name in {"conditions", *make_reference.SECTIONS}]
    rows = [row for text in texts for row in re.findall(r"^\| `(\w+)` \| (.*?) \|", text, re.MULTILINE)]
    rows += re.findall(r"^## `(\w+)`\n\n(.*)$", pages["conditions"], re.MULTILINE)
    keys = {key for each in make_reference.models() for key in make_reference.schema()["$defs"][each]["properties"]}
    assert keys - {key for key, _ in rows} == set()
    assert {key for key, words in rows if key in keys and not words} == set()


def test_every_example_is_accepted_in_its_table():
    tables = make_reference.schema()["$defs"]
    keys = [(name, key) for name in make_reference.models() for key in tables[name]["properties"]]
    assert [each for each in keys if not make_reference.is_accepted(each[0], make_reference.example(*each))] == []


@pytest.mark.parametrize("condition", make_reference.GIVEN["when"])
def test_the_example_of_a_condition_can_be_loaded(condition, tmp_path):
    path = tmp_path / "example.toml"
    path.write_text(make_reference.condition_file(condition))
    assert "near" in {rule.name for rule in load_configuration(path).plan.rules}


def test_every_field_of_a_template_stands_there(pages):
    assert set(templates.FIELDS) <= set(re.findall(r"`(\w+)`", pages["messages"]))


def test_every_code_of_a_finding_stands_there(pages):
    shown = set(re.findall(r"^\| `([a-z-]+)`", pages["findings"], re.MULTILINE))
    assert codes_in_the_source() - shown == set()
    assert set(reference_code.SAID_ELSEWHERE) <= {*codes_in_the_source(), OTHER, OF_A_TEST}


def codes_in_the_source():
    """Return every code that a finding is made with where it stands in the source as it is."""
    texts = [source.read_text(encoding="utf-8") for source in reference_code.SOURCE.rglob("*.py")]
    calls = [node for text in texts for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    made = [call for call in calls if getattr(call.func, "id", "") in {"Finding", "Problem"}]
    given = [[*call.args[3:4], *(word.value for word in call.keywords if word.arg == "code")] for call in made]
    return {each.value for codes in given for each in codes if isinstance(each, ast.Constant) and each.value}
