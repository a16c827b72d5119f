"""Keys of configurations that were renamed: the old name goes on to work, with a warning that names the new one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from stadimeter.config.findings import Finding
from stadimeter.config.toml_lines import KeyPath
from stadimeter.config.toml_source import TomlSource

# Stands for every name of a table of tables.
_ANY = "*"

# The new name of each key, by its old path.
RENAMED: Mapping[tuple[str, ...], str] = {
    ("rules", _ANY, "then"): "escalation",
    ("tracking", "correlation"): "autocorrelation",
}

_LENGTHS = sorted({len(path) for path in RENAMED})


def with_current_keys(source: TomlSource) -> tuple[TomlSource, tuple[Finding, ...]]:
    """Return a source in which every key has its current name, and a warning for each that had not.

    A table that holds a key by both names is left as it is: the old one is then unknown.
    """
    renamed = dict(_renamed(source.table))
    if not renamed:
        return source, ()
    spans = dict(source.spans)
    for path, span in source.spans.items():
        for end in _LENGTHS:  # what stands below the old key stands below the new one
            if path[:end] in renamed:
                spans[(*path[: end - 1], renamed[path[:end]], *path[end:])] = span
    findings = tuple(
        Finding(path, f"'{path[-1]}' is now called '{new}'", "rename it; the old name still works", "renamed-key")
        for path, new in renamed.items()
    )
    return replace(source, table=current_keys(source.table), spans=spans), findings


def current_keys(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table of a configuration in which every key has its current name."""
    current = dict(table)
    for path, new in _renamed(table):
        holder = current
        for key in path[:-1]:  # copied on the way: the original stays as it was written
            holder[str(key)] = holder = dict(holder[str(key)])
        old = path[-1]
        renamed = {new if key == old else key: value for key, value in holder.items()}
        holder.clear()
        holder.update(renamed)
    return current


def _renamed(table: Mapping[str, Any]) -> Iterator[tuple[KeyPath, str]]:
    for pattern, new in RENAMED.items():
        for path, holder in _holders(table, pattern[:-1]):
            if pattern[-1] in holder and new not in holder:
                yield (*path, pattern[-1]), new


def _holders(table: Any, pattern: tuple[str, ...], at: KeyPath = ()) -> Iterator[tuple[KeyPath, Mapping[str, Any]]]:
    if not isinstance(table, Mapping):
        return
    if not pattern:
        yield at, table
        return
    for key in table if pattern[0] == _ANY else [each for each in table if each == pattern[0]]:
        yield from _holders(table[key], pattern[1:], (*at, key))
