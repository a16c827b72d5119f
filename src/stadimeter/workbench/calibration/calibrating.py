"""Reading the pictures of a calibration: boards, and how the lens was set."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from stadimeter.config.untrusted_file import open_untrusted
from stadimeter.core.frame import Optics
from stadimeter.errors import CalibrationError
from stadimeter.ranging.board_calibration import BoardView
from stadimeter.workbench.calibration.board_session import Board
from stadimeter.workbench.measuring import open_picture

# Settings that differ by no more than this share count as the same: cameras round them.
SAME_ZOOM = 0.005

# Focusing this many times nearer or farther can change the focal length by some tenths of a per cent.
FOCUS_FACTOR = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardPictures:
    """Views of a board in pictures.

    Attributes:
        missed: Picture and reason, for each in which it was not.
        optics: How the camera was set, if a picture says it.
    """

    views: tuple[BoardView, ...]
    missed: tuple[tuple[str, str], ...]
    width_px: int
    height_px: int
    optics: Optics | None = None


def find_boards(
    paths: Sequence[Path], board: Board, watched: Callable[[Sequence[Path]], Iterable[Path]] = iter
) -> BoardPictures:
    """Look for a board in pictures.

    Args:
        watched: Goes through the pictures, such as to show how many are done.

    Raises:
        PictureError: A picture cannot be read.
        CalibrationError: The pictures differ in resolution, or in how the camera was set.
    """
    views: list[BoardView] = []
    missed: list[tuple[str, str]] = []
    shape, optics = (0, 0), None
    for path in watched(paths):
        frame = open_picture(path)
        here = (frame.width_px, frame.height_px)
        shape = here if shape == (0, 0) else shape
        if here != shape:
            raise CalibrationError(
                f"{paths[0]} has {shape[0]}x{shape[1]} px, {path} has {here[0]}x{here[1]}; calibrate from pictures of "
                "one resolution, all held the same way"
            )
        optics = optics or frame.optics
        if optics and frame.optics and (change := optics.change_to(frame.optics)):
            raise CalibrationError(f"{path}: {change}; calibrate from pictures of one setting")
        found = board.find(str(path), frame.image)
        if isinstance(found, BoardView):
            views.append(found)
        else:
            missed.append((str(path), found))
    return BoardPictures(views=tuple(views), missed=tuple(missed), width_px=shape[0], height_px=shape[1], optics=optics)


def check_lens_settings(paths: Sequence[Path]) -> tuple[str, ...]:
    """Check by EXIF data that the lens was set the same way in all pictures, and return notes on other focuses.

    Raises:
        CalibrationError: Pictures have different zoom or lenses, so no one focal length fits them all.
    """
    settings = [(path, read_lens_settings(path)) for path in paths]
    for name, unit, attribute in _ZOOM:
        known = [(path, value) for path, each in settings if (value := getattr(each, attribute)) is not None]
        for path, value in known[1:]:
            if abs(value / known[0][1] - 1) > SAME_ZOOM:
                raise CalibrationError(
                    f"{known[0][0]} was taken with {name} {known[0][1]:g}{unit}, {path} with {value:g}{unit}: "
                    "another zoom or lens is another camera; calibrate from pictures of one"
                )
    return _focus_notes(settings)


_ZOOM = (
    ("focal length", " mm", "focal_length_mm"),
    ("35 mm equivalent", " mm", "focal_length_35mm_mm"),
    ("digital zoom", "", "digital_zoom"),
)


def _focus_notes(settings: Sequence[tuple[Path, LensSettings]]) -> tuple[str, ...]:
    focused = [(each.subject_distance_m, path) for path, each in settings if each.subject_distance_m is not None]
    if len(focused) < 2:
        return ()
    (near_m, near), (far_m, far) = min(focused), max(focused)
    if far_m <= FOCUS_FACTOR * near_m:
        return ()
    note = f"{near} was focused at {near_m:g} m, {far} at {far_m:g} m: focusing changes the focal length a little"
    return (f"{note}; fix the focus if the camera lets you",)


_EXIF_DIRECTORY = 0x8769
_FOCAL_LENGTH = 0x920A
_SUBJECT_DISTANCE = 0x9206
_DIGITAL_ZOOM = 0xA404
_FOCAL_LENGTH_35MM = 0xA405

# EXIF data stand in the first segments of a file, each of which has 64 KiB at most.
_SHORT, _LONG, _RATIONAL = 3, 4, 5
_HEADER_MAX_BYTES = 1 << 18


@dataclass(frozen=True, slots=True, kw_only=True)
class LensSettings:
    """How the lens was set; None where the picture does not say.

    Attributes:
        focal_length_35mm_mm: The focal length that shows as much on a 35 mm film.
        digital_zoom: By how much the camera enlarged the picture; 1 is not at all.
    """

    focal_length_mm: float | None = None
    focal_length_35mm_mm: float | None = None
    digital_zoom: float | None = None
    subject_distance_m: float | None = None


def read_lens_settings(path: Path) -> LensSettings:
    """Return how a picture says that the lens was set; nothing without good EXIF data."""
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
