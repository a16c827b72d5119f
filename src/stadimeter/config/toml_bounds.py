"""How deep the tables of a TOML text stand inside each other, and how long its words are, before it is parsed.

The standard library's parser calls itself for every list inside a list, and runs out of stack. Keys with many dots it
bears, but each of them costs as much time as it is deep. A number of more than 4,300 digits it cannot convert at all.
So a text that nobody can have meant is refused first, with its line.
"""

from __future__ import annotations

import re

DEEPEST = 64
"""Enough for 20 conditions inside each other, in lists, in the table of a rule."""

LONGEST_WORD = 200
"""Enough for every number and for every name that is written without quotes."""

_MARK = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*"{3,5}|'
    r"'''(?:[^']|'(?!''))*'{3,5}|"
    r'"(?:[^"\\\n]|\\.)*"|'
    r"'[^'\n]*'|"
    r"#[^\n]*|"
    r"[A-Za-z0-9_+-]+|"
    r"[\[\]{}.,\n]",
    re.DOTALL,
)
_OPENING, _CLOSING, _NEXT, _TEXT = frozenset("[{"), frozenset("]}"), frozenset(",\n"), frozenset("\"'#")


def why_out_of_bounds(text: str) -> tuple[str, int] | None:
    """Return why a text cannot be meant as a configuration.

    Tables and lists that stand inside each other are counted together with the keys of dotted names, one by one; what
    stands below a header is counted without it.

    Returns:
        What is wrong, and the line where it first is, counted from 1; None if nothing is.
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
        if depth > DEEPEST:
            message = f"tables and lists stand inside each other more than {DEEPEST} deep"
            return message, text.count("\n", 0, match.start()) + 1
        if len(mark) > LONGEST_WORD and mark[0] not in _TEXT:
            message = f"a number or a name of {len(mark)} characters; the longest that is read has {LONGEST_WORD}"
            return message, text.count("\n", 0, match.start()) + 1
    return None
