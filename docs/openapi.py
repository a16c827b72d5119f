"""The description of the API as OpenAPI 3.1, made from the table of paths and ``openapi.toml`` for the site."""

from __future__ import annotations

import json
import re
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stadimeter.web.routes import PAGE_OPERATIONS, PageOperation

ANSWERS = Path(__file__).with_suffix(".toml")

_ERRORS = (
    "400 makes no sense, 401 not logged in, 403 not allowed, 404 not there, 409 changed by another, 413 too large, "
    "429 too many attempts, 503 run or workbench cannot be asked"
)
_ABOUT = (
    "The page's API. x-right is the right that an operation needs. What changes anything has Content-Type "
    "application/json, and an Origin (or Sec-Fetch-Site) that is the page's own."
)
_SESSION = (
    "From POST /login with the form field password. Named after the port. None is needed where no password is set."
)


def openapi_document() -> dict[str, Any]:
    """Return the document."""
    tables = tomllib.loads(ANSWERS.read_text(encoding="utf-8"))
    paths: dict[str, dict[str, Any]] = {}
    for each in PAGE_OPERATIONS:
        if each.summary:
            paths.setdefault(each.path, {})[each.method.lower()] = _operation(each)
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "stadimeter",
            "version": "1",
            "license": {"name": "MIT", "identifier": "MIT"},
            "description": _ABOUT,
        },
        "security": [{"session": []}, {}],
        "paths": paths,
        "components": {
            "securitySchemes": {
                "session": {"type": "apiKey", "in": "cookie", "name": "stadimeter-8080", "description": _SESSION}
            },
            "responses": {"Error": {"description": _ERRORS, "content": _json_of(_schema("Error"))}},
            "schemas": {name: _object(fields) for name, fields in tables.items()},
        },
    }


def _operation(each: PageOperation) -> dict[str, Any]:
    content = {each.media: {}} if each.media else _json_of(_schema(each.answer))
    described: dict[str, Any] = {
        "operationId": each.op.replace(".", "-"),
        "summary": each.summary,
        "x-right": each.right.name.lower(),
        "responses": {
            "200": {"description": "Done.", "content": content},
            "default": {"$ref": "#/components/responses/Error"},
        },
    }
    parameters = [
        {"name": name, "in": "path", "required": True, "schema": {"type": "string"}}
        for name in re.findall(r"{(\w+)}", each.path)
    ]
    parameters += [{"name": name, "in": "query", "schema": _schema(kind)} for name, kind in each.query.items()]
    if parameters:
        described["parameters"] = parameters
    if each.body is not None:
        body = _schema(each.body) if isinstance(each.body, str) else _object({f"{n}?": k for n, k in each.body.items()})
        described["requestBody"] = {"content": _json_of(body)}
    return described


def _json_of(schema: Mapping[str, Any]) -> dict[str, Any]:
    return {"application/json": {"schema": schema}}


def _object(fields: Mapping[str, str]) -> dict[str, Any]:
    """Return the schema of a table; `_` is its description."""
    about = {"description": fields["_"]} if "_" in fields else {}
    named = {name: kind for name, kind in fields.items() if name != "_"}
    return {
        **about,
        "type": "object",
        "properties": {name.removesuffix("?"): _schema(kind) for name, kind in named.items()},
        "required": [name for name in named if not name.endswith("?")],
    }


def _schema(text: str) -> dict[str, Any]:
    """Return the schema of a kind such as ``number[2]?: where it is, in pixels``, as in ``openapi.toml``."""
    kind, _, about = text.partition(": ")
    schema = _schema_of_kind(kind)
    return {**schema, "description": about} if about else schema


def _schema_of_kind(kind: str) -> dict[str, Any]:
    if kind.endswith("?"):
        return {"anyOf": [_schema_of_kind(kind[:-1]), {"type": "null"}]}
    if kind.endswith("{}"):
        return {"type": "object", "additionalProperties": _schema_of_kind(kind[:-2])}
    if listed := re.fullmatch(r"(.+)\[(\d*)\]", kind):
        size = {"minItems": int(listed[2]), "maxItems": int(listed[2])} if listed[2] else {}
        return {"type": "array", "items": _schema_of_kind(listed[1]), **size}
    if "|" in kind:
        return {"type": "string", "enum": kind.split("|")}
    if kind[0].isupper():
        return {"$ref": f"#/components/schemas/{kind}"}
    return {} if kind == "any" else {"type": {"text": "string"}.get(kind, kind)}


if __name__ == "__main__":
    json.dump(openapi_document(), sys.stdout)
