"""Documentation, messages and docstrings do without words that readers stumble over, and have those they search for."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "deploy" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
CONFIGURATIONS = [*sorted((ROOT / "config").glob("*.toml")), *(ROOT / "src").rglob("recipes/**/*.toml")]
SOURCES = sorted((ROOT / "src" / "stadimeter").rglob("*.py"))

UNWANTED = {
    "median": r"\bin the middle(?! of)",
    "p95": r"\b95 in 100\b",
    "a number, or 'at most'": r"\bso many\b|\bby so much\b",
    "report, state, notify": r"\btold\b",
    "a person, no one, or the passive": r"\bsomebody\b|\bnobody\b",
    "reload, apply": r"\btak(?:e|es|en|ing) over\b",
    "the thing by its name": r"\bwhat is so of\b|\bthe \w+ of before\b",
}
"""Phrases that readers stumble over, by the words to use in their place."""

SEARCHED = (
    "hysteresis", "debounce", "threshold", "latency", "median", "95th percentile", "accuracy", "false alarm",
    "dropped frame", "reprojection error",
)  # fmt: skip


def unwanted(text):
    found = {instead: re.findall(pattern, text, re.IGNORECASE) for instead, pattern in UNWANTED.items()}
    return {instead: phrases for instead, phrases in found.items() if phrases}


def prose(source):
    """Return the docstrings and messages of a source; names and notes on attributes are none. Most need no look."""
    text = source.read_text()
    if not unwanted(text):
        return ""
    nodes = list(ast.walk(ast.parse(text)))
    notes = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    strings = (each for each in nodes if isinstance(each, ast.Constant) and isinstance(each.value, str))
    documented = (each for each in nodes if isinstance(each, ast.Module | ast.ClassDef | ast.FunctionDef))
    return "\n".join(
        [each.value for each in strings if id(each) not in notes]
        + [ast.get_docstring(each) or "" for each in documented]
    )


def test_no_page_message_or_docstring_uses_words_that_readers_stumble_over():
    texts = {page: page.read_text() for page in [*PAGES, *CONFIGURATIONS]} | {path: prose(path) for path in SOURCES}
    found = {path: unwanted(text) for path, text in texts.items()}
    assert {path: phrases for path, phrases in found.items() if phrases} == {}


def test_words_that_readers_search_for_are_found():
    text = "\n".join(page.read_text() for page in PAGES).lower()
    assert [word for word in SEARCHED if word not in text] == []


WORDS_MAX = {"README.md": 500}
WORDS_MAX_ELSEWHERE = 1500
WRITTEN_BY_PROGRAMS = ("reference", "benchmarks")


def test_each_page_is_read_at_one_sitting():
    pages = [each for each in (ROOT / "docs").rglob("*.md") if each.parent.name not in WRITTEN_BY_PROGRAMS]
    words = {str(page.relative_to(ROOT)): len(page.read_text().split()) for page in [ROOT / "README.md", *pages]}
    assert {page: n for page, n in words.items() if n > WORDS_MAX.get(page, WORDS_MAX_ELSEWHERE)} == {}
