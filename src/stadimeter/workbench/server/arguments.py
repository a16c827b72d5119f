"""The arguments of operations, which come from a browser: each is looked at before it is used."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from stadimeter.errors import ConfigError


def get_text(args: Mapping[str, Any], key: str, default: str | None = None) -> str:
    """Return a text; a `ConfigError` if it is none, or is missing and there is nothing to take instead."""
    value = args.get(key, default)
    if not isinstance(value, str):
        raise ConfigError(f"{key} must be a text")
    return value


def get_number(args: Mapping[str, Any], key: str, default: float | None = None) -> float:
    """Return a finite number; a `ConfigError` as `get_text`."""
    value = args.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigError(f"{key} must be a number")
    return float(value)


def get_bool(args: Mapping[str, Any], key: str, *, default: bool = False) -> bool:
    """Return true or false; a `ConfigError` if it is neither."""
    value = args.get(key, default)
    if not isinstance(value, bool):
        raise ConfigError(f"{key} must be true or false")
    return value


def get_points(args: Mapping[str, Any], key: str) -> tuple[tuple[float, float], ...]:
    """Return places in a picture, none unless they are given; a `ConfigError` if one is no pair of numbers."""
    value = args.get(key, [])
    if not isinstance(value, list) or not all(isinstance(each, list) and len(each) == 2 for each in value):
        raise ConfigError(f"{key} must be a list of places such as [312, 240]")
    return tuple((get_number({key: x}, key), get_number({key: y}, key)) for x, y in value)


def get_texts(args: Mapping[str, Any], key: str) -> dict[str, str]:
    """Return texts by their names, none unless they are given; a `ConfigError` if they are something else."""
    value = args.get(key, {})
    if not isinstance(value, dict):
        raise ConfigError(f"{key} must be texts by their names")
    return {name: get_text(value, name) for name in value}
