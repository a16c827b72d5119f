"""Labels in pictures: panels of text, and where they go: near what they name, and on nothing else if there is room.

The picture is divided into cells. What must stay visible gives its cells a high cost, and a summed-area table gives the
cost of what a label would cover at every place at once (F. Crow, Summed-area tables for texture mapping, SIGGRAPH
1984): the cheapest place is the best one, not the first that does.
"""

from __future__ import annotations

import math
import unicodedata
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.core.frame import Image

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
        """Return whether the two have a pixel in common."""
        is_beside = self.right <= other.left or other.right <= self.left
        return not (is_beside or self.bottom <= other.top or other.bottom <= self.top)


class LabelPlace(NamedTuple):
    """Where a label goes, and whether nothing that matters is under it."""

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
        """Return whether nothing that matters is under a rectangle."""
        rows = slice(max(0, box.top // self._cell_px), math.ceil(box.bottom / self._cell_px))
        columns = slice(max(0, box.left // self._cell_px), math.ceil(box.right / self._cell_px))
        return not (self._cost[rows, columns] >= TAKEN).any()

    def _unhandy(self, shape: tuple[int, ...], size: tuple[int, int], near: Box, gap_px: float) -> NDArray[np.float64]:
        """Return what each place costs for where it is, by row and column of the label's corner."""
        tops, lefts = np.arange(shape[0])[:, np.newaxis], np.arange(shape[1])[np.newaxis, :]
        left, top, right, bottom = (each / self._cell_px for each in near)
        gap = gap_px / self._cell_px
        across = np.maximum(np.maximum(left - (lefts + size[0]), lefts - right), 0)
        down = np.maximum(np.maximum(top - (tops + size[1]), tops - bottom), 0)
        aside = np.abs(lefts + size[0] / 2 - (left + right) / 2)
        is_above = tops + size[1] / 2 < (top + bottom) / 2
        away = np.abs(np.hypot(across, down) - gap)
        return np.asarray(A_CELL_AWAY * away + A_CELL_ASIDE * aside + ABOVE * is_above, np.float64)
