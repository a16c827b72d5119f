"""How deep the tables and lists of a TOML text stand inside each other, before anything is made of it.

The standard library's parser calls itself for every list inside a list, and runs out of stack. Keys with many dots it
bears, but each of them costs as much time as it is deep. So a text that nobody can have meant is refused first.
"""

from __future__ import annotations

import re
import tomllib
from typing import Any

DEEPEST = 64
"""Enough for 20 conditions inside each other, in lists, in the table of a rule."""

_MARK = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*"{3,5}|'
    r"'''(?:[^']|'(?!''))*'{3,5}|"
    r'"(?:[^"\\\n]|\\.)*"|'
    r"'[^'\n]*'|"
    r"#[^\n]*|"
    r"[\[\]{}.,\n]",
    re.DOTALL,
)
_OPENING, _CLOSING, _NEXT = frozenset("[{"), frozenset("]}"), frozenset(",\n")


def loads(text: str) -> dict[str, Any]:
    """Parse a TOML text, but not one that nests too deep.

    Args:
        text: The text.

    Returns:
        What the standard library's parser returns.

    Raises:
        tomllib.TOMLDecodeError: It is not TOML, or nests too deep.
    """
    line = line_that_is_too_deep(text)
    if line:
        message = f"Tables and lists stand inside each other more than {DEEPEST} deep (at line {line}, column 1)"
        raise tomllib.TOMLDecodeError(message)
    return tomllib.loads(text)


def line_that_is_too_deep(text: str, deepest: int = DEEPEST) -> int:
    """Return where a text first nests deeper than it may.

    Args:
        text: A TOML text, valid or not.
        deepest: So many tables and lists may stand inside each other, the keys of dotted names counted one by one. What
            stands below a header is counted without it.

    Returns:
        The line, counted from 1; 0 if nowhere.
    """
    around: list[int] = []  # how deep each open bracket stands
    depth = 0
    for match in _MARK.finditer(text):
        mark = match[0]
        if mark in _OPENING:
            depth += 1
            around.append(depth)
        elif mark in _CLOSING:
            depth = around[-2] if len(around) > 1 else 0
            del around[-1:]
        elif mark in _NEXT:
            depth = around[-1] if around else 0
        elif mark == ".":
            depth += 1
        if depth > deepest:
            return text.count("\n", 0, match.start()) + 1
    return 0
