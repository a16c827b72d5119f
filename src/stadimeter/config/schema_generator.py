"""JSON Schemas of the models of a configuration: what may be written, described by the docstrings of their fields."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaMode, JsonSchemaValue, models_json_schema
from pydantic_core import core_schema

JsonSchema = dict[str, Any]

_IN_UNITS = re.compile(r"^In (?:metres|seconds|radians|hertz|m/s²?|rad/s²?)\b(?: since midnight)?(?:[;,] |\.$)")
"""What a figure is in once it was read; it is written with a unit of its own."""
_FOR_NUMBERS = ("exclusiveMinimum", "exclusiveMaximum", "minimum", "maximum", "multipleOf")


def schemas_of(models: Sequence[type[BaseModel]]) -> tuple[dict[type[BaseModel], JsonSchema], dict[str, JsonSchema]]:
    """Return the JSON Schemas of models.

    Returns:
        The schema of each, and the definitions that they refer to as ``#/$defs/NAME``.
    """
    unique = dict.fromkeys(models)
    mode: JsonSchemaMode = "validation"
    made, whole = models_json_schema([(model, mode) for model in unique], schema_generator=_Generator)
    definitions = {name: _tidy(schema) for name, schema in whole.get("$defs", {}).items()}
    return {model: _tidy(made[model, mode]) for model in unique}, definitions


def described(model: type[BaseModel]) -> str:
    """Return what a model is, in one sentence.

    Returns:
        The first sentence of its docstring, without what is meant for those who read the code.
    """
    first = (inspect.getdoc(model) or "").partition("\n")[0]
    return _for_writers(_plain(first.partition("; see `")[0].rstrip(".") + "."), model)


class _Generator(GenerateJsonSchema):
    """Writes down what a person may write, which is not what the program computes with."""

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        made = super().model_schema(schema)
        model = schema["cls"]
        documented = dict(_attributes(model))
        for name, field in model.model_fields.items():
            written = made.get("properties", {}).get(field.alias or name)
            if written is not None and name in documented:
                written.setdefault("description", _for_writers(documented[name]))
        made["description"] = described(model)
        return made

    def function_before_schema(self, schema: core_schema.BeforeValidatorFunctionSchema) -> JsonSchemaValue:
        inner = super().function_before_schema(schema)
        if "items" in inner:  # such functions take one for a list of one
            return {"anyOf": [inner, inner["items"]]}
        # What a driver parses by itself is not known here, unless it says so by `pydantic.WithJsonSchema`.
        return inner if inner.get("type") == "string" or "anyOf" in inner else {}

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        made = super().default_schema(schema)
        if made.get("default") is None or isinstance(made.get("default"), dict):
            made.pop("default", None)
        return made


def _attributes(model: type[BaseModel]) -> Iterator[tuple[str, str]]:
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


def _tidy(schema: Any) -> Any:
    """Leave out what TOML does not know and what says nothing, and write defaults as a person would."""
    if isinstance(schema, list):
        return [_tidy(entry) for entry in schema]
    if not isinstance(schema, Mapping):
        return schema
    tidy = {key: _tidy_properties(value) if key == "properties" else _tidy(value) for key, value in schema.items()}
    if not isinstance(tidy.get("title"), Mapping):
        tidy.pop("title", None)
    tidy = _without_null(tidy)
    unit = tidy.pop("x-unit", None)
    if unit is not None and isinstance(tidy.get("default"), int | float):
        tidy["default"] = f"{tidy['default']:g} {unit}"
    if tidy.get("type") == "string":
        tidy = {key: value for key, value in tidy.items() if key not in _FOR_NUMBERS}
    return tidy


def _tidy_properties(properties: Mapping[str, Any]) -> dict[str, Any]:
    return {name: _tidy(schema) for name, schema in properties.items()}


def _without_null(schema: dict[str, Any]) -> dict[str, Any]:
    choices = schema.get("anyOf")
    if not isinstance(choices, list) or {"type": "null"} not in choices:
        return schema
    left = [choice for choice in choices if choice != {"type": "null"}]
    rest = {key: value for key, value in schema.items() if key != "anyOf"}
    return {**left[0], **rest} if len(left) == 1 else {**rest, "anyOf": left}
