"""Copies of pictures with what was measured drawn in: outline, centre, distance, and a legend."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from stadimeter.config.atomic_file import write_atomically
from stadimeter.core.detection import Detection, DetectionStatus, Points, RejectedCandidate
from stadimeter.core.frame import Image
from stadimeter.errors import PictureError

Colour = tuple[int, int, int]

GREEN: Colour = (110, 230, 60)
ORANGE: Colour = (40, 160, 255)
RED: Colour = (90, 90, 255)
WHITE: Colour = (245, 245, 245)
GREY: Colour = (215, 190, 170)
DARK: Colour = (28, 24, 20)
BACKING = 0.72
"""How much of what is behind a text is darkened."""

REFERENCE_PX = 900.0
"""The long side of a picture in which a line is two pixels thick; in others everything grows and shrinks with it."""

SMALLEST_LONG_SIDE_PX = 600
"""Smaller pictures are enlarged: letters need pixels."""

FONT = cv2.FONT_HERSHEY_SIMPLEX
JPEG_QUALITY = 93
SUBPIXEL_BITS = 4

REACH_MAX_PX = 1e5
"""Beyond this nothing is drawn: OpenCV's drawing counts in whole numbers of 32 bits."""

_COLOURS = {DetectionStatus.FOUND: GREEN, DetectionStatus.TRUNCATED: ORANGE, DetectionStatus.NOT_FOUND: RED}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Mark:
    """Drawing for one target.

    Attributes:
        has_corners: Whether its outline is corners in order, or else points on a rim that may be hidden in parts.
        headline: What stands beside it, such as ``35.0 in ± 0.4``; for a target that was not found, the legend only.
    """

    detection: Detection
    has_corners: bool = False
    headline: str
    lines: tuple[str, ...] = ()
    rejected: tuple[tuple[int, RejectedCandidate], ...] = ()


def annotate(image: Image, marks: Sequence[Mark]) -> Image:
    """Draw what was measured into a copy of a picture, which is enlarged by a whole factor if it is small."""
    factor = math.ceil(SMALLEST_LONG_SIDE_PX / max(image.shape[:2]))
    canvas = image.copy() if factor == 1 else _enlarged(image, factor)
    scale = max(canvas.shape[:2]) / REFERENCE_PX
    for mark in marks:
        for number, candidate in mark.rejected:
            _draw_rejected(canvas, number, candidate, factor, scale)
    for mark in marks:
        _draw_target(canvas, mark, factor, scale)
    for mark in marks:
        if len(mark.detection.outline_px):
            _draw_headline(canvas, mark, factor, scale)
    _draw_legend(canvas, marks, factor, scale)
    return canvas


def write_picture(path: Path, image: Image) -> None:
    """Write a picture whole or not at all; the ending of the path says the kind.

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
        write_atomically(path, data.tobytes())
    except OSError as error:
        raise PictureError(f"the picture {path} cannot be written: {(error.strerror or str(error)).lower()}") from error


def _enlarged(image: Image, factor: int) -> Image:
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
    _draw_cross(canvas, _on_canvas(np.array(detection.centre_px), factor), colour, scale)


def _draw_rejected(canvas: Image, number: int, candidate: RejectedCandidate, factor: int, scale: float) -> None:
    """Draw a thin ring of the candidate's size around its centre, with its number at the upper right."""
    centre = _on_canvas(np.array(candidate.centre_px), factor)
    radius = candidate.size_px * factor / 2
    if not (np.isfinite(centre).all() and 0 < radius < REACH_MAX_PX and np.abs(centre).max() < REACH_MAX_PX):
        return
    x, y = (round(float(each) * 2**SUBPIXEL_BITS) for each in centre)
    fixed_radius = round(radius * 2**SUBPIXEL_BITS)
    thickness = max(1, round(scale))
    for width, shade in ((thickness + max(1, round(scale)), DARK), (thickness, GREY)):
        cv2.circle(canvas, (x, y), fixed_radius, shade, width, cv2.LINE_AA, SUBPIXEL_BITS)
    aside = radius * math.sqrt(0.5) + 2 * scale
    panel = _Panel((str(number),), GREY, 0.5, scale, canvas)
    panel.draw(round(float(centre[0]) + aside), round(float(centre[1]) - aside) - panel.height)


def _draw_polygon(canvas: Image, corners: Points, colour: Colour, thickness: int) -> None:
    fixed = np.round(corners * 2**SUBPIXEL_BITS).astype(np.int32).reshape(-1, 1, 2)
    cv2.polylines(canvas, [fixed], isClosed=True, color=colour, thickness=thickness, lineType=cv2.LINE_AA, shift=4)


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


def _draw_headline(canvas: Image, mark: Mark, factor: int, scale: float) -> None:
    """Write the headline below the target, or above it where there is no room."""
    outline = _on_canvas(mark.detection.outline_px, factor)
    panel = _Panel((mark.headline,), _COLOURS[mark.detection.status], 1.0, scale, canvas)
    gap = round(12 * scale)
    left = round(float(outline[:, 0].mean()) - panel.width / 2)
    top = round(float(outline[:, 1].max())) + gap
    if top + panel.height > canvas.shape[0] - gap:
        top = round(float(outline[:, 1].min())) - gap - panel.height
    panel.draw(left, top)


def _draw_legend(canvas: Image, marks: Sequence[Mark], factor: int, scale: float) -> None:
    """Write what was measured into the lower left corner, or into the upper one where a target is in the way."""
    panels = [_Panel(mark.lines, _COLOURS[mark.detection.status], 0.7, scale, canvas) for mark in marks if mark.lines]
    margin, gap = round(14 * scale), round(8 * scale)
    height = sum(panel.height + gap for panel in panels) - gap
    right = margin + max((panel.width for panel in panels), default=0)
    top = canvas.shape[0] - margin - height
    outlines = [_on_canvas(mark.detection.outline_px, factor) for mark in marks]
    if any(((outline[:, 0] < right + margin) & (outline[:, 1] > top - margin)).any() for outline in outlines):
        top = margin
    for panel in panels:
        panel.draw(margin, top)
        top += panel.height + gap


class _Panel:
    """Lines of text on a dark backing with a stripe of the target's colour, as wide as the picture at most."""

    def __init__(self, lines: tuple[str, ...], colour: Colour, size: float, scale: float, canvas: Image) -> None:
        self._lines = lines
        self._colour = colour
        self._canvas = canvas
        widest = max(_text_width(line, size * scale, 1) for line in lines)
        room = canvas.shape[1] - 2 * round(16 * scale)
        self._font = size * scale * min(1.0, (room - 3 * 12 * scale * size) / max(widest, 1))
        self._thickness = max(1, round(1.9 * self._font))
        self._pad = round(13 * self._font)
        self._line_height = round(35 * self._font)
        text_width = max(_text_width(line, self._font, self._thickness) for line in lines)
        self.width = text_width + 3 * self._pad
        self.height = self._line_height * len(lines) + 2 * self._pad - round(8 * self._font)

    def draw(self, left: int, top: int) -> None:
        """Draw it, moved into the picture where it would reach beyond."""
        height, width = self._canvas.shape[:2]
        left = max(0, min(left, width - self.width))
        top = max(0, min(top, height - self.height))
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


def _text_width(text: str, font: float, thickness: int) -> int:
    parts = text.split("±")
    widths = [cv2.getTextSize(part, FONT, font, thickness)[0][0] for part in parts if part]
    plus = cv2.getTextSize("+", FONT, font, thickness)[0][0]
    return int(sum(widths) + plus * (len(parts) - 1))
