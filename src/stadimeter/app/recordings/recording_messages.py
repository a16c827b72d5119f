"""The messages of a recording besides the cycles, and their JSON Schemas: pictures, annotations, distances, events.

Those named ``foxglove.…`` are of the shape that Foxglove publishes for messages in JSON, so that its panels, and other
tools that know them, show pictures, annotations and logs at once.

All schemas are plain: the readers of some viewers refuse references, alternatives and objects without properties. A
figure that may be null is a number to them.
"""

from __future__ import annotations

import json
import math
from base64 import b64encode
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

from stadimeter.app.cycle import CycleRecord
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.decision import Event, Severity
from stadimeter.core.detection import Detection, DetectionStatus, TargetShape
from stadimeter.core.frame import Image
from stadimeter.core.measurement import Measurement, Track

Schema = dict[str, Any]


COMPRESSED_IMAGE = "foxglove.CompressedImage"
CAMERA_CALIBRATION = "foxglove.CameraCalibration"
IMAGE_ANNOTATIONS = "foxglove.ImageAnnotations"
LOG = "foxglove.Log"
TARGET = "stadimeter.Target"
CYCLE = "stadimeter.Cycle"
CONFIGURATION = "stadimeter.Configuration"


# Of foxglove.Log: info, warning, error, fatal.
CAMERA_FRAME = "camera"
_LEVELS = {Severity.INFO: 2, Severity.WARNING: 3, Severity.ALARM: 4, Severity.SAFETY: 5}

# JPEGs mostly have colour at half the resolution; edges that only colour shows then move by a part of a pixel.
_GREEN = {"r": 0.2, "g": 0.9, "b": 0.4, "a": 1.0}
_ORANGE = {"r": 1.0, "g": 0.65, "b": 0.15, "a": 1.0}
_RED = {"r": 1.0, "g": 0.35, "b": 0.35, "a": 1.0}
_CLEAR = {"r": 0.0, "g": 0.0, "b": 0.0, "a": 0.0}
_SHADE = {"r": 0.0, "g": 0.0, "b": 0.0, "a": 0.6}
_THICKNESS_PX = 2.0
_FONT_PX = 14.0
_WHOLE_COLOUR = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)

# Of foxglove.PointsAnnotation: the last point is joined to the first.
_LINE_LOOP = 2

_OUTLINE_POINTS_MAX = 64

# Of a track, what is plotted.
_TRACK_FIGURES = ("distance_m", "sigma_m", "depth_m", "closing_mps", "bearing_rad", "elevation_rad")

# Foxglove has (0, 0) at the corner of the first pixel, not at its centre.
_FIRST_PIXEL = 0.5


def stamp(time_ns: int) -> dict[str, int]:
    """Return a time in nanoseconds since 1970 as Foxglove's messages have it."""
    sec, nsec = divmod(time_ns, 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


def encode_jpeg(image: Image, quality_percent: int) -> bytes | None:
    """Return a picture as JPEG; None if there is none of it. Quality is 1 to 100."""
    try:
        is_done, jpeg = cv2.imencode(".jpg", image, [*_WHOLE_COLOUR, cv2.IMWRITE_JPEG_QUALITY, quality_percent])
    except cv2.error:  # an empty picture, or one that is larger than a JPEG can be
        return None
    return jpeg.tobytes() if is_done else None


def compressed_image(jpeg: bytes, time_ns: int) -> bytes:
    """Return a picture as a message."""
    sec, nsec = divmod(time_ns, 1_000_000_000)
    return b'{"timestamp":{"sec":%d,"nsec":%d},"frame_id":"%b","format":"jpeg","data":"%b"}' % (
        sec,
        nsec,
        CAMERA_FRAME.encode(),
        b64encode(jpeg),
    )


def log(event: Event, time_ns: int) -> bytes:
    """Return an event as a line of a log."""
    said = f"{event.source}: {event.kind.value.replace('_', ' ')}"
    return _json(
        {
            "timestamp": stamp(time_ns),
            "level": _LEVELS.get(event.severity, 2),
            "message": f"{said}: {event.reason}" if event.reason else said,
            "name": event.source,
            "file": "",
            "line": 0,
        }
    )


def target(track: Track, measured: Measurement | None) -> bytes:
    """Return the known figures of a target in one cycle, to plot it; figures that are not known are null."""
    figures = {"measured_m": measured.distance_m if measured else None}
    figures |= {name: getattr(track, name) for name in _TRACK_FIGURES}
    return _json({"status": track.status.value, **{name: _finite(value) for name, value in figures.items()}})


def calibration(camera: CameraModel, time_ns: int) -> bytes:
    """Return a camera model, at the resolution of the pictures, as a message."""
    matrix = [float(value) for value in camera.matrix().ravel()]
    return _json(
        {
            "timestamp": stamp(time_ns),
            "frame_id": CAMERA_FRAME,
            "width": camera.width_px,
            "height": camera.height_px,
            "distortion_model": "plumb_bob",
            "D": [*camera.distortion, *[0.0] * (5 - len(camera.distortion))],
            "K": matrix,
            "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            "P": [*matrix[0:3], 0.0, *matrix[3:6], 0.0, *matrix[6:9], 0.0],
        }
    )


def image_annotations(
    record: CycleRecord, camera: CameraModel, sizes: Mapping[str, TargetShape], time_ns: int
) -> bytes:
    """Return the findings in a picture, to draw them: targets with their distances, and what was rejected.

    Args:
        record: The cycle in which the picture was new.
        camera: The camera model, at the resolution of the picture.
        sizes: The size of each target, by its name.
    """
    when = stamp(time_ns)
    outlines = [_outline(found, when) for found in record.detections if len(found.outline_px)]
    drawn = {found.target for found in record.detections if len(found.outline_px)}
    circles: list[dict[str, Any]] = []
    texts: list[dict[str, Any]] = []
    for measured in record.observation.measurements:
        place = measured.position_m
        if place is None or measured.distance_m is None or not math.isfinite(measured.distance_m) or place[2] <= 0:
            continue
        x_px, y_px = camera.pixel(place[0] / place[2], place[1] / place[2])
        size = sizes.get(measured.target)
        across_px = camera.fx_px * size.longest_m / measured.distance_m if size else 0.0
        said = f"{measured.target} {measured.distance_m:.2f} m"
        if math.isfinite(x_px) and math.isfinite(y_px):
            if measured.target not in drawn:
                circles.append({**_circle((x_px, y_px), across_px, _GREEN, when), "metadata": _named(measured.target)})
            texts.append(_label((x_px, y_px), across_px, said, when))
    for rejected in (candidate for found in record.rejected.values() for candidate in found):
        circles.append(_circle(rejected.centre_px, rejected.size_px, _RED, when))
        texts.append(_label(rejected.centre_px, rejected.size_px, rejected.reason, when))
    return _json({"circles": circles, "points": outlines, "texts": texts})


def _outline(found: Detection, when: Any) -> dict[str, Any]:
    """Return the outline of a target, which is convex, as a closed line."""
    points = found.outline_px[np.isfinite(found.outline_px).all(axis=1)]
    across = points - points.mean(axis=0) if len(points) else points
    around = points[np.argsort(np.arctan2(across[:, 1], across[:, 0]))]
    around = around[np.linspace(0, len(around) - 1, min(len(around), _OUTLINE_POINTS_MAX)).astype(int)]
    return {
        "timestamp": when,
        "type": _LINE_LOOP,
        "points": [{"x": round(x, 1), "y": round(y, 1)} for x, y in (around + _FIRST_PIXEL).tolist()],
        "outline_color": _GREEN if found.status is DetectionStatus.FOUND else _ORANGE,
        "outline_colors": [],
        "fill_color": _CLEAR,
        "thickness": _THICKNESS_PX,
        "metadata": _named(found.target),
    }


def _named(target: str) -> list[dict[str, str]]:
    return [{"key": "target", "value": target}]


def _circle(centre_px: tuple[float, float], across_px: float, colour: Mapping[str, float], when: Any) -> dict[str, Any]:
    return {
        "timestamp": when,
        "position": {"x": centre_px[0] + _FIRST_PIXEL, "y": centre_px[1] + _FIRST_PIXEL},
        "diameter": max(across_px, 3 * _THICKNESS_PX),
        "thickness": _THICKNESS_PX,
        "fill_color": _CLEAR,
        "outline_color": colour,
        "metadata": [],
    }


def _label(centre_px: tuple[float, float], across_px: float, text: str, when: Any) -> dict[str, Any]:
    return {
        "timestamp": when,
        "position": {"x": centre_px[0] + across_px / 2, "y": centre_px[1] - across_px / 2},
        "text": text,
        "font_size": _FONT_PX,
        "text_color": {"r": 1.0, "g": 1.0, "b": 1.0, "a": 1.0},
        "background_color": _SHADE,
        "metadata": [],
    }


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _json(message: Mapping[str, Any]) -> bytes:
    return json.dumps(message, separators=(",", ":")).encode()


_WHEN = stamp(0)
_SQUARE = Detection(target="", status=DetectionStatus.FOUND, outline_px=np.zeros((1, 2)))

# A message of each kind, with something in every list. Of a cycle, which holds all that a run knew, only the parts.
_EXAMPLES: dict[str, Schema] = {
    COMPRESSED_IMAGE: {"timestamp": _WHEN, "frame_id": "", "data": "", "format": ""},
    CAMERA_CALIBRATION: {
        "timestamp": _WHEN,
        "frame_id": "",
        "width": 0,
        "height": 0,
        "distortion_model": "",
        **{key: [0.0] for key in "DKRP"},
    },
    IMAGE_ANNOTATIONS: {
        "circles": [{**_circle((0.0, 0.0), 0.0, _GREEN, _WHEN), "metadata": _named("")}],
        "points": [{**_outline(_SQUARE, _WHEN), "outline_colors": [_GREEN]}],
        "texts": [{**_label((0.0, 0.0), 0.0, "", _WHEN), "metadata": _named("")}],
    },
    LOG: {"timestamp": _WHEN, "level": 0, "message": "", "name": "", "file": "", "line": 0},
    TARGET: {"status": "", "measured_m": 0.0, **dict.fromkeys(_TRACK_FIGURES, 0.0)},
    CYCLE: {
        "observation": {"now_s": 0.0, "camera_fault": ""},
        "applied": [{"output": "", "level": 0.0, "linear_mps": 0.0, "angular_radps": 0.0}],
        "timings_s": dict.fromkeys(("capture", "measure", "decide", "apply"), 0.0),
        "decision": {"safety": "", "safety_reason": ""},
    },
    CONFIGURATION: {"reloaded": {"at_s": 0.0, "configuration": {"text": "", "files": {}}}},
}
_TYPES = {float: "number", int: "integer", str: "string"}


def _schema_of(example: Any) -> Schema:
    """Return the schema of messages like one. Viewers know a time by its title."""
    if isinstance(example, list):
        return {"type": "array", "items": _schema_of(example[0])}
    if not isinstance(example, dict):
        return {"type": _TYPES[type(example)]}
    title = {"title": "time"} if example.keys() == _WHEN.keys() else {}
    return {**title, "type": "object", "properties": {name: _schema_of(part) for name, part in example.items()}}


SCHEMAS = {name: {**_schema_of(example), "title": name} for name, example in _EXAMPLES.items()}
SCHEMAS[COMPRESSED_IMAGE]["properties"]["data"]["contentEncoding"] = "base64"
