"""What a JPEG picture says about the lens it was taken with, from its EXIF data.

Only what changes the focal length in pixels is read. The format is a small TIFF file inside the JPEG (JEITA CP-3451,
Exif 2.3, section 4): a directory of entries with tag, type, count and value, one of which points to the directory of
the picture's own settings.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from stadimeter.config.untrusted_file import open_untrusted

_EXIF_DIRECTORY = 0x8769
_FOCAL_LENGTH = 0x920A
_SUBJECT_DISTANCE = 0x9206
_DIGITAL_ZOOM = 0xA404
_FOCAL_LENGTH_35MM = 0xA405

_SHORT, _LONG, _RATIONAL = 3, 4, 5
_HEADER_MAX_BYTES = 1 << 18
"""EXIF data stand in the first segments of a file, each of which has 64 KiB at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LensSettings:
    """How the lens was set; None where the picture does not say.

    Attributes:
        focal_length_mm: The focal length.
        focal_length_35mm_mm: The focal length that shows as much on a 35 mm film.
        digital_zoom: By how much the camera enlarged the picture; 1 is not at all.
        subject_distance_m: What it was focused on.
    """

    focal_length_mm: float | None = None
    focal_length_35mm_mm: float | None = None
    digital_zoom: float | None = None
    subject_distance_m: float | None = None


def read_lens_settings(path: Path) -> LensSettings:
    """Read how the lens was set.

    Args:
        path: A picture file.

    Returns:
        What the picture says; nothing if it is not a JPEG, has no EXIF data, or has damaged ones, since a picture is as
        good without them.
    """
    try:
        with open_untrusted(path) as file:
            tiff = _exif_block(file.read(_HEADER_MAX_BYTES))
        values = _lens_values(tiff) if tiff else {}
    except (OSError, struct.error):
        return LensSettings()
    zoom = values.get(_DIGITAL_ZOOM)
    return LensSettings(
        focal_length_mm=values.get(_FOCAL_LENGTH) or None,
        focal_length_35mm_mm=values.get(_FOCAL_LENGTH_35MM) or None,
        digital_zoom=(zoom or 1.0) if zoom is not None else None,  # 0 stands for: digital zoom was not used
        subject_distance_m=values.get(_SUBJECT_DISTANCE) or None,
    )


def _exif_block(data: bytes) -> bytes | None:
    """Return the TIFF file in the JPEG's APP1 segment."""
    if data[:2] != b"\xff\xd8":
        return None
    at = 2
    while data[at : at + 1] == b"\xff" and data[at + 1 : at + 2] not in {b"", b"\xd9", b"\xda"}:
        (length,) = struct.unpack_from(">H", data, at + 2)
        if data[at + 1] == 0xE1 and data[at + 4 : at + 10] == b"Exif\0\0":
            return data[at + 10 : at + 2 + length]
        at += 2 + max(length, 2)
    return None


def _lens_values(tiff: bytes) -> dict[int, float]:
    order = {b"II": "<", b"MM": ">"}.get(tiff[:2])
    if order is None:
        return {}
    (first,) = struct.unpack_from(f"{order}L", tiff, 4)
    settings_at = dict(_entries(tiff, first, order)).get(_EXIF_DIRECTORY)
    return dict(_entries(tiff, int(settings_at), order)) if settings_at else {}


def _entries(tiff: bytes, at: int, order: str) -> Iterator[tuple[int, float]]:
    """Yield tag and value of those entries of a directory that are one plain number."""
    (count,) = struct.unpack_from(f"{order}H", tiff, at)
    for index in range(count):
        entry = at + 2 + 12 * index
        tag, kind, values = struct.unpack_from(f"{order}HHL", tiff, entry)
        if values == 1 and kind == _SHORT:
            yield tag, float(struct.unpack_from(f"{order}H", tiff, entry + 8)[0])
        elif values == 1 and kind == _LONG:
            yield tag, float(struct.unpack_from(f"{order}L", tiff, entry + 8)[0])
        elif values == 1 and kind == _RATIONAL:
            (offset,) = struct.unpack_from(f"{order}L", tiff, entry + 8)
            above, below = struct.unpack_from(f"{order}LL", tiff, offset)
            if below and above != 0xFFFFFFFF:  # that numerator stands for infinity
                yield tag, above / below
