"""Copies of pictures with the measurement drawn in: outline, centre, distance, and a legend."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from stadimeter.config.camera_file import with_optics
from stadimeter.config.files import write_atomically
from stadimeter.core.detection import Detection, DetectionStatus, Points, RejectedCandidate, no_points
from stadimeter.core.frame import Image, Optics
from stadimeter.errors import PictureError, reason_of

# Labels in pictures: panels of text, and where they go: near what they name, and on nothing else if there is room ---
#
# The picture is divided into cells. What must stay visible gives its cells a high cost, and a summed-area table
# gives the cost of what a label would cover at every place at once (F. Crow, Summed-area tables for texture
# mapping, SIGGRAPH 1984): the cheapest place is the best one, not the first that does.

Colour = tuple[int, int, int]

# How much of what is behind a text is darkened.
WHITE: Colour = (245, 245, 245)
DARK: Colour = (28, 24, 20)
BACKING = 0.72

FONT = cv2.FONT_HERSHEY_SIMPLEX
MIN_FONT = 0.05

_PLAIN = {"°": " deg", "×": "x", "…": "..", "–": "-", "—": "-", "−": "-", "→": "->", "ß": "ss"}


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

    def box_at(self, left: int, top: int) -> Box:
        """Return its place at a corner, moved into the picture where it would reach beyond."""
        height, width = self._canvas.shape[:2]
        left, top = max(0, min(left, width - self.width)), max(0, min(top, height - self.height))
        return Box(left, top, left + self.width, top + self.height)

    def draw(self, box: Box) -> None:
        """Draw it into its place."""
        left, top = box.left, box.top
        behind = self._canvas[top : top + self.height, left : left + self.width]
        behind[:] = np.round(behind * (1 - BACKING) + np.array(DARK) * BACKING).astype(np.uint8)
        behind[:, : max(2, self._pad // 3)] = self._colour
        for index, line in enumerate(self._lines):
            baseline = top + self._pad + round(20 * self._font) + index * self._line_height
            _write(self._canvas, line, (left + 2 * self._pad, baseline), self._font, self._thickness)


def _write(canvas: Image, text: str, origin: tuple[int, int], font: float, thickness: int) -> None:
    """Write a text. The fonts of older OpenCV have no ``±``: it is written as a plus with a bar below."""
    x, y = origin
    for index, part in enumerate(text.split("±")):
        if index:
            plus = _text_width("+", font, thickness)
            cv2.putText(canvas, "+", (x, y - round(3 * font)), FONT, font, WHITE, thickness, cv2.LINE_AA)
            bar = (x + round(0.15 * plus), x + round(0.85 * plus))
            cv2.line(
                canvas, (bar[0], y + round(3 * font)), (bar[1], y + round(3 * font)), WHITE, thickness, cv2.LINE_AA
            )
            x += plus
        cv2.putText(canvas, part, (x, y), FONT, font, WHITE, thickness, cv2.LINE_AA)
        x += _text_width(part, font, thickness)


def _drawable(text: str) -> str:
    """Return a text with the characters that OpenCV's fonts have: ASCII and ``±``, and a question mark for others."""
    plain = "".join(_PLAIN.get(each, each) for each in text)
    without_accents = (each for each in unicodedata.normalize("NFKD", plain) if not unicodedata.combining(each))
    return "".join(each if each == "±" or " " <= each <= "~" else "?" for each in without_accents)


def _text_width(text: str, font: float, thickness: int) -> int:
    parts = text.split("±")
    widths = [cv2.getTextSize(part, FONT, font, thickness)[0][0] for part in parts if part]
    plus = cv2.getTextSize("+", FONT, font, thickness)[0][0]
    return int(sum(widths) + plus * (len(parts) - 1))


# Along the longer side of a picture.
MAX_CELLS = 320

# What a covered cell costs: of a target or another label, and of something that may be covered if it must.
TAKEN, USEFUL = 1.0, 3e-5

# What a place costs for each cell between label and target, for each by which its middle is not below the target's,
# and above the target instead of below.
A_CELL_AWAY, A_CELL_ASIDE, ABOVE = 2e-3, 4e-4, 4e-3

_BITS = 4


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


class LabelPlace(NamedTuple):
    """A place for a label, and whether nothing that matters is under it."""

    box: Box
    is_free: bool


class LabelRoom:
    """A picture with what is in it already."""

    def __init__(self, width_px: int, height_px: int) -> None:
        self._width_px, self._height_px = width_px, height_px
        self._cell_px = max(1, math.ceil(max(width_px, height_px) / MAX_CELLS))
        self._cost = np.zeros((math.ceil(height_px / self._cell_px), math.ceil(width_px / self._cell_px)), np.float32)

    def copy(self) -> LabelRoom:
        """Return the same room, to try something in."""
        other = LabelRoom(self._width_px, self._height_px)
        other._cost = self._cost.copy()
        return other

    def take_outline(self, points: Points, margin_px: float, cost: float = TAKEN) -> None:
        """Keep the inside of an outline free, and a margin around it."""
        if not len(points) or not np.isfinite(points).all():
            return
        cells = np.clip((points + 0.5) / self._cell_px - 0.5, -4 * MAX_CELLS, 4 * MAX_CELLS)
        hull = np.round(cv2.convexHull(cells.astype(np.float32)) * 2**_BITS).astype(np.int32)
        mask = np.zeros(self._cost.shape, np.uint8)
        cv2.fillConvexPoly(mask, hull, 1, cv2.LINE_8, _BITS)
        reach = math.ceil(margin_px / self._cell_px) + 1
        mask = np.asarray(cv2.dilate(mask, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)), np.uint8)
        self._cost = np.maximum(self._cost, cost * mask)

    def take_box(self, box: Box, margin_px: float = 0.0, cost: float = TAKEN) -> None:
        """Keep a rectangle free, and a margin around it."""
        left, top = (max(0, math.floor((each - margin_px) / self._cell_px)) for each in (box.left, box.top))
        right, bottom = (math.ceil((each + margin_px) / self._cell_px) for each in (box.right, box.bottom))
        part = self._cost[top:bottom, left:right]
        np.maximum(part, cost, out=part)

    def place(self, width_px: int, height_px: int, near: Box, gap_px: float) -> LabelPlace:
        """Return the best place for a label of this size; a label that is larger than the picture goes to its corner.

        Args:
            near: What it belongs to.
            gap_px: How far from that it is best.
        """
        rows, columns = self._cost.shape
        high, wide = (min(math.ceil(size / self._cell_px) + 1, most) for size, most in zip(
            (height_px, width_px), (rows, columns), strict=True
        ))  # fmt: skip
        total = np.asarray(cv2.integral(self._cost), np.float64)
        covered = total[high:, wide:] - total[:-high, wide:] - total[high:, :-wide] + total[:-high, :-wide]
        cost = covered + self._unhandy(covered.shape, (wide, high), near, gap_px)
        row, column = np.unravel_index(int(np.argmin(cost)), cost.shape)
        left = max(0, min(int(column) * self._cell_px, self._width_px - width_px))
        top = max(0, min(int(row) * self._cell_px, self._height_px - height_px))
        box = Box(left, top, left + width_px, top + height_px)
        return LabelPlace(box, bool(covered[row, column] < TAKEN / 2))

    def is_free(self, box: Box) -> bool:
        """Check whether nothing that matters is under a rectangle."""
        rows = slice(max(0, box.top // self._cell_px), math.ceil(box.bottom / self._cell_px))
        columns = slice(max(0, box.left // self._cell_px), math.ceil(box.right / self._cell_px))
        return not (self._cost[rows, columns] >= TAKEN).any()

    def _unhandy(self, shape: tuple[int, ...], size: tuple[int, int], near: Box, gap_px: float) -> NDArray[np.float64]:
        """Return the cost of each place for where it is, by row and column of the label's corner."""
        tops, lefts = np.arange(shape[0])[:, np.newaxis], np.arange(shape[1])[np.newaxis, :]
        left, top, right, bottom = (each / self._cell_px for each in near)
        gap = gap_px / self._cell_px
        across = np.maximum(np.maximum(left - (lefts + size[0]), lefts - right), 0)
        down = np.maximum(np.maximum(top - (tops + size[1]), tops - bottom), 0)
        aside = np.abs(lefts + size[0] / 2 - (left + right) / 2)
        is_above = tops + size[1] / 2 < (top + bottom) / 2
        away = np.abs(np.hypot(across, down) - gap)
        return np.asarray(A_CELL_AWAY * away + A_CELL_ASIDE * aside + ABOVE * is_above, np.float64)


# ----------------------------------------------------------------------------------------------------

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

# Sizes of the letters of labels that are tried, until all labels find room.
LABEL_SIZES = (1.0, 0.75, 0.55, 0.45)

# Between a target and its label, in units of the picture's scale; from this many gaps on a line joins them. Where
# one is further away than this share of the picture's longer side, all are written smaller.
LEGEND_SIZE = 0.7
GAP, LEADER_FROM, MAX_LABEL_SHARE = 12.0, 2.0, 0.08

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
        angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        around = np.column_stack([np.cos(angles), np.sin(angles)])
        points = np.array(candidate.centre_px) + candidate.size_px / 2 * around
    rim = _on_canvas(points, factor)
    return rim if np.isfinite(rim).all() and np.abs(rim).max() < REACH_MAX_PX else np.empty((0, 2))


def _draw_rejected(canvas: Image, candidate: RejectedCandidate, factor: int, scale: float) -> None:
    """Draw a candidate with a thin line: its corners, or a ring of its size."""
    rim = _rim(candidate, factor)
    if not len(rim):
        return
    x, y = (round(float(each) * 2**SUBPIXEL_BITS) for each in rim.mean(axis=0))
    radius = round(candidate.size_px * factor / 2 * 2**SUBPIXEL_BITS)
    thickness = max(1, round(scale))
    for width, shade in ((thickness + max(1, round(scale)), DARK), (thickness, GREY)):
        if candidate.corners_px:
            _draw_polygon(canvas, rim, shade, width)
        else:
            cv2.circle(canvas, (x, y), radius, shade, width, cv2.LINE_AA, SUBPIXEL_BITS)


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
    """Write labels beside their targets, and what was measured where nothing is in the way."""
    room = _room_around(canvas, marks, factor, scale)
    seen = [mark for mark in marks if len(mark.detection.outline_px)]
    placed, room = _labels(canvas, seen, room, factor, scale)
    legend = _legend(canvas, marks, room, scale)
    # Where the target fills the picture there is no room for both: what was measured begins with what the label says.
    placed = [each for each in placed if not any(each[2].meets(box) for _, box in legend)]
    for mark, _, box in placed:
        _draw_leader(canvas, mark, box, factor, scale)
    for panel, box in (*((panel, box) for _, panel, box in placed), *legend):
        panel.draw(box)
        room.take_box(box)
    for mark in marks:
        for number, candidate in mark.rejected:
            rim = _rim(candidate, factor)
            if len(rim):
                _draw_label(canvas, f"{number} {candidate.test}", rim, room, scale)


def _room_around(canvas: Image, marks: Sequence[Mark], factor: int, scale: float) -> LabelRoom:
    room = LabelRoom(canvas.shape[1], canvas.shape[0])
    for mark in marks:
        room.take_outline(_on_canvas(mark.detection.outline_px, factor), 4 * scale)
        for _, candidate in mark.rejected:
            room.take_outline(_rim(candidate, factor), scale, USEFUL)
    return room


_Placed = list[tuple[Mark, "Panel", Box]]


def _labels(
    canvas: Image, marks: Sequence[Mark], room: LabelRoom, factor: int, scale: float
) -> tuple[_Placed, LabelRoom]:
    """Return a label for each target as large as all of them find room nearby, and what room is left."""
    placed: _Placed = []
    left = room
    for size in LABEL_SIZES if marks else ():
        placed, left = [], room.copy()
        is_good = True
        for mark in sorted(marks, key=lambda each: -float(each.detection.outline_px[:, 1].max())):
            panel = Panel((mark.headline,), _COLOURS[mark.detection.status], size, scale, canvas)
            near = _box_around(_on_canvas(mark.detection.outline_px, factor))
            place = left.place(panel.width, panel.height, near, GAP * scale)
            left.take_box(place.box, 2 * scale)
            is_good = is_good and place.is_free and _is_beside(near, place.box, MAX_LABEL_SHARE * max(canvas.shape[:2]))
            placed.append((mark, panel, place.box))
        if is_good:
            break
    return placed, left


def _is_beside(target: Box, label: Box, reach_px: float) -> bool:
    """Check whether a label is above, below or beside its target's middle, and near it."""
    across = max(target.left - label.right, label.left - target.right, 0)
    down = max(target.top - label.bottom, label.top - target.bottom, 0)
    is_in_column = 2 * label.left <= target.left + target.right <= 2 * label.right
    is_in_row = 2 * label.top <= target.top + target.bottom <= 2 * label.bottom
    return (is_in_column or is_in_row) and math.hypot(across, down) < reach_px


def _legend(canvas: Image, marks: Sequence[Mark], room: LabelRoom, scale: float) -> list[tuple[Panel, Box]]:
    """Return the panels of what was measured, from the lower left corner on; first those with no label beside a target.

    Where one of the others finds no room, all of them are left out: their labels say the most.
    """
    margin = round(14 * scale)
    corner = Box(0, canvas.shape[0], 0, canvas.shape[0])
    alone: list[tuple[Panel, Box]] = []
    beside: list[tuple[Panel, Box]] = []
    is_free = True
    for _, mark in sorted(enumerate(marks), key=lambda each: (len(each[1].detection.outline_px) > 0, -each[0])):
        if not mark.lines:
            continue
        has_label = len(mark.detection.outline_px) > 0
        panel = Panel(mark.lines, _COLOURS[mark.detection.status], LEGEND_SIZE, scale, canvas)
        place = room.place(panel.width + 2 * margin, panel.height + 2 * margin, corner, 0.0)
        box = panel.box_at(place.box.left + margin, place.box.top + margin)
        room.take_box(box)
        is_free = is_free and (place.is_free or not has_label)
        (beside if has_label else alone).append((panel, box))
    return [*alone, *(beside if is_free or len(marks) == 1 else [])]


def _draw_label(canvas: Image, words: str, rim: Points, room: LabelRoom, scale: float) -> None:
    """Write what a candidate is called at one of its corners where nothing is in the way, at best the upper right."""
    panel = Panel((words,), GREY, 0.5, scale, canvas)
    gap = round(2 * scale)
    boxes = []
    for across, down in ((1, -1), (-1, -1), (1, 1), (-1, 1)):
        x, y = rim[np.argmax(rim @ (across, down))].tolist()
        left = round(x) + gap if across > 0 else round(x) - gap - panel.width
        boxes.append(panel.box_at(left, round(y) + gap if down > 0 else round(y) - gap - panel.height))
    box = next((each for each in boxes if room.is_free(each)), boxes[0])
    room.take_box(box)
    panel.draw(box)


def _box_around(points: Points) -> Box:
    left, top = np.floor(np.clip(points.min(axis=0), -REACH_MAX_PX, REACH_MAX_PX)).astype(int).tolist()
    right, bottom = np.ceil(np.clip(points.max(axis=0), -REACH_MAX_PX, REACH_MAX_PX)).astype(int).tolist()
    return Box(left, top, right, bottom)


def _draw_leader(canvas: Image, mark: Mark, box: Box, factor: int, scale: float) -> None:
    """Draw a line from a label that is away from its target to the target's outline."""
    outline = _on_canvas(mark.detection.outline_px, factor)
    if mark.has_corners:
        along = np.linspace(0, 1, 32)[:, np.newaxis, np.newaxis]
        outline = (outline + along * (np.roll(outline, -1, axis=0) - outline)).reshape(-1, 2)
    start = np.array([np.clip(outline[:, 0], box.left, box.right), np.clip(outline[:, 1], box.top, box.bottom)]).T
    apart = np.linalg.norm(outline - start, axis=1)
    nearest = int(np.argmin(apart))
    if not LEADER_FROM * GAP * scale < apart[nearest] < REACH_MAX_PX:
        return
    ends = [tuple(round(float(each)) for each in point) for point in (start[nearest], outline[nearest])]
    colour = _COLOURS[mark.detection.status]
    for shade, thickness in ((DARK, max(2, round(3.4 * scale))), (colour, max(1, round(1.4 * scale)))):
        cv2.line(canvas, ends[0], ends[1], shade, thickness, cv2.LINE_AA)
