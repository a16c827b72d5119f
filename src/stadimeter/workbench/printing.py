"""Targets and calibration boards on pages to print, at true scale, each page with a ruler to check the printer."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import escape

import cv2
import numpy as np

from stadimeter.config.files import write_atomically
from stadimeter.config.units import paper_sides, parse_length
from stadimeter.core.drawing import WHITE, Circle, Drawing, Line, Rectangle, Shape, Text, black_cells
from stadimeter.errors import ConfigError, reason_of
from stadimeter.workbench.calibration.board_session import Board, CharucoBoard

# Drawings as files at true scale: PDF (ISO 32000-1) in the fonts that every reader has, and SVG -----------------------

POINTS_PER_M = 72 / 0.0254

# Four Bézier curves with control points this share of the radius away are a circle to 0.03 % of its radius.
KAPPA = 0.5522847498

# Widths of Helvetica from space on, in thousandths of its size (Adobe's font metrics); others count as 556.
WIDTHS = (
    278, 278, 355, 556, 556, 889, 667, 191, 333, 333, 389, 584, 278, 333, 278, 278, 556, 556, 556, 556, 556, 556, 556,
    556, 556, 556, 278, 278, 584, 584, 584, 556, 1015, 667, 667, 722, 722, 667, 611, 778, 722, 278, 500, 667, 556, 833,
    722, 778, 667, 778, 722, 667, 611, 722, 667, 944, 667, 667, 611, 278, 278, 278, 469, 556, 333, 556, 556, 500, 556,
    556, 278, 556, 556, 222, 222, 500, 222, 833, 556, 556, 556, 556, 333, 500, 278, 556, 500, 722, 500, 500, 500, 334,
    260, 334, 584,
)  # fmt: skip

FIXED_WIDTH = 600


def pdf_of(pages: Sequence[Drawing]) -> bytes:
    """Return drawings as a PDF file, a page for each, of its true size."""
    objects: list[bytes | str] = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        f"<< /Type /Pages /Count {len(pages)} /Kids [{' '.join(f'{5 + 2 * n} 0 R' for n in range(len(pages)))}] >>",
        _font("Helvetica"),
        _font("Courier"),
    ]
    for number, page in enumerate(pages):
        size = f"[0 0 {_number(page.width_m * POINTS_PER_M)} {_number(page.height_m * POINTS_PER_M)}]"
        fonts = "<< /Font << /F1 3 0 R /F2 4 0 R >> >>"
        contents = f"/Contents {6 + 2 * number} 0 R"
        objects.append(f"<< /Type /Page /Parent 2 0 R /MediaBox {size} /Resources {fonts} {contents} >>")
        stream = "\n".join(_operators(page)).encode("cp1252", "replace")
        objects.append(b"<< /Length %d >>\nstream\n%b\nendstream" % (len(stream), stream))
    return _file([each.encode("ascii") if isinstance(each, str) else each for each in objects])


def text_width_m(text: str, size_m: float) -> float:
    """Return the width of a text in Helvetica."""
    known = (ord(character) - 32 for character in text)
    return sum(WIDTHS[code] if 0 <= code < len(WIDTHS) else 556 for code in known) * size_m / 1000


def _font(name: str) -> str:
    return f"<< /Type /Font /Subtype /Type1 /BaseFont /{name} /Encoding /WinAnsiEncoding >>"


def _file(objects: Sequence[bytes]) -> bytes:
    """Return a file of these objects, numbered from 1, with the table of where each begins."""
    data, starts = b"%PDF-1.4\n", []
    for number, each in enumerate(objects, start=1):
        starts.append(len(data))
        data += b"%d 0 obj\n%b\nendobj\n" % (number, each)
    table = b"".join(b"%010d 00000 n \n" % start for start in starts)
    count = len(objects) + 1
    head = b"xref\n0 %d\n0000000000 65535 f \n%b" % (count, table)
    return data + head + b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (count, len(data))


def _operators(page: Drawing) -> Iterator[str]:
    """Yield the page's content, in points from its lower left corner."""
    for (kind, colour, outline_m), shapes in groupby(page.shapes, key=_look):
        paint = "RG" if kind is Line or outline_m else "rg"
        yield f"{_colour(colour)} {paint}"
        # Neighbours of one look are one path: painted one by one, hair lines would show between them.
        for shape in shapes:
            yield _path(shape, page.height_m)
        if kind in {Rectangle, Circle}:
            yield f"{_points(outline_m)} w S" if outline_m else "f"


def _look(shape: Shape) -> tuple[type[Shape], str, float]:
    return type(shape), shape.colour, shape.outline_m if isinstance(shape, Rectangle) else 0.0


def _path(shape: Shape, height_m: float) -> str:
    match shape:
        case Rectangle():
            corner = f"{_points(shape.x_m)} {_points(height_m - shape.y_m - shape.height_m)}"
            return f"{corner} {_points(shape.width_m)} {_points(shape.height_m)} re"
        case Circle():
            return _circle(shape, height_m)
        case Line():
            ends = f"{_points(shape.x1_m)} {_points(height_m - shape.y1_m)} m {_points(shape.x2_m)}"
            return f"2 J {_points(shape.width_m)} w {ends} {_points(height_m - shape.y2_m)} l S"
    return _text(shape, height_m)


def _circle(circle: Circle, height_m: float) -> str:
    radius, off = circle.radius_m, circle.radius_m * KAPPA
    x, y = circle.x_m, height_m - circle.y_m
    quarters = (
        (radius, off, off, radius, 0.0, radius),
        (-off, radius, -radius, off, -radius, 0.0),
        (-radius, -off, -off, -radius, 0.0, -radius),
        (off, -radius, radius, -off, radius, 0.0),
    )
    curves = (
        " ".join(_points(value + (x, y)[index % 2]) for index, value in enumerate(each)) + " c" for each in quarters
    )
    return f"{_points(x + radius)} {_points(y)} m {' '.join(curves)} h"


def _text(text: Text, height_m: float) -> str:
    width_m = (
        len(text.text) * FIXED_WIDTH / 1000 * text.size_m
        if text.is_fixed_width
        else text_width_m(text.text, text.size_m)
    )
    left_m = text.x_m - {"start": 0.0, "middle": 0.5, "end": 1.0}[text.anchor] * width_m
    shown = text.text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
    font = f"/F{2 if text.is_fixed_width else 1} {_points(text.size_m)} Tf"
    return f"BT {font} {_points(left_m)} {_points(height_m - text.y_m)} Td ({shown}) Tj ET"


def _colour(colour: str) -> str:
    return " ".join(_number(int(colour[index : index + 2], 16) / 255) for index in (1, 3, 5))


def _points(length_m: float) -> str:
    return _number(length_m * POINTS_PER_M)


def _number(value: float) -> str:
    return f"{value:.4f}".rstrip("0").rstrip(".")


# A unit of the picture is a millimetre.
PER_M = 1000.0

_HEAD = '<svg xmlns="http://www.w3.org/2000/svg" width="{0}mm" height="{1}mm" viewBox="0 0 {0} {1}">'


def svg_of(drawing: Drawing) -> str:
    """Return a drawing as an SVG picture of its true size on a white ground."""
    head = _HEAD.format(_mm(drawing.width_m), _mm(drawing.height_m))
    ground = Rectangle(0.0, 0.0, drawing.width_m, drawing.height_m, WHITE)
    return "\n".join([head, *(_element(shape) for shape in (ground, *drawing.shapes)), "</svg>", ""])


def _element(shape: Shape) -> str:
    match shape:
        case Rectangle():
            ink = (
                f'fill="none" stroke="{shape.colour}" stroke-width="{_mm(shape.outline_m)}"'
                if shape.outline_m
                else f'fill="{shape.colour}" shape-rendering="crispEdges"'
            )
            sides = f'width="{_mm(shape.width_m)}" height="{_mm(shape.height_m)}"'
            return f'<rect x="{_mm(shape.x_m)}" y="{_mm(shape.y_m)}" {sides} {ink}/>'
        case Circle():
            place = f'cx="{_mm(shape.x_m)}" cy="{_mm(shape.y_m)}"'
            return f'<circle {place} r="{_mm(shape.radius_m)}" fill="{shape.colour}"/>'
        case Line():
            ends = f'x1="{_mm(shape.x1_m)}" y1="{_mm(shape.y1_m)}" x2="{_mm(shape.x2_m)}" y2="{_mm(shape.y2_m)}"'
            return f'<line {ends} stroke="{shape.colour}" stroke-width="{_mm(shape.width_m)}" stroke-linecap="square"/>'
    family = "Courier, monospace" if shape.is_fixed_width else "Helvetica, Arial, sans-serif"
    look = f'font-size="{_mm(shape.size_m)}" font-family="{family}" text-anchor="{shape.anchor}" fill="{shape.colour}"'
    return f'<text x="{_mm(shape.x_m)}" y="{_mm(shape.y_m)}" {look}>{escape(shape.text)}</text>'


def _mm(length_m: float) -> str:
    return f"{length_m * PER_M:.4f}".rstrip("0").rstrip(".")


def write_drawings(path: Path, pages: Sequence[Drawing]) -> None:
    """Write drawings to one file, whose ending says the kind: ``.pdf``, or ``.svg`` for a single one.

    Raises:
        ConfigError: The ending is another, there are too many drawings for it, or the file cannot be written.
    """
    kind = path.suffix.lower()
    if kind not in {".pdf", ".svg"}:
        raise ConfigError(f"{path}: drawings are written as .pdf or .svg; give the file one of these endings")
    if kind == ".svg" and len(pages) != 1:
        raise ConfigError(f"{path}: an SVG picture holds one page and there are {len(pages)}; write a .pdf file")
    data = pdf_of(pages) if kind == ".pdf" else svg_of(pages[0]).encode()
    try:
        write_atomically(path, data)
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {reason_of(error)}") from error


def board_drawing(board: Board) -> Drawing:
    """Return a board; a chessboard begins with a black square, and so does a ChArUco board."""
    if isinstance(board, CharucoBoard):
        return _charuco(board)
    return _squares(board.columns + 1, board.rows + 1, board.square_m)


def _squares(columns: int, rows: int, square_m: float) -> Drawing:
    black = [[(row + column) % 2 == 0 for column in range(columns)] for row in range(rows)]
    return black_cells(black, square_m)


def _charuco(board: CharucoBoard) -> Drawing:
    """Return the squares, and the markers where OpenCV's own board has them."""
    of_opencv = board.of_opencv()
    dictionary = of_opencv.getDictionary()
    squares = _squares(board.columns, board.rows, board.square_m)
    shapes: list[Shape] = [*squares.shapes]
    corners_m = np.asarray(of_opencv.getObjPoints(), np.float64)[:, 0, :2]
    for number, (x_m, y_m) in zip(np.ravel(of_opencv.getIds()), corners_m, strict=True):
        cells = int(dictionary.markerSize) + 2
        black = np.asarray(cv2.aruco.generateImageMarker(dictionary, int(number), cells)) == 0
        shapes += black_cells(black.tolist(), board.marker_m / cells).moved(float(x_m), float(y_m))
    return Drawing(squares.width_m, squares.height_m, tuple(shapes))


# What printers leave white, and a little more.
PAPERS = ("A4", "letter", "A3", "legal", "tabloid", "A2", "A1")
MARGIN_M = 0.008

FOOTER_M = 0.017
LABEL_M = 0.005
GAP_M = 0.004
TEXT_M = 0.0026
LINE_M = 1.35 * TEXT_M
RULER_M, RULER_IN = 0.1, 4
INCH_M = 0.0254


class Item(NamedTuple):
    """A drawing to print, and what stands below it; empty for nothing."""

    drawing: Drawing
    label: str = ""

    @property
    def height_m(self) -> float:
        """The height with the label."""
        return self.drawing.height_m + (LABEL_M if self.label else 0.0)


class _Grid(NamedTuple):
    """The layout of the items on a page."""

    width_m: float
    height_m: float
    columns: int
    rows: int

    @property
    def holds(self) -> int:
        """The number of items that it holds."""
        return self.columns * self.rows


def print_pages(items: Sequence[Item], paper: str, words: Sequence[str]) -> tuple[Drawing, ...]:
    """Return pages with items of one size: as few as hold them, upright or across.

    Args:
        paper: Its name, see `PAPERS`.
        words: Lines for the foot of each page.

    Raises:
        ConfigError: There is no such paper, or an item is larger than it.
    """
    name = {each.casefold(): each for each in PAPERS}.get(paper.strip().casefold())
    if name is None:
        raise ConfigError(f"--paper: {paper!r} is no paper to print on; there are {', '.join(PAPERS)}")
    grid = _best_grid(items[0], name)
    if not grid.holds:
        size = f"{100 * items[0].drawing.width_m:.1f} × {100 * items[0].drawing.height_m:.1f} cm"
        way = next((f", or take --paper {each}" for each in PAPERS if _best_grid(items[0], each).holds), "")
        raise ConfigError(f"that takes {size} on the paper and {name} has no room for it: make it smaller{way}")
    parts = [items[first : first + grid.holds] for first in range(0, len(items), grid.holds)]
    return tuple(
        Drawing(grid.width_m, grid.height_m, (*_place_items(each, grid), *_foot(grid, words))) for each in parts
    )


def _best_grid(item: Item, paper: str) -> _Grid:
    """Return the better of the two ways to hold a paper; upright if they are alike."""
    short_m, long_m = sorted(parse_length(side) for side in paper_sides(paper))
    return max((_fit_grid(item, short_m, long_m), _fit_grid(item, long_m, short_m)), key=lambda grid: grid.holds)


def _fit_grid(item: Item, width_m: float, height_m: float) -> _Grid:
    rooms_m = zip(_room(width_m, height_m), (item.drawing.width_m, item.height_m), strict=True)
    columns, rows = (math.floor((room_m + GAP_M) / (each_m + GAP_M) + 1e-9) for room_m, each_m in rooms_m)
    return _Grid(width_m, height_m, columns, rows)


def _room(width_m: float, height_m: float) -> tuple[float, float]:
    return width_m - 2 * MARGIN_M, height_m - 2 * MARGIN_M - FOOTER_M


def _place_items(items: Sequence[Item], grid: _Grid) -> Iterator[Shape]:
    across_m, down_m = _room(grid.width_m, grid.height_m)
    columns = min(grid.columns, len(items))
    cell_width_m, cell_height_m = across_m / columns, down_m / math.ceil(len(items) / columns)
    for index, (drawing, label) in enumerate(items):
        row, column = divmod(index, columns)
        x_m = MARGIN_M + column * cell_width_m + (cell_width_m - drawing.width_m) / 2
        y_m = MARGIN_M + row * cell_height_m + (cell_height_m - items[index].height_m) / 2
        yield from drawing.moved(x_m, y_m)
        if label:
            base_m = y_m + drawing.height_m + TEXT_M
            yield Text(x_m + drawing.width_m / 2, base_m, label, TEXT_M, "middle", colour="#606060")


def _foot(grid: _Grid, words: Sequence[str]) -> Iterator[Shape]:
    top_m = grid.height_m - MARGIN_M - FOOTER_M
    yield from _ruler(MARGIN_M, top_m + FOOTER_M / 2)
    left_m = MARGIN_M + RULER_IN * INCH_M + 0.008
    lines = [line for each in words for line in _wrap(each, grid.width_m - MARGIN_M - left_m)]
    first_m = top_m + (FOOTER_M - len(lines) * LINE_M) / 2 + TEXT_M
    for number, line in enumerate(lines):
        yield Text(left_m, first_m + number * LINE_M, line, TEXT_M)


def _ruler(x_m: float, y_m: float) -> Iterator[Shape]:
    """Yield a ruler: centimetres above its line and inches below, each from its left end on."""
    yield Line(x_m, y_m, x_m + RULER_IN * INCH_M, y_m)
    scales = ((RULER_M / 0.001, 10, 0.001, -1, y_m - 0.0047), (8 * RULER_IN, 8, INCH_M / 8, 1, y_m + 0.0065))
    for ticks, whole, step_m, side, base_m in scales:
        for number in range(round(ticks) + 1):
            tick_m = 0.004 if number % whole == 0 else 0.0027 if number % (whole // 2) == 0 else 0.0016
            at_m = x_m + number * step_m
            yield Line(at_m, y_m, at_m, y_m + side * tick_m)
            if number % whole == 0:
                unit = " in" if side > 0 and number == ticks else ""
                yield Text(at_m, base_m, f"{number // whole}{unit}", 0.0021, "middle")
    yield Text(x_m + RULER_M + 0.0015, y_m - 0.0047, "cm", 0.0021)


def _wrap(text: str, room_m: float) -> Iterator[str]:
    line = ""
    for word in text.split():
        longer = f"{line} {word}".strip()
        if line and text_width_m(longer, TEXT_M) > room_m:
            yield line
            longer = word
        line = longer
    yield line
