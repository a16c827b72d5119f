"""A JSON Schema of the whole configuration, from which editors complete and check while somebody writes one.

It is made from the same models that read a configuration, those of every installed driver included. What only the
whole can tell, such as whether a rule's target exists, is left to ``stadimeter check``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from stadimeter.config import camera_file, driver_tables, models, plugins
from stadimeter.config.driver_tables import DriverKind
from stadimeter.config.plugins import Plugin
from stadimeter.config.rule_tests.tables import RuleTestTable
from stadimeter.config.rules.tables import KINDS, RuleTable
from stadimeter.config.schema_generator import JsonSchema, described, schemas_of
from stadimeter.errors import DriverError

DIALECT = "https://json-schema.org/draft/2020-12/schema"

_REFERENCE = re.compile(r'"#/\$defs/([^"]+)"')
_NAME = {"pattern": "^[A-Za-z0-9_-]+$"}
_ONE: dict[str, DriverKind[Any]] = {
    "camera": driver_tables.CAMERA,
    "base": driver_tables.BASE,
    "messenger": driver_tables.MESSENGER,
    "world": driver_tables.WORLD,
}
_MANY: dict[str, DriverKind[Any]] = {
    "targets": driver_tables.TARGET,
    "actuators": driver_tables.ACTUATOR,
    "notifiers": driver_tables.NOTIFIER,
}
_TABLES: dict[str, type[BaseModel]] = {"tracking": models.TrackingTable, "safety": models.SafetyTable}
_SECTIONS = {
    "camera": "What looks: its driver, and the lens.",
    "targets": "What is looked for, by name; at least one.",
    "actuators": "What can be driven, by name: motors, buzzers, lamps.",
    "base": "What can drive about.",
    "messenger": "What tells other programs.",
    "notifiers": "What tells people, by name.",
    "world": "The simulated world, for simulated drivers.",
    "rules": "What to do when, by name.",
    "tests": "What the rules are tested with, by the command stadimeter test.",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Driver:
    """An installed driver.

    Attributes:
        options: The model of its own options; None if a library that it needs is missing.
    """

    kind: DriverKind[Any]
    name: str
    options: type[BaseModel] | None


def configuration_schema() -> JsonSchema:
    """Return the JSON Schema of a configuration.

    Returns:
        A schema in the dialect of draft 2020-12, with only what JSON knows.
    """
    drivers = [driver for kind in (*_ONE.values(), *_MANY.values()) for driver in _drivers(kind)]
    by_model, definitions = schemas_of(_models(drivers))
    sections: dict[str, JsonSchema] = {}
    for section, kind in (_ONE | _MANY).items():
        table = _driver_table(section, [driver for driver in drivers if driver.kind is kind], by_model, definitions)
        sections[section] = table if section in _ONE else _named(table)
    sections |= {section: {**by_model[model], "description": described(model)} for section, model in _TABLES.items()}
    sections["rules"] = _named(_rule(by_model, definitions))
    sections["tests"] = {"type": "array", "items": by_model[RuleTestTable]}
    return _without_unused(
        {
            "$schema": DIALECT,
            "title": "stadimeter configuration",
            "description": "What a camera looks for, and what happens depending on how far away it is.",
            "type": "object",
            "properties": {
                section: {**sections[section], **({"description": _SECTIONS[section]} if section in _SECTIONS else {})}
                for section in models.SECTIONS
            },
            "required": ["camera", "targets"],
            "additionalProperties": False,
            "$defs": definitions,
        }
    )


def _drivers(kind: DriverKind[Any]) -> Iterator[_Driver]:
    for name in plugins.driver_names(kind.group):
        try:
            plugin: Plugin[Any] | None = plugins.load_plugin(kind.group, name)
        except DriverError:  # its library is missing: its name is known, and not its keys
            plugin = None
        yield _Driver(kind=kind, name=name, options=plugin.options if plugin else None)


def _models(drivers: list[_Driver]) -> list[type[BaseModel]]:
    own = [driver.options for driver in drivers if driver.options is not None]
    common = [driver.kind.common for driver in drivers]
    return [camera_file.CameraTable, RuleTable, RuleTestTable, *_TABLES.values(), *common, *own]


def _driver_table(
    section: str,
    drivers: list[_Driver],
    by_model: dict[type[BaseModel], JsonSchema],
    definitions: dict[str, JsonSchema],
) -> JsonSchema:
    """Return the schema of a table that names a driver, on which it depends what else it may hold.

    ``if`` and ``then`` tell validators exactly which driver is meant. Editors that do not know these two complete from
    the alternatives of ``anyOf``, which say the same.
    """
    if not drivers:  # somebody has taken a package apart
        return {"type": "object"}
    kind = drivers[0].kind
    references = {}
    for driver in drivers:
        definitions[f"{section}.{driver.name}"] = _one_driver(driver, by_model, definitions)
        references[driver.name] = {"$ref": f"#/$defs/{section}.{driver.name}"}
    needed = [] if kind.default else [kind.key]
    return {
        "type": "object",
        "properties": {kind.key: {"enum": list(references)}},
        "required": needed,
        "anyOf": list(references.values()),
        "allOf": [
            {
                "if": {
                    "properties": {kind.key: {"const": name}},
                    "required": [] if name == kind.default else [kind.key],
                },
                "then": reference,
            }
            for name, reference in references.items()
        ],
    }


def _one_driver(
    driver: _Driver, by_model: dict[type[BaseModel], JsonSchema], definitions: dict[str, JsonSchema]
) -> JsonSchema:
    kind = driver.kind
    common = _resolved(by_model[kind.common], definitions)
    own = _resolved(by_model[driver.options], definitions) if driver.options else {}
    needed = [
        *([] if driver.name == kind.default else [kind.key]),
        *common.get("required", ()),
        *own.get("required", ()),
    ]
    properties = {
        kind.key: {"const": driver.name, "description": own.get("description", "")},
        **common.get("properties", {}),
        **own.get("properties", {}),
    }
    if kind is driver_tables.CAMERA:
        properties["model"] = _camera_model(common["properties"]["model"], by_model)
    return {
        "description": own.get("description", f"{driver.name}: its library is not installed."),
        "type": "object",
        "properties": properties,
        "required": needed,
        "additionalProperties": driver.options is None,
    }


def _camera_model(model: JsonSchema, by_model: dict[type[BaseModel], JsonSchema]) -> JsonSchema:
    return {**model, "anyOf": [{"type": "string"}, by_model[camera_file.CameraTable]]}


def _rule(by_model: dict[type[BaseModel], JsonSchema], definitions: dict[str, JsonSchema]) -> JsonSchema:
    table = _resolved(by_model[RuleTable], definitions)
    return {**table, "oneOf": [{"required": [kind]} for kind in KINDS]}


def _resolved(schema: JsonSchema, definitions: dict[str, JsonSchema]) -> JsonSchema:
    reference = schema.get("$ref")
    return schema if reference is None else definitions[reference.removeprefix("#/$defs/")]


def _without_unused(schema: JsonSchema) -> JsonSchema:
    definitions = schema["$defs"]
    used: set[str] = set()
    left = [{key: value for key, value in schema.items() if key != "$defs"}]
    while left:
        found = set(_REFERENCE.findall(json.dumps(left.pop()))) - used
        used |= found
        left += [definitions[name] for name in found]
    return {**schema, "$defs": {name: definition for name, definition in definitions.items() if name in used}}


def _named(table: JsonSchema) -> JsonSchema:
    return {"type": "object", "propertyNames": _NAME, "additionalProperties": table}
