"""A JSON Schema of the whole configuration, from which editors complete and check while one is written.

It is made from the same models that read a configuration, those of every installed driver included. What only the
whole can tell, such as whether a rule's target exists, is left to ``stadimeter check``.
"""

from __future__ import annotations

import ast
import inspect
import math
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaMode, JsonSchemaValue, models_json_schema
from pydantic_core import core_schema

from stadimeter.config import camera_file, models, plugins
from stadimeter.config.driver_tables import CAMERA, DRIVER_KINDS, DriverKind
from stadimeter.config.landmark_tables import LandmarksTable
from stadimeter.config.optional_tables import OPTIONAL_TABLES
from stadimeter.config.rule_test_tables import RuleTestTable
from stadimeter.config.rules.conditions import FigureTable
from stadimeter.config.rules.tables import GATED, RuleTable
from stadimeter.errors import DriverError

JsonSchema = dict[str, Any]

# The unit of a figure once it was read; it is written with a unit of its own.
_IN_UNITS = re.compile(
    r"^In (?:metres|seconds|bytes|radians|hertz|volts|m/s²?|rad/s²?)\b(?: since midnight)?(?:[;,] |\.$)"
)

DIALECT = "https://json-schema.org/draft/2020-12/schema"

_NAME = {"pattern": "^[A-Za-z0-9_-]+$"}
_TABLES: dict[str, type[BaseModel]] = {**OPTIONAL_TABLES, "landmarks": LandmarksTable}
_SECTIONS = {
    "camera": "The camera: its driver and its lens.",
    "second_camera": "A second camera beside the first one, for distances without a size.",
    "targets": "The objects to look for, by name; at least one.",
    "actuators": "The outputs, by name: motors, buzzers, lamps.",
    "base": "The robot's base.",
    "sensors": "The range sensors, by name. Rules may name them as targets.",
    "status_led": "A light that shows whether it runs well.",
    "buttons": "Push buttons, by name, and what each does.",
    "messenger": "The link to other programs, such as MQTT.",
    "notifiers": "The ways to notify people, by name.",
    "world": "The simulated world, for simulated drivers.",
    "figures": "Figures that are remembered over a window of time, by name.",
    "rules": "The rules, by name: what to do at which distance.",
    "tests": "Tests of the rules, for the command stadimeter test.",
}


def configuration_schema() -> JsonSchema:
    """Return the JSON Schema of a configuration, in the dialect of draft 2020-12, with only what JSON knows."""
    drivers = {section: dict(_drivers(kind)) for section, kind in DRIVER_KINDS.items()}
    own = [options for each in drivers.values() for options in each.values() if options is not None]
    common = [kind.common for kind in DRIVER_KINDS.values()]
    by_model, definitions = _schemas_of(
        [camera_file.CameraModelTable, FigureTable, RuleTable, RuleTestTable, *_TABLES.values(), *common, *own]
    )
    sections: dict[str, JsonSchema] = {}
    for section, kind in DRIVER_KINDS.items():
        table = _driver_table(section, drivers[section], by_model, definitions)
        sections[section] = _named(table) if kind.is_named else table
    sections |= {
        section: {**by_model[model], "description": describe_model(model)} for section, model in _TABLES.items()
    }
    sections["figures"] = _named(by_model[FigureTable])
    sections["rules"] = _named(_rule(by_model, definitions))
    sections["tests"] = {"type": "array", "items": by_model[RuleTestTable]}
    return {
        "$schema": DIALECT,
        "title": "stadimeter configuration",
        "description": "The target of a camera, and what happens depending on its distance.",
        "type": "object",
        "properties": {
            section: {**sections[section], **({"description": _SECTIONS[section]} if section in _SECTIONS else {})}
            for section in models.SECTIONS
        },
        "required": ["camera", "targets"],
        "additionalProperties": False,
        "$defs": definitions,
    }


def _drivers(kind: DriverKind) -> Iterator[tuple[str, type[BaseModel] | None]]:
    """Go through the installed drivers of a kind: name and options, None if a library that it needs is missing."""
    for name in plugins.driver_names(kind.group):
        try:
            yield name, plugins.load_driver(kind.group, name)
        except DriverError:  # its name is known, and not its keys
            yield name, None


def _driver_table(
    section: str,
    drivers: Mapping[str, type[BaseModel] | None],
    by_model: dict[type[BaseModel], JsonSchema],
    definitions: dict[str, JsonSchema],
) -> JsonSchema:
    """Return the schema of a table that names a driver, on which it depends what else it may hold.

    Editors complete from the alternatives of ``anyOf``; not all of them know ``if`` and ``then``.
    """
    if not drivers:  # a package was taken apart
        return {"type": "object"}
    kind = DRIVER_KINDS[section]
    for name, options in drivers.items():
        definitions[f"{section}.{name}"] = _one_driver(kind, name, options, by_model, definitions)
    return {
        "type": "object",
        "properties": {kind.key: {"enum": list(drivers)}},
        "required": [] if kind.default else [kind.key],
        "anyOf": [{"$ref": f"#/$defs/{section}.{name}"} for name in drivers],
    }


def _one_driver(
    kind: DriverKind,
    name: str,
    options: type[BaseModel] | None,
    by_model: dict[type[BaseModel], JsonSchema],
    definitions: dict[str, JsonSchema],
) -> JsonSchema:
    common = _resolved(by_model[kind.common], definitions)
    own = _resolved(by_model[options], definitions) if options else {}
    needed = [*([] if name == kind.default else [kind.key]), *common.get("required", ()), *own.get("required", ())]
    properties = {
        kind.key: {"const": name, "description": own.get("description", "")},
        **_shared_keys(by_model[kind.common], definitions),
        **(_shared_keys(by_model[options], definitions) if options else {}),
    }
    if kind is CAMERA:
        properties["model"] = _camera_model(common["properties"]["model"], by_model)
    return {
        "description": own.get("description", f"{name}: its library is not installed."),
        "type": "object",
        "properties": properties,
        "required": needed,
        **({"anyOf": own["anyOf"]} if "anyOf" in own else {}),
        "additionalProperties": options is None,
    }


def _camera_model(model: JsonSchema, by_model: dict[type[BaseModel], JsonSchema]) -> JsonSchema:
    return {**model, "anyOf": [{"type": "string"}, by_model[camera_file.CameraModelTable]]}


def _rule(by_model: dict[type[BaseModel], JsonSchema], definitions: dict[str, JsonSchema]) -> JsonSchema:
    table = _resolved(by_model[RuleTable], definitions)
    each = [{"required": [kind]} for kind in GATED]
    return {**table, "oneOf": [*each, {"required": ["when"], "not": {"anyOf": each}}]}


def _resolved(schema: JsonSchema, definitions: dict[str, JsonSchema]) -> JsonSchema:
    reference = schema.get("$ref")
    return schema if reference is None else definitions[reference.removeprefix("#/$defs/")]


def _shared_keys(schema: JsonSchema, definitions: dict[str, JsonSchema]) -> JsonSchema:
    """Return the keys of a table, each as a reference to where it is described: several tables have the same."""
    keys: JsonSchema = _resolved(schema, definitions).get("properties", {})
    reference = schema.get("$ref")
    return keys if reference is None else {key: {"$ref": f"{reference}/properties/{key}"} for key in keys}


def _named(table: JsonSchema) -> JsonSchema:
    return {"type": "object", "propertyNames": _NAME, "additionalProperties": table}


def _schemas_of(models: Sequence[type[BaseModel]]) -> tuple[dict[type[BaseModel], JsonSchema], dict[str, JsonSchema]]:
    """Return the JSON Schemas of models, and the definitions that they refer to as ``#/$defs/NAME``."""
    unique = dict.fromkeys(models)
    mode: JsonSchemaMode = "validation"
    made, whole = models_json_schema([(model, mode) for model in unique], schema_generator=_Generator)
    return {model: made[model, mode] for model in unique}, whole.get("$defs", {})


def describe_model(model: type[BaseModel]) -> str:
    """Return the first sentence of a model's docstring, without what is meant for those who read the code."""
    first = (inspect.getdoc(model) or "").partition("\n")[0]
    return _for_writers(_plain(first.partition("; see `")[0].rstrip(".") + "."), model)


class _Generator(GenerateJsonSchema):
    """Writes down what a person may write, which is not what the program computes with."""

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        made = super().model_schema(schema)
        made.pop("title", None)
        model = schema["cls"]
        documented = dict(documented_fields(model))
        for name, field in model.model_fields.items():
            written = made.get("properties", {}).get(field.alias or name)
            if written is not None and name in documented:
                written.setdefault("description", _for_writers(documented[name]))
        made["description"] = describe_model(model)
        return made

    def function_before_schema(self, schema: core_schema.BeforeValidatorFunctionSchema) -> JsonSchemaValue:
        inner = super().function_before_schema(schema)
        if "items" in inner:  # such functions take one for a list of one
            return {"anyOf": [inner, inner["items"]]}
        # What a driver parses by itself is not known here, unless it says so by `pydantic.WithJsonSchema`.
        return inner if inner.get("type") == "string" or "anyOf" in inner or "properties" in inner else {}

    def is_instance_schema(self, _schema: core_schema.IsInstanceSchema) -> JsonSchemaValue:
        return {}  # what a driver parses into a value of its own

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        made = super().default_schema(schema)
        default = made.get("default")
        if isinstance(default, list) and default[1:] == [None]:  # a figure that does not say how well it is known
            default = made["default"] = default[0]
        if default in (None, math.inf) or isinstance(default, dict):
            made.pop("default", None)
        elif "x-unit" in made and isinstance(default, int | float):
            made["default"] = f"{default:g} {made['x-unit']}"
        return made

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])  # TOML knows no null

    def field_title_should_be_set(self, schema: Any) -> bool:  # noqa: ARG002 - a key says as much as its title
        return False


def documented_fields(model: type[BaseModel]) -> Iterator[tuple[str, str]]:
    """Go through the texts below the fields of a model and of its bases; what comes later replaces.

    Pydantic's `use_attribute_docstrings` reads the same texts, but whenever a model is declared: that costs each start
    of the program as much as the models themselves.
    """
    for each in reversed(model.__mro__):
        if not issubclass(each, BaseModel) or each is BaseModel:
            continue
        try:
            (declared,) = ast.parse(textwrap.dedent(inspect.getsource(each))).body
        except OSError:  # a driver that is installed without its source
            continue
        for field, text in pairwise(declared.body if isinstance(declared, ast.ClassDef) else ()):
            match field, text:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(words))):
                    yield name, _plain(" ".join(words.split()))


def _plain(words: str) -> str:
    return words.replace('"``', '"').replace('``"', '"').replace("``", '"')


def _for_writers(words: str, model: type[BaseModel] | None = None) -> str:
    """Say to those who write a configuration what the docstring says to those who read the code."""
    for name, field in (model.model_fields if model else {}).items():
        words = words.replace(f"`{name}`", f"`{field.alias or name}`")
    words = _IN_UNITS.sub("", words).replace("None compares", '"none" compares')
    words = re.sub(r"\bNone (?=for|if|where|to)", "left out ", words)
    words = re.sub(r"\bNone (?=\w+s )", "left out, it ", words)
    return re.sub(r"(?:^|\. )[a-z]", lambda start: start[0].upper(), words)
