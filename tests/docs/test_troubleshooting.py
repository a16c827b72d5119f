"""The page on troubleshooting quotes what the program really says."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "troubleshooting.md").read_text()
OF_OTHERS = {"numpy.dtype size changed", "stadimeter: command not found", "externally-managed-environment"}
"""What pip, Python and the shell say."""


def symptoms():
    """Return the messages in the first column: quoted, and of several words, to tell them from commands and names."""
    first = [line.split(" | ")[0] for line in PAGE.splitlines() if line.startswith("| ")]
    quoted = [quote for cell in first for quote in re.findall(r"`([^`]+)`", cell)]
    return [quote for quote in quoted if " " in quote and "…" not in quote and not quote.startswith("stadimeter ")]


@pytest.fixture(scope="module")
def source_texts():
    trees = (ast.parse(path.read_text()) for path in (ROOT / "src" / "stadimeter").rglob("*.py"))
    return [
        node.value
        for tree in trees
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]


@pytest.mark.long
@pytest.mark.parametrize("symptom", sorted(set(symptoms()) - OF_OTHERS))
def test_every_message_that_is_quoted_stands_in_the_source(symptom, source_texts):
    assert any(symptom in text for text in source_texts)


def test_there_are_messages_to_look_for():
    assert len(symptoms()) > 15
