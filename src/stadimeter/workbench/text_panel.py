"""Panels of text in pictures, with the letters that OpenCV's fonts have."""

from __future__ import annotations

import unicodedata

import cv2
import numpy as np

from stadimeter.core.frame import Image
from stadimeter.workbench.label_placement import Box

Colour = tuple[int, int, int]

WHITE: Colour = (245, 245, 245)
DARK: Colour = (28, 24, 20)
BACKING = 0.72
"""How much of what is behind a text is darkened."""

FONT = cv2.FONT_HERSHEY_SIMPLEX
SMALLEST_FONT = 0.05

_PLAIN = {"°": " deg", "×": "x", "…": "..", "–": "-", "—": "-", "−": "-", "→": "->", "ß": "ss"}


class Panel:
    """Lines of text on a dark backing with a stripe of the target's colour, as wide as the picture at most."""

    def __init__(self, lines: tuple[str, ...], colour: Colour, size: float, scale: float, canvas: Image) -> None:
        self._lines = tuple(_drawable(line) for line in lines)
        self._colour = colour
        self._canvas = canvas
        room = canvas.shape[1] - 2 * round(16 * scale)
        self._set_in(size * scale)
        while self.width > room and self._font > SMALLEST_FONT:
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
