"""Changing one value in the text of a TOML file; comments, order and all else stay as they were written."""

from __future__ import annotations

import copy
import re
import tomllib
from typing import Any

from stadimeter.config.toml_lines import KeyPath, SourceSpan, key_spans
from stadimeter.errors import ConfigError, Problem

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
