"""Source spans of the keys of a TOML text, so that an error can name its line.

The standard library's parser gives values without their source spans. This scanner gives spans without values: it runs
on a text that the parser has accepted, so it needs to know only where keys, strings and brackets begin and end.
"""

from __future__ import annotations

import copy
import re
import tomllib
from bisect import bisect_right
from collections.abc import Mapping
from typing import Any

from msgspec import Struct

from stadimeter.errors import ConfigError, Problem

# The path of a value: keys, and for entries of an array their numbers, counted from 0.
KeyPath = tuple[str | int, ...]

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_BLANK = re.compile(r"[ \t]*")
_BLANK_AND_COMMENTS = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_SCALAR = re.compile(r"[^,\]}\n#]*")
# The four kinds of strings; dots in them stand for line feeds too.
STRINGS = (r'"""(?:[^"\\]|\\.|"(?!""))*"{3,5}', r"'''(?:[^']|'(?!''))*'{3,5}", r'"(?:[^"\\\n]|\\.)*"', r"'[^'\n]*'")
_STRING = re.compile("|".join(STRINGS), re.DOTALL)
# The parser names a section as Python has it.
_BETWEEN_PARTS = "', '"
_WHERE = re.compile(r"\s*\(at (?:line (\d+), column (\d+)|end of document)\)$")


class SourceSpan(Struct, frozen=True, kw_only=True):
    """A stretch of one line.

    Attributes:
        line: Counted from 1.
        column: Where it begins, counted from 0.
        end_column: Where it ends, exclusive. What goes on over several lines ends with the first.
    """

    line: int
    column: int
    end_column: int


def key_spans(text: str) -> dict[KeyPath, SourceSpan]:
    """Find every table, key and array entry of a TOML text that `tomllib.loads` accepts.

    Returns:
        For each path the span where it is first written. A key's span goes from the key to the end of its value.
    """
    return _Scanner(text).scan()


def find_span(spans: Mapping[KeyPath, SourceSpan], path: KeyPath) -> SourceSpan | None:
    """Look up a path, or else the closest table around it; None if not even the path's first part is there."""
    return next((spans[path[:end]] for end in range(len(path), 0, -1) if path[:end] in spans), None)


def syntax_error(error: tomllib.TOMLDecodeError, text: str) -> tuple[str, int]:
    """Return the message of a syntax error without its position, and its line in the text, counted from 1."""
    message = re.sub(r"\('(.*?)',?\)", lambda path: f"[{path[1].replace(_BETWEEN_PARTS, '.')}]", str(error))
    where = _WHERE.search(message)
    if where is None:
        return message, 0
    last_line = len(text.rstrip().split("\n"))
    return message[: where.start()], int(where[1]) if where[1] else last_line


class _Scanner:
    """Goes through the text once, from the first character to the last.

    Attributes:
        array_sizes: How many entries each array of tables has so far.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.spans: dict[KeyPath, SourceSpan] = {}
        self.array_sizes: dict[KeyPath, int] = {}
        self.line_starts = [0, *(match.end() for match in re.finditer("\n", text))]

    def scan(self) -> dict[KeyPath, SourceSpan]:
        table: KeyPath = ()
        self._skip(_BLANK_AND_COMMENTS)
        while self.at < len(self.text):
            if self.text[self.at] == "[":
                table = self._header()
            else:
                self._key_and_value(table)
            self._skip(_BLANK_AND_COMMENTS)
        return self.spans

    def _header(self) -> KeyPath:
        start = self.at
        brackets = 2 if self.text.startswith("[[", start) else 1
        self.at += brackets
        keys = self._keys()
        self.at += brackets
        path: KeyPath = ()
        for number, key in enumerate(keys, start=1):
            path = (*path, key)
            self._note(path, start)
            if brackets == 2 and number == len(keys):
                self.array_sizes[path] = self.array_sizes.get(path, 0) + 1
            if path in self.array_sizes:
                path = (*path, self.array_sizes[path] - 1)
                self._note(path, start)
        return path

    def _key_and_value(self, table: KeyPath) -> None:
        start = self.at
        keys = self._keys()
        self.at += 1  # the equals sign
        self._skip(_BLANK)
        path = (*table, *keys)
        self._value(path)
        for end in range(len(table) + 1, len(path) + 1):
            self._note(path[:end], start)

    def _keys(self) -> list[str]:
        keys = []
        while True:
            self._skip(_BLANK)
            keys.append(self._key())
            self._skip(_BLANK)
            if self.text[self.at] != ".":
                return keys
            self.at += 1

    def _key(self) -> str:
        if self.text[self.at] in "\"'":
            quoted = self._take_string()
            parsed: str = tomllib.loads(f"key = {quoted}")["key"]
            return parsed
        return self._skip(_BARE_KEY)

    def _value(self, path: KeyPath) -> None:
        first = self.text[self.at]
        if first in "\"'":
            self._take_string()
        elif first == "[":
            self._array(path)
        elif first == "{":
            self._inline_table(path)
        else:
            scalar = self._skip(_SCALAR)
            self.at -= len(scalar) - len(scalar.rstrip())

    def _array(self, path: KeyPath) -> None:
        self.at += 1
        number = 0
        while self._comes_another("]"):
            start = self.at
            self._value((*path, number))
            self._note((*path, number), start)
            number += 1

    def _inline_table(self, path: KeyPath) -> None:
        self.at += 1
        while self._comes_another("}"):
            self._key_and_value(path)

    def _comes_another(self, closing: str) -> bool:
        self._skip(_BLANK_AND_COMMENTS)
        if self.text[self.at] == ",":
            self.at += 1
            self._skip(_BLANK_AND_COMMENTS)
        if self.text[self.at] != closing:
            return True
        self.at += 1
        return False

    def _take_string(self) -> str:
        return self._skip(_STRING)

    def _skip(self, pattern: re.Pattern[str]) -> str:
        match = pattern.match(self.text, self.at)
        if match is None:
            return ""
        self.at = match.end()
        return match[0]

    def _note(self, path: KeyPath, start: int) -> None:
        line = bisect_right(self.line_starts, start)
        line_start = self.line_starts[line - 1]
        line_end = self.line_starts[line] - 1 if line < len(self.line_starts) else len(self.text)
        end = min(self.at, line_end)
        self.spans.setdefault(path, SourceSpan(line=line, column=start - line_start, end_column=end - line_start))


# Changing one value in the text of a TOML file; comments, order and all else stay as they were written ----------------

# A key, which may be quoted, and its equals sign.
_KEY = re.compile(r"""(?:"(?:[^"\\]|\\.)*"|'[^']*'|[^="'])*=\s*""")
_BARE = re.compile(r"[A-Za-z0-9_-]+")


def set_value(text: str, path: KeyPath, value: str) -> str:
    """Return a text in which the value at a path is another one; it is added if it is not there.

    Args:
        text: One that `tomllib.loads` accepts.
        value: As TOML has it, such as ``"1.2 m"`` in its quotes.

    Raises:
        ConfigError: It stands there in a form that cannot be changed by itself, such as a value of several lines.
    """
    wanted = copy.deepcopy(tomllib.loads(text))
    try:
        _put(wanted, path, tomllib.loads(f"value = {value}")["value"])
        changed = _replaced(text, path, value)
        # What came out is compared with what was meant, so that no form of writing is changed by mistake.
        if tomllib.loads(changed) == wanted:
            return changed
    except (tomllib.TOMLDecodeError, LookupError, TypeError):
        pass
    message = f"{dotted(path)} is written in a form that cannot be changed here"
    raise ConfigError([Problem(message, key=dotted(path), hint=f"write {dotted(path)} = {value} by hand")])


def dotted(path: KeyPath) -> str:
    """Return a path as a key of TOML."""
    parts = [str(part) for part in path]
    return ".".join(part if _BARE.fullmatch(part) else '"' + part.replace('"', '\\"') + '"' for part in parts)


def _put(table: Any, path: KeyPath, value: object) -> None:
    for key in path[:-1]:
        table = table.setdefault(key, {}) if isinstance(key, str) else table[key]
    table[path[-1]] = value


def _replaced(text: str, path: KeyPath, value: str) -> str:
    spans, lines = key_spans(text), text.split("\n")
    if span := spans.get(path):
        key = _KEY.match(lines[span.line - 1], span.column) if isinstance(path[-1], str) else None
        return _put_between(lines, span, key.end() if key else span.column, span.end_column, value)
    for end in range(len(path) - 1, 0, -1):
        if (span := spans.get(path[:end])) is None:
            continue
        line, added = lines[span.line - 1], f"{dotted(path[end:])} = {value}"
        if line.startswith("[", span.column) and isinstance(path[end - 1], str):
            return "\n".join([*lines[: span.line], added, *lines[span.line :]])  # below the table's heading
        if line[span.column : span.end_column].endswith("}"):
            last = len(line[: span.end_column - 1].rstrip())
            return _put_between(lines, span, last, span.end_column - 1, f", {added} ")
    raise KeyError(path)


def _put_between(lines: list[str], span: SourceSpan, begin: int, end: int, words: str) -> str:
    line = lines[span.line - 1]
    return "\n".join([*lines[: span.line - 1], line[:begin] + words + line[end:], *lines[span.line :]])
