"""What the messages of a recording look like, as JSON Schemas.

Those named ``foxglove.…`` are of the shape that Foxglove publishes for messages in JSON, so that its panels, and other
tools that know them, show pictures, annotations and logs without being told how.

All of them are plain: the readers of some viewers refuse references, alternatives and objects without properties. A
figure that may be null is a number to them.
"""

from __future__ import annotations

from typing import Any

Schema = dict[str, Any]


def _object(**properties: Schema) -> Schema:
    return {"type": "object", "properties": properties}


def _listed(items: Schema) -> Schema:
    return {"type": "array", "items": items}


_NUMBER: Schema = {"type": "number"}
_COUNT: Schema = {"type": "integer", "minimum": 0}
_TEXT: Schema = {"type": "string"}
_TIME: Schema = {
    "title": "time",
    **_object(sec=_COUNT, nsec={"type": "integer", "minimum": 0, "maximum": 999_999_999}),
}
_POINT = _object(x=_NUMBER, y=_NUMBER)
_COLOUR = _object(r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_METADATA = _listed(_object(key=_TEXT, value=_TEXT))

COMPRESSED_IMAGE = "foxglove.CompressedImage"
CAMERA_CALIBRATION = "foxglove.CameraCalibration"
IMAGE_ANNOTATIONS = "foxglove.ImageAnnotations"
LOG = "foxglove.Log"
TARGET = "stadimeter.Target"
CYCLE = "stadimeter.Cycle"
CONFIGURATION = "stadimeter.Configuration"

_CIRCLE = _object(
    timestamp=_TIME,
    position=_POINT,
    diameter=_NUMBER,
    thickness=_NUMBER,
    fill_color=_COLOUR,
    outline_color=_COLOUR,
    metadata=_METADATA,
)
_POINTS = _object(
    timestamp=_TIME,
    type=_COUNT,
    points=_listed(_POINT),
    outline_color=_COLOUR,
    outline_colors=_listed(_COLOUR),
    fill_color=_COLOUR,
    thickness=_NUMBER,
    metadata=_METADATA,
)
_LABEL = _object(
    timestamp=_TIME,
    position=_POINT,
    text=_TEXT,
    font_size=_NUMBER,
    text_color=_COLOUR,
    background_color=_COLOUR,
    metadata=_METADATA,
)

SCHEMAS: dict[str, Schema] = {
    COMPRESSED_IMAGE: _object(
        timestamp=_TIME, frame_id=_TEXT, data={**_TEXT, "contentEncoding": "base64"}, format=_TEXT
    ),
    CAMERA_CALIBRATION: _object(
        timestamp=_TIME,
        frame_id=_TEXT,
        width=_COUNT,
        height=_COUNT,
        distortion_model=_TEXT,
        D=_listed(_NUMBER),
        K={**_listed(_NUMBER), "minItems": 9, "maxItems": 9},
        R={**_listed(_NUMBER), "minItems": 9, "maxItems": 9},
        P={**_listed(_NUMBER), "minItems": 12, "maxItems": 12},
    ),
    IMAGE_ANNOTATIONS: _object(circles=_listed(_CIRCLE), points=_listed(_POINTS), texts=_listed(_LABEL)),
    LOG: _object(timestamp=_TIME, level=_COUNT, message=_TEXT, name=_TEXT, file=_TEXT, line=_COUNT),
    TARGET: _object(
        status=_TEXT,
        measured_m=_NUMBER,
        distance_m=_NUMBER,
        sigma_m=_NUMBER,
        depth_m=_NUMBER,
        closing_mps=_NUMBER,
        bearing_rad=_NUMBER,
        elevation_rad=_NUMBER,
    ),
    CONFIGURATION: _object(reloaded=_object(at_s=_NUMBER, configuration=_object(text=_TEXT, files=_object()))),
}
"""By name. That of a cycle is not here: it follows from `CycleRecord`."""
for _name, _schema in SCHEMAS.items():
    _schema["title"] = _name


def plain(schema: Schema) -> Schema:
    """Return a schema without references and alternatives.

    Args:
        schema: The schema of an object, with what it refers to under ``$defs``.

    Returns:
        A schema that allows more: of several kinds of objects it has the properties of all.
    """
    return _plain(schema, schema.get("$defs", {}))


def _plain(schema: Schema, definitions: Schema) -> Schema:
    if "$ref" in schema:
        return _plain(definitions[schema["$ref"].rpartition("/")[2]], definitions)
    if "anyOf" in schema:
        return _joined([_plain(each, definitions) for each in schema["anyOf"] if each.get("type") != "null"])
    if schema.get("type") == "array":
        return _listed(_plain(schema.get("items") or schema["prefixItems"][0], definitions))
    if schema.get("type") == "object":
        return _object(**{name: _plain(part, definitions) for name, part in schema.get("properties", {}).items()})
    return {"type": schema.get("type", "string")}


def _joined(schemas: list[Schema]) -> Schema:
    """Return the schema of objects with the properties of several, or the first one of what is no object."""
    first = schemas[0]
    if first["type"] != "object":
        return first
    return _object(**{name: part for schema in schemas for name, part in schema.get("properties", {}).items()})
