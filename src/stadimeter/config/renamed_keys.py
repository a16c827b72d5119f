"""Keys of configurations that were renamed: the old name goes on to work, with a warning that names the new one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from msgspec.structs import replace

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


def with_current_keys(source: TomlSource) -> tuple[TomlSource, tuple[Finding, ...]]:
    """Return a source in which every key has its current name, and a warning for each that had not.

    A table that holds a key by both names is left as it is: the old one is then unknown.
    """
    renamed = dict(_renamed(source.table))
    if not renamed:
        return source, ()
    spans = {_current(path, renamed): span for path, span in source.spans.items()}
    findings = tuple(
        Finding(path, f"'{path[-1]}' is now called '{new}'", "rename it; the old name still works", "renamed-key")
        for path, new in renamed.items()
    )
    return replace(source, table=current_keys(source.table), spans={**source.spans, **spans}), findings


def current_keys(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table of a configuration in which every key has its current name."""
    renamed = dict(_renamed(table))

    def copy(value: Any, at: KeyPath = ()) -> Any:
        if not isinstance(value, Mapping):
            return value
        return {renamed.get((*at, key), key): copy(inner, (*at, key)) for key, inner in value.items()}

    current: dict[str, Any] = copy(table)
    return current


def _current(path: KeyPath, renamed: Mapping[KeyPath, str]) -> KeyPath:
    """Return a path with the new names: what stands below an old key stands below the new one."""
    return tuple(renamed.get(path[:end], key) for end, key in enumerate(path, start=1))


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
