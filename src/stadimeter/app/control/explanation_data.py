"""Explanations as JSON has them."""

from __future__ import annotations

from typing import Any

from stadimeter.core.rules.explaining import Explanation


def as_data(explanation: Explanation) -> dict[str, Any]:
    """Return an explanation as JSON has it.

    Returns:
        Objects, lists, texts, finite numbers and null only.
    """
    from pydantic import TypeAdapter  # noqa: PLC0415 - only needed here

    adapter = TypeAdapter(Explanation)
    data: dict[str, Any] = adapter.dump_python(explanation, mode="json")
    return {key: _without_infinities(value) for key, value in data.items()}


def _without_infinities(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_infinities(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_without_infinities(inner) for inner in value]
    if isinstance(value, float) and value - value != 0.0:  # infinite, or no number
        return None
    return value
