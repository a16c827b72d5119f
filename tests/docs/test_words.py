"""Documentation and messages use the words that people search for, and some others do not come back."""

import ast
import re
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

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

UNWANTED_IN_SOURCES = {
    "the thing by its name": r"\bwhoever\b|\bhis own\b|\bwhat is so of\b|\bthe \w+ of before\b",
}
"""The same, for docstrings."""

SUPERLATIVE = re.compile(
    r"(?:.*_)?(?:MOST|LEAST|(?:DEEP|FEW|GREAT|HIGH|LARG|LONG|LOW|NARROW|SHORT|SMALL|WID)EST)(?:_.*)?$"
)
"""Names of bounds that are called `MAX_…` and `MIN_…`."""

NO_VERBS = frozenset({
    "answered", "asked", "given", "judged", "kept", "known", "made", "operated", "said", "served", "shown", "taken",
    "told", "tried", "wanted",
})  # fmt: skip
"""Participles that were functions once."""

HOLDERS = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef

SEARCHED = (
    "hysteresis", "debounce", "threshold", "latency", "median", "95th percentile", "accuracy", "false alarm",
    "dropped frame", "reprojection error",
)  # fmt: skip


@cache
def tree_of(path):
    return ast.parse(path.read_text())


@cache
def nodes_of(path):
    return tuple(ast.walk(tree_of(path)))


@pytest.fixture(autouse=True, scope="module")
def _sources_are_parsed_once():
    yield
    tree_of.cache_clear()
    nodes_of.cache_clear()


def messages(path):
    """Return the texts of a source that people may see: all strings but the docstrings of what is no command."""
    unseen = {
        id(statement.value)
        for node in nodes_of(path)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and not is_command(node)
        for statement in node.body
        if isinstance(statement, ast.Expr)
    }
    return [
        node.value
        for node in nodes_of(path)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in unseen
    ]


def docstrings(path):
    """Return the docstrings of a source, as one text."""
    holders = (node for node in nodes_of(path) if isinstance(node, HOLDERS))
    return "\n".join(ast.get_docstring(node) or "" for node in holders)


def odd_names(path):
    """Return the names of a source that say in another way what the house says in one."""
    functions = [node for node in nodes_of(path) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    constants = [
        name.id
        for node in tree_of(path).body
        if isinstance(node, ast.Assign | ast.AnnAssign)
        for name in ast.walk(node)
        if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store)
    ]
    arguments = [each.arg for node in functions for each in (*node.args.args, *node.args.kwonlyargs)]
    return [
        *(name for name in constants if SUPERLATIVE.match(name)),
        *(node.name for node in functions if node.name.strip("_") in NO_VERBS and not is_property(node)),
        *(name for name in arguments if name == "otherwise"),
    ]


def is_property(node):
    return any("property" in ast.unparse(each) for each in node.decorator_list)


def is_command(node):
    return isinstance(node, ast.FunctionDef) and "**Exit code**" in (ast.get_docstring(node) or "")


def unwanted(text, patterns=UNWANTED):
    return {
        found[0]: instead
        for instead, pattern in patterns.items()
        for found in re.finditer(pattern, text, re.IGNORECASE)
    }


def test_documentation_uses_words_that_readers_know():
    found = {page: unwanted(page.read_text()) for page in [*PAGES, *CONFIGURATIONS]}
    assert {page: words for page, words in found.items() if words} == {}


@pytest.mark.long
def test_messages_use_words_that_readers_know():
    found = {path: unwanted("\n".join(messages(path))) for path in SOURCES}
    assert {path: words for path, words in found.items() if words} == {}


def test_docstrings_use_words_that_readers_know():
    found = {path: unwanted(docstrings(path), {**UNWANTED, **UNWANTED_IN_SOURCES}) for path in SOURCES}
    assert {path: words for path, words in found.items() if words} == {}


def test_functions_are_verbs_and_bounds_are_max_and_min():
    found = {path: odd_names(path) for path in SOURCES}
    assert {path: names for path, names in found.items() if names} == {}


def test_a_class_name_means_one_thing():
    classes = Counter(node.name for path in SOURCES for node in nodes_of(path) if isinstance(node, ast.ClassDef))
    assert {name for name, count in classes.items() if count > 1} <= set()


def test_words_that_readers_search_for_are_found():
    text = "\n".join(page.read_text() for page in PAGES).lower()
    assert [word for word in SEARCHED if word not in text] == []


def test_unwanted_words_are_recognised_and_their_likes_are_not():
    assert set(unwanted("Nobody is told, 3 ms in the middle, 95 in 100 below; it takes over so many")) == {
        "Nobody", "told", "in the middle", "95 in 100", "takes over", "so many",
    }  # fmt: skip
    assert unwanted("put it in the middle of the picture; test_it_is_told_nothing") == {}
