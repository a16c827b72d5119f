"""Each recipe of the page is short, can be pasted, and does what the tests in its file beside say."""

import re
from pathlib import Path

import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.workbench.rule_tests import run_rule_test
from support.fragments import completed

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted((ROOT / "docs" / "recipes").glob("*.toml"))
BLOCKS = re.findall(r"^```toml\n(.*?)^```$", (ROOT / "docs" / "recipes.md").read_text(), re.MULTILINE | re.DOTALL)
LINES_MAX = 11


def recipe_of(file):
    """Return what stands in a file before its tests."""
    return file.read_text().partition("\n[[tests]]")[0]


def test_each_recipe_of_the_page_has_its_file_and_each_file_its_recipe():
    assert sorted(BLOCKS) == sorted(recipe_of(file) for file in FILES)


def test_a_recipe_is_a_few_lines_to_paste():
    assert [block for block in BLOCKS if len([line for line in block.splitlines() if line]) > LINES_MAX] == []


@pytest.mark.long
@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_recipe_keeps_what_its_tests_promise(file, tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_text(completed(file.read_text()))
    configuration = load_configuration(path)
    assert [warning.code for warning in configuration.warnings if warning.key.startswith("rules")] == []
    results = [run_rule_test(configuration, test) for test in configuration.tests]
    assert [(result.trouble, *result.failures) for result in results if not result.passed] == []
    assert results
