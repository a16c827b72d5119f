"""What was written of a condition, beside what the core makes of it: so that a finding names the line and the words."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from stadimeter.config.toml_lines import KeyPath
from stadimeter.core.condition import AllOf, AnyOf, Condition, Leaf, Not

_LONGEST = 70
_OF_ONE_QUANTITY = ("bearing", "elevation", "closing_speed", "time_to_contact", "separation", "count", "time")
"""Conditions that are a table of their own inside the table of the condition."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WrittenCondition:
    """A condition and its table in the file.

    Attributes:
        path: Where the table stands.
        table: The table as it was written; empty if it is not known.
        condition: What the core makes of it.
    """

    path: KeyPath
    table: Mapping[str, Any]
    condition: Condition

    def parts(self) -> tuple[WrittenCondition, ...]:
        """Return the conditions that it is made of; none for a simple one."""
        match self.condition:
            case AllOf(conditions=conditions):
                return self._parts("all", conditions)
            case AnyOf(conditions=conditions):
                return self._parts("any", conditions)
            case Not(condition=condition):
                return (_at((*self.path, "not"), self.table.get("not"), condition),)
            case _:
                return ()

    def leaves(self) -> Iterator[WrittenCondition]:
        """Go through the simple conditions that it is made of, from left to right.

        Yields:
            Each of them.
        """
        parts = self.parts()
        if not parts:
            yield self
        for part in parts:
            yield from part.leaves()

    @property
    def leaf(self) -> Leaf:
        """The condition, which is a simple one.

        Raises:
            TypeError: It is not.
        """
        if isinstance(self.condition, AllOf | AnyOf | Not):
            raise TypeError(f"{self} is made of others")
        return self.condition

    @property
    def limits_path(self) -> KeyPath:
        """Where its limits stand: its own table, or the one inside it that names the quantity."""
        inner = next((key for key in _OF_ONE_QUANTITY if isinstance(self.table.get(key), Mapping)), None)
        return self.path if inner is None else (*self.path, inner)

    def __str__(self) -> str:
        """Return the table as it was written, short enough for a message."""
        text = toml_of(self.table)
        return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"

    def _parts(self, key: str, conditions: tuple[Condition, ...]) -> tuple[WrittenCondition, ...]:
        tables = self.table.get(key)
        entries: list[Any] = tables if isinstance(tables, list) and len(tables) == len(conditions) else []
        known = entries or [None] * len(conditions)
        return tuple(
            _at((*self.path, key, number), table, condition)
            for number, (table, condition) in enumerate(zip(known, conditions, strict=True))
        )


def _at(path: KeyPath, table: object, condition: Condition) -> WrittenCondition:
    return WrittenCondition(path=path, table=table if isinstance(table, Mapping) else {}, condition=condition)


def toml_of(value: object) -> str:
    """Write a value as TOML, in one line.

    Args:
        value: What the TOML parser gave.

    Returns:
        Such as ``{ below = "50 cm" }``.
    """
    match value:
        case Mapping():
            return f"{{ {', '.join(f'{key} = {toml_of(entry)}' for key, entry in value.items())} }}"
        case list():
            return f"[{', '.join(toml_of(entry) for entry in value)}]"
        case bool():
            return str(value).lower()
        case str():
            return json.dumps(value, ensure_ascii=False)
        case _:
            return str(value)
