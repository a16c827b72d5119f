"""The JSON Schema: the keys of each of its tables, and a digest of what they may hold. Words do not count."""

from __future__ import annotations

from typing import Any

from stadimeter.config.schema import configuration_schema
from support.golden import Golden, digest

WORDS = ("title", "description", "examples", "markdownDescription")


def test_the_schema_has_the_keys_it_had(golden: Golden) -> None:
    schema = _without_words(configuration_schema())
    tables = {"the file": schema, **schema.pop("$defs")}
    golden.compare("schema", {name: _keys(table) for name, table in sorted(tables.items())})


def _keys(table: dict[str, Any]) -> str:
    """Return a digest of a table, and the names of its keys."""
    return " ".join((digest(table), *sorted(table.get("properties", ()))))


def _without_words(part: Any, *, is_keys: bool = False) -> Any:
    """Return a part of the schema without what people read; the keys of a table may have any name."""
    if isinstance(part, dict):
        return {
            key: _without_words(inner, is_keys=key == "properties" and not is_keys)
            for key, inner in part.items()
            if is_keys or key not in WORDS
        }
    return [_without_words(inner) for inner in part] if isinstance(part, list) else part
