"""Documentation and messages use the words that people search for, and some others do not come back."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "deploy" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
CONFIGURATIONS = [*sorted((ROOT / "config").glob("*.toml")), *(ROOT / "src").rglob("wishes.toml")]
SOURCES = sorted((ROOT / "src" / "stadimeter").rglob("*.py"))

UNWANTED = {
    "median": r"\bin the middle(?! of)",
    "p95": r"\b95 in 100\b",
    "a number, or 'at most'": r"\bso many\b|\bby so much\b",
    "report, state, notify": r"\btold\b",
    "a person, no one, or the passive": r"\bsomebody\b|\bnobody\b",
    "reload, apply": r"\btak(?:e|es|en|ing) over\b",
    "What colour is …?": r"\bwhich (?:colour|number) has\b",
    "resolved: …": r"\btrouble is over\b",
    "cannot work on this computer": r"\bwill not work here\b",
    "the likeliest outline, … px long, is refused: …": r"\bmost like one is\b",
    "no rule drives it": r"\bnothing is asked of it\b",
    "this user may not use it": r"\bours to open\b",
}
"""Phrases that readers stumble over, by the words to use in their place."""

SEARCHED = (
    "hysteresis", "debounce", "threshold", "latency", "median", "95th percentile", "accuracy", "false alarm",
    "dropped frame", "reprojection error",
)  # fmt: skip


def messages(path):
    """Return the texts of a source that people may see: all strings but the docstrings of what is no command."""
    tree = ast.parse(path.read_text())
    unseen = {
        id(statement.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and not is_command(node)
        for statement in node.body
        if isinstance(statement, ast.Expr)
    }
    return [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in unseen
    ]


def is_command(node):
    return isinstance(node, ast.FunctionDef) and "**Exit code**" in (ast.get_docstring(node) or "")


def unwanted(text):
    return {
        found[0]: instead
        for instead, pattern in UNWANTED.items()
        for found in re.finditer(pattern, text, re.IGNORECASE)
    }


def test_documentation_uses_words_that_readers_know():
    found = {page: unwanted(page.read_text()) for page in [*PAGES, *CONFIGURATIONS]}
    assert {page: words for page, words in found.items() if words} == {}


def test_messages_use_words_that_readers_know():
    found = {path: unwanted("\n".join(messages(path))) for path in SOURCES}
    assert {path: words for path, words in found.items() if words} == {}


def test_words_that_readers_search_for_are_found():
    text = "\n".join(page.read_text() for page in PAGES).lower()
    assert [word for word in SEARCHED if word not in text] == []


def test_unwanted_words_are_recognised_and_their_likes_are_not():
    assert set(unwanted("Nobody is told, 3 ms in the middle, 95 in 100 below; it takes over so many")) == {
        "Nobody", "told", "in the middle", "95 in 100", "takes over", "so many",
    }  # fmt: skip
    assert unwanted("put it in the middle of the picture; test_it_is_told_nothing") == {}
