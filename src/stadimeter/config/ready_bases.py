"""Tables of several bases in one file, of which a line chooses: ``driver`` in ``[base]``.

A table such as ``[base.pca9685]`` holds keys of that driver. Those of the chosen driver count as if they stood in
``[base]``; the others are only checked, so that the line can be changed at any time.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from msgspec.structs import replace

from stadimeter.config.driver_tables import BASE, validate
from stadimeter.config.findings import Finding
from stadimeter.config.plugins import driver_names, load_driver
from stadimeter.config.toml_source import TomlSource
from stadimeter.errors import DriverError

_AT = ("base",)


def with_chosen_base(source: TomlSource, context: Mapping[str, Any]) -> tuple[TomlSource, list[Finding]]:
    """Return a source in which ``[base]`` has the keys of its driver only, and what is wrong in other drivers' tables.

    Args:
        context: For the validation of options.
    """
    base = source.table.get("base")
    if not isinstance(base, Mapping) or not any(isinstance(value, Mapping) for value in base.values()):
        return source, []
    names = driver_names(BASE.group)
    ready = {name: value for name, value in base.items() if name in names and isinstance(value, Mapping)}
    chosen = base.get(BASE.key)
    own = ready.pop(chosen, {}) if isinstance(chosen, str) else {}
    findings: list[Finding] = []
    for name, table in ready.items():
        _check(name, table, context, findings)
    taken = {*ready, chosen} if own else set(ready)
    shared = {key: value for key, value in base.items() if key not in taken}
    spans = {
        (*_AT, *path[2:]): span
        for path, span in source.spans.items()
        if own and path[:2] == (*_AT, chosen) and path[2:]
    }
    return replace(source, table={**source.table, "base": {**shared, **own}}, spans={**source.spans, **spans}), findings


def _check(name: str, table: Mapping[str, Any], context: Mapping[str, Any], findings: list[Finding]) -> None:
    try:
        model = load_driver(BASE.group, name)
    except DriverError:  # not chosen: what it lacks matters once it is
        return
    validate(model, table, (*_AT, name), context, findings)
