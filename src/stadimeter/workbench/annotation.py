"""Copies of pictures with the measurement drawn in: outline, centre, and a label."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from msgspec import Struct, field

from stadimeter.config.camera_file import with_optics
from stadimeter.config.files import write_atomically
from stadimeter.core.detection import Detection, DetectionStatus, Points, RejectedCandidate, no_points
from stadimeter.core.frame import Image, Optics
from stadimeter.errors import PictureError, reason_of

# Labels in pictures: panels of text, each in the free place that is nearest to what it names --------------------------

Colour = tuple[int, int, int]

# How much of what is behind a text is darkened.
WHITE: Colour = (245, 245, 245)
DARK: Colour = (28, 24, 20)
BACKING = 0.72

FONT = cv2.FONT_HERSHEY_SIMPLEX
MIN_FONT = 0.05

_PLAIN = {"°": " deg", "×": "x", "…": "..", "–": "-", "—": "-", "−": "-", "→": "->", "ß": "ss"}
if cv2.__version__ < "5":  # whose fonts have ASCII alone
    _PLAIN["±"] = "+-"


class Panel:
    """Lines of text on a dark backing with a stripe of the target's colour, as wide as the picture at most."""

    def __init__(self, lines: tuple[str, ...], colour: Colour, size: float, scale: float, canvas: Image) -> None:
        self._lines = tuple(_drawable(line) for line in lines)
        self._colour = colour
        self._canvas = canvas
        room = canvas.shape[1] - 2 * round(16 * scale)
        self._set_in(size * scale)
        while self.width > room and self._font > MIN_FONT:
            self._set_in(self._font * min(0.98, room / self.width))

    def _set_in(self, font: float) -> None:
        self._font = font
        self._thickness = max(1, round(1.9 * font))
        self._pad = round(13 * font)
        self._line_height = round(35 * font)
        text_width = max(_text_width(line, font, self._thickness) for line in self._lines)
        self.width = text_width + 3 * self._pad
        self.height = self._line_height * len(self._lines) + 2 * self._pad - round(8 * font)

    @property
    def room_px(self) -> tuple[int, int]:
        """The farthest place of its left upper corner, to the right and down."""
        height, width = self._canvas.shape[:2]
        return width - self.width, height - self.height

    def draw(self, box: Box) -> None:
        """Draw it into its place."""
        left, top = box.left, box.top
        behind = self._canvas[top : top + self.height, left : left + self.width]
        behind[:] = np.round(behind * (1 - BACKING) + np.array(DARK) * BACKING).astype(np.uint8)
        behind[:, : max(2, self._pad // 3)] = self._colour
        for index, line in enumerate(self._lines):
            baseline = top + self._pad + round(20 * self._font) + index * self._line_height
            origin = (left + 2 * self._pad, baseline)
            cv2.putText(self._canvas, line, origin, FONT, self._font, WHITE, self._thickness, cv2.LINE_AA)


def _drawable(text: str) -> str:
    """Return a text with the characters that OpenCV's fonts have, and a question mark for others."""
    plain = "".join(_PLAIN.get(each, each) for each in text)
    without_accents = (each for each in unicodedata.normalize("NFKD", plain) if not unicodedata.combining(each))
    return "".join(each if each == "±" or " " <= each <= "~" else "?" for each in without_accents)


def _text_width(text: str, font: float, thickness: int) -> int:
    return int(cv2.getTextSize(text, FONT, font, thickness)[0][0])


class Box(NamedTuple):
    """A rectangle in pixels; right and bottom are beyond it."""

    left: int
    top: int
    right: int
    bottom: int

    def meets(self, other: Box) -> bool:
        """Check whether the two have a pixel in common."""
        is_beside = self.right <= other.left or other.right <= self.left
        return not (is_beside or self.bottom <= other.top or other.bottom <= self.top)


def free_place(panel: Panel, near: Box, taken: Sequence[Box], gap_px: float, margin_px: int = 0) -> Box | None:
    """Return where a panel covers nothing that is taken, nearest to what it belongs to, below rather than above.

    Args:
        gap_px: How far from that it is best.
        margin_px: How far from the border of the picture it stays.
    """
    step = max(1, panel.height // 5)
    lefts = [*range(margin_px, panel.room_px[0] - margin_px + 1, step)]
    # A place in line with its target is always among them.
    middle = round((near.left + near.right - panel.width) / 2)
    lefts.append(max(margin_px, min(middle, panel.room_px[0] - margin_px)))
    best, least = None, math.inf
    for top in range(margin_px, panel.room_px[1] - margin_px + 1, step):
        for left in lefts:
            box = Box(left, top, left + panel.width, top + panel.height)
            across = max(near.left - box.right, left - near.right, 0)
            down = max(near.top - box.bottom, top - near.bottom, 0)
            is_above = box.bottom <= near.top
            away = abs(math.hypot(across, down) - gap_px) + abs(left - middle) / 5 + is_above * gap_px
            if away < least and not any(box.meets(each) for each in taken):
                best, least = box, away
    return best


# The annotated picture: outlines, words and leaders of what was found and of what was refused -------------------------

GREEN: Colour = (110, 230, 60)
ORANGE: Colour = (40, 160, 255)
RED: Colour = (90, 90, 255)
YELLOW: Colour = (60, 240, 255)
GREY: Colour = (215, 190, 170)

# The long side of a picture in which a line is two pixels thick; in others everything grows and shrinks with it.
REFERENCE_PX = 900.0

# Smaller pictures are enlarged: letters need pixels, and those of many labels twice as many.
MIN_LONG_SIDE_PX = 600

FEW_MARKS = 4

JPEG_QUALITY = 93
SUBPIXEL_BITS = 4

# Sizes of the letters of labels, of the panels of what was measured, and where there are many targets.
LABEL_SIZE, LEGEND_SIZE, SMALL_SIZE = 1.0, 0.7, 0.5

# Between a target and its label, in units of the picture's scale; from this many gaps on a line joins them.
GAP, LEADER_FROM = 12.0, 2.0

# Beyond this nothing is drawn: OpenCV's drawing counts in whole numbers of 32 bits.
REACH_MAX_PX = 1e5

_COLOURS = {
    DetectionStatus.FOUND: GREEN,
    DetectionStatus.PERHAPS: ORANGE,
    DetectionStatus.TRUNCATED: ORANGE,
    DetectionStatus.NOT_FOUND: RED,
}


class Mark(Struct, frozen=True, kw_only=True, eq=False):
    """Drawing for one target.

    Attributes:
        has_corners: Whether its outline is corners in order, or else points on a rim that may be hidden in parts.
        edges_px: Where its edges are seen, drawn point by point over its outline; shape ``(n, 2)``.
        headline: The label beside it, such as ``sheet: 35.0 in ± 0.4``; no label if it was not found.
    """

    detection: Detection
    has_corners: bool = False
    edges_px: Points = field(default_factory=no_points)
    headline: str
    lines: tuple[str, ...] = ()
    rejected: tuple[tuple[int, RejectedCandidate], ...] = ()


def annotate(image: Image, marks: Sequence[Mark]) -> Image:
    """Draw what was measured into a copy of a picture, which is enlarged by a whole factor if it is small."""
    least_px = MIN_LONG_SIDE_PX * (1 if len(marks) <= FEW_MARKS else 2)
    factor = math.ceil(least_px / max(image.shape[:2]))
    canvas = image.copy() if factor == 1 else _enlarge(image, factor)
    scale = max(canvas.shape[:2]) / REFERENCE_PX
    for mark in marks:
        for _, candidate in mark.rejected:
            _draw_rejected(canvas, candidate, factor, scale)
    for mark in marks:
        _draw_target(canvas, mark, factor, scale)
    _draw_words(canvas, marks, factor, scale)
    return canvas


def write_picture(path: Path, image: Image, optics: Optics | None = None) -> None:
    """Write a picture whole or not at all; the ending of the path says the kind.

    Args:
        optics: How the camera was set, to be kept in a PNG.

    Raises:
        PictureError: It cannot be written there.
    """
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if path.suffix.lower() in {".jpg", ".jpeg"} else []
    try:
        done, data = cv2.imencode(path.suffix, image, quality)
    except cv2.error as error:
        raise PictureError(f"OpenCV cannot write pictures that end in {path.suffix!r}: {path}") from error
    if not done:
        raise PictureError(f"the picture {path} cannot be encoded")
    try:
        write_atomically(path, with_optics(data.tobytes(), optics))
    except OSError as error:
        raise PictureError(f"the picture {path} cannot be written: {reason_of(error)}") from error


def _enlarge(image: Image, factor: int) -> Image:
    return np.asarray(cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC), np.uint8)


def _on_canvas(points: Points, factor: int) -> Points:
    """Return where points of the picture are in the enlarged one; (0, 0) is the centre of the first pixel in both."""
    return (np.asarray(points, np.float64) + 0.5) * factor - 0.5


def _draw_target(canvas: Image, mark: Mark, factor: int, scale: float) -> None:
    detection = mark.detection
    outline = _on_canvas(detection.outline_px, factor)
    if not len(outline):
        return
    colour = _COLOURS[detection.status]
    thickness = max(1, round(2.2 * scale))
    for width, shade in ((thickness + max(2, round(2 * scale)), DARK), (thickness, colour)):
        if mark.has_corners:
            _draw_polygon(canvas, outline, shade, width)
        else:
            _draw_limb(canvas, outline, detection, (shade, width), factor)
    _draw_points(canvas, _on_canvas(mark.edges_px, factor), scale)
    _draw_cross(canvas, _on_canvas(np.array(detection.centre_px), factor), colour, scale)


def _rim(candidate: RejectedCandidate, factor: int) -> Points:
    """Return the corners of a candidate on the canvas, or points on its circle; none if it is out of reach."""
    if not (np.isfinite(candidate.centre_px).all() and 0 < candidate.size_px < REACH_MAX_PX):
        return no_points()
    if candidate.corners_px:
        points = np.array(candidate.corners_px)
    else:
        angles = np.linspace(0, 2 * np.pi, 72, endpoint=False)
        around = np.column_stack([np.cos(angles), np.sin(angles)])
        points = np.array(candidate.centre_px) + candidate.size_px / 2 * around
    rim = _on_canvas(points, factor)
    return rim if np.isfinite(rim).all() and np.abs(rim).max() < REACH_MAX_PX else np.empty((0, 2))


def _draw_rejected(canvas: Image, candidate: RejectedCandidate, factor: int, scale: float) -> None:
    """Draw a candidate with a thin line: its corners, or a ring of its size."""
    rim = _rim(candidate, factor)
    thickness = max(1, round(scale))
    for width, shade in ((thickness + max(1, round(scale)), DARK), (thickness, GREY)):
        if len(rim):
            _draw_polygon(canvas, rim, shade, width)


def _draw_polygon(canvas: Image, corners: Points, colour: Colour, thickness: int) -> None:
    fixed = np.round(corners * 2**SUBPIXEL_BITS).astype(np.int32).reshape(-1, 1, 2)
    cv2.polylines(canvas, [fixed], isClosed=True, color=colour, thickness=thickness, lineType=cv2.LINE_AA, shift=4)


def _draw_points(canvas: Image, points: Points, scale: float) -> None:
    radius = round(0.9 * scale * 2**SUBPIXEL_BITS)
    for x, y in np.round(points * 2**SUBPIXEL_BITS).astype(int).tolist():
        cv2.circle(canvas, (x, y), radius, YELLOW, cv2.FILLED, cv2.LINE_AA, SUBPIXEL_BITS)


def _draw_limb(canvas: Image, limb: Points, detection: Detection, pen: tuple[Colour, int], factor: int) -> None:
    """Draw the parts of a ball's limb that were seen, broken where a seam or a hand hides it."""
    centre = _on_canvas(np.array(detection.centre_px), factor)
    angles = np.arctan2(limb[:, 1] - centre[1], limb[:, 0] - centre[0])
    ordered = limb[np.argsort(angles)]
    steps = np.hypot(*(np.roll(ordered, -1, axis=0) - ordered).T)
    widest = 0.25 * factor * detection.width_px
    fixed = np.round(ordered * 2**SUBPIXEL_BITS).astype(int)
    for index, step in enumerate(steps):
        if step < widest:
            start, end = fixed[index], fixed[(index + 1) % len(fixed)]
            cv2.line(canvas, (int(start[0]), int(start[1])), (int(end[0]), int(end[1])), pen[0], pen[1], cv2.LINE_AA, 4)


def _draw_cross(canvas: Image, centre: Points, colour: Colour, scale: float) -> None:
    x, y = round(float(centre[0])), round(float(centre[1]))
    size = max(4, round(9 * scale))
    for shade, thickness in ((DARK, max(2, round(4 * scale))), (colour, max(1, round(1.6 * scale)))):
        cv2.line(canvas, (x - size, y), (x + size, y), shade, thickness, cv2.LINE_AA)
        cv2.line(canvas, (x, y - size), (x, y + size), shade, thickness, cv2.LINE_AA)


def _draw_words(canvas: Image, marks: Sequence[Mark], factor: int, scale: float) -> None:
    """Write labels beside their targets, and further lines where nothing is in the way."""
    for mark, panel, box in place_words(canvas, marks, factor, scale):
        if mark is not None:
            _draw_leader(canvas, mark, box, factor, scale)
        panel.draw(box)


def place_words(
    canvas: Image, marks: Sequence[Mark], factor: int, scale: float
) -> Iterator[tuple[Mark | None, Panel, Box]]:
    """Yield what is written and where: labels, each with its target; then lines; then what was rejected.

    Nothing is written where there is no room for it. What is said of a target without a label may cover targets, and
    lines of those with one are left out if there are more than two.
    """
    height, margin = canvas.shape[0], round(14 * scale)
    near = [_box_around(_on_canvas(mark.detection.outline_px, factor)) for mark in marks]
    taken, panels = [each for each in near if each], list[Box]()
    unnamed = list[Mark]()
    for mark, target in zip(marks, near, strict=True):
        size = LABEL_SIZE if len(marks) <= FEW_MARKS else SMALL_SIZE
        panel = Panel((mark.headline,), _COLOURS[mark.detection.status], size, scale, canvas)
        if target and (box := free_place(panel, target, [*taken, *panels], GAP * scale)):
            panels.append(box)
            yield mark, panel, box
        else:
            unnamed.append(mark)
    corner = Box(0, height, 0, height)
    named = [each for each in reversed(marks) if each not in unnamed]
    for mark in (*reversed(unnamed), *(named if len(marks) <= 2 else [])):
        if not mark.lines and mark not in unnamed:
            continue
        panel = Panel(mark.lines or (mark.headline,), _COLOURS[mark.detection.status], LEGEND_SIZE, scale, canvas)
        covered = panels if mark in unnamed else [*taken, *panels]
        if box := free_place(panel, corner, covered, 0.0, margin):
            panels.append(box)
            yield None, panel, box
    for number, candidate in (each for mark in marks for each in mark.rejected):
        panel = Panel((f"{number} {candidate.test}",), GREY, SMALL_SIZE, scale, canvas)
        rim = _box_around(_rim(candidate, factor))
        if rim and (box := free_place(panel, rim, [*taken, *panels], 2 * scale)):
            panels.append(box)
            yield None, panel, box


def _box_around(points: Points) -> Box | None:
    if not len(points) or not np.isfinite(points).all():
        return None
    within = np.clip(points, -REACH_MAX_PX, REACH_MAX_PX)
    left, top = np.floor(within.min(axis=0)).astype(int).tolist()
    right, bottom = np.ceil(within.max(axis=0)).astype(int).tolist()
    return Box(left, top, right, bottom)


def _draw_leader(canvas: Image, mark: Mark, box: Box, factor: int, scale: float) -> None:
    """Draw a line from a label that is away from its target to the target's outline."""
    outline = _on_canvas(mark.detection.outline_px, factor)
    start = np.clip(outline, (box.left, box.top), (box.right, box.bottom))
    apart = np.linalg.norm(outline - start, axis=1)
    nearest = int(np.argmin(apart))
    if not LEADER_FROM * GAP * scale < apart[nearest] < REACH_MAX_PX:
        return
    ends = [tuple(round(float(each)) for each in point) for point in (start[nearest], outline[nearest])]
    colour = _COLOURS[mark.detection.status]
    for shade, thickness in ((DARK, max(2, round(3.4 * scale))), (colour, max(1, round(1.4 * scale)))):
        cv2.line(canvas, ends[0], ends[1], shade, thickness, cv2.LINE_AA)
