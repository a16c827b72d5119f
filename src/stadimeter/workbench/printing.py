"""Targets and calibration boards on pages to print, at true scale, each page with a ruler to check the printer."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from stadimeter.config.units import paper_sides, parse_length
from stadimeter.core.drawing import Drawing, Line, Shape, Text, black_cells
from stadimeter.errors import ConfigError
from stadimeter.workbench.calibration.board_session import Board, CharucoBoard, Chessboard
from stadimeter.workbench.drawing import text_width_m


def board_drawing(board: Board) -> Drawing:
    """Return a board; a chessboard begins with a black square, and so does a ChArUco board."""
    return _charuco(board) if isinstance(board, CharucoBoard) else _chessboard(board)


def _chessboard(board: Chessboard) -> Drawing:
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
    """A drawing to print.

    Attributes:
        measure: What its size goes by, such as ``the side``, for the message where it is too large.
        measure_m: How long that is.
        label: What stands below it; empty for nothing.
    """

    drawing: Drawing
    measure: str
    measure_m: float
    label: str = ""


class _Grid(NamedTuple):
    """The layout of the items on a page."""

    width_m: float
    height_m: float
    columns: int
    rows: int


def print_pages(items: Sequence[Item], paper: str, words: Sequence[str]) -> tuple[Drawing, ...]:
    """Return pages with items of one size: as few as hold them, upright or across.

    Args:
        paper: Its name, see `PAPERS`.
        words: Lines for the foot of each page.

    Raises:
        ConfigError: There is no such paper, or an item is larger than it; the message says how large one may be.
    """
    grid = _grid(items[0], paper)
    on_one = grid.columns * grid.rows
    parts = [items[first : first + on_one] for first in range(0, len(items), on_one)]
    return tuple(
        Drawing(grid.width_m, grid.height_m, (*_place_items(each, grid), *_foot(grid, words))) for each in parts
    )


def _grid(item: Item, paper: str) -> _Grid:
    """Return the better of the two ways to hold the paper; upright if they are alike."""
    name = {each.casefold(): each for each in PAPERS}.get(paper.strip().casefold())
    if name is None:
        raise ConfigError(f"--paper: {paper!r} is no paper to print on; there are {', '.join(PAPERS)}")
    best = max((_fit_grid(item, *sides) for sides in _both_ways(name)), key=_count)
    if not _count(best):
        raise ConfigError(_too_large(item, name))
    return best


def _both_ways(paper: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return width and height of a paper upright and across."""
    short_m, long_m = sorted(parse_length(side) for side in paper_sides(paper))
    return (short_m, long_m), (long_m, short_m)


def _count(grid: _Grid) -> int:
    return grid.columns * grid.rows


def _fit_grid(item: Item, width_m: float, height_m: float) -> _Grid:
    room_across_m, room_down_m = _room(width_m, height_m)
    columns = _how_many(room_across_m, item.drawing.width_m)
    return _Grid(width_m, height_m, columns, _how_many(room_down_m, item.drawing.height_m + _label_m(item)))


def _room(width_m: float, height_m: float) -> tuple[float, float]:
    return width_m - 2 * MARGIN_M, height_m - 2 * MARGIN_M - FOOTER_M


def _how_many(room_m: float, each_m: float) -> int:
    return math.floor((room_m + GAP_M) / (each_m + GAP_M) + 1e-9)


def _label_m(item: Item) -> float:
    return LABEL_M if item.label else 0.0


def _largest_share(item: Item, paper: str) -> float:
    """Find how many times as large as it is an item can be on a paper."""
    shares = []
    for sides in _both_ways(paper):
        across_m, down_m = _room(*sides)
        shares.append(min(across_m / item.drawing.width_m, (down_m - _label_m(item)) / item.drawing.height_m))
    return max(shares)


def _too_large(item: Item, name: str) -> str:
    size = f"{100 * item.drawing.width_m:.1f} × {100 * item.drawing.height_m:.1f} cm"
    fits_mm = math.floor(1000 * item.measure_m * _largest_share(item, name))
    larger = [each for each in PAPERS if _largest_share(item, each) >= 1]
    way = f", or take --paper {larger[0]}" if larger else ""
    return f"that takes {size} on the paper and {name} has no room for it: make {item.measure} {fits_mm}mm at most{way}"


def _place_items(items: Sequence[Item], grid: _Grid) -> Iterator[Shape]:
    across_m, down_m = _room(grid.width_m, grid.height_m)
    columns = min(grid.columns, len(items))
    cell_width_m, cell_height_m = across_m / columns, down_m / math.ceil(len(items) / columns)
    for index, (drawing, _, _, label) in enumerate(items):
        row, column = divmod(index, columns)
        x_m = MARGIN_M + column * cell_width_m + (cell_width_m - drawing.width_m) / 2
        y_m = MARGIN_M + row * cell_height_m + (cell_height_m - drawing.height_m - _label_m(items[0])) / 2
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
    for millimetre in range(101):
        tick_m = 0.004 if millimetre % 10 == 0 else 0.0027 if millimetre % 5 == 0 else 0.0016
        at_m = x_m + millimetre / 1000
        yield Line(at_m, y_m, at_m, y_m - tick_m)
        if millimetre % 10 == 0:
            yield Text(at_m, y_m - 0.0047, str(millimetre // 10), 0.0021, "middle")
    for eighth in range(8 * RULER_IN + 1):
        tick_m = 0.004 if eighth % 8 == 0 else 0.0027 if eighth % 4 == 0 else 0.0016
        at_m = x_m + eighth * INCH_M / 8
        yield Line(at_m, y_m, at_m, y_m + tick_m)
        if eighth % 8 == 0:
            unit = " in" if eighth == 8 * RULER_IN else ""
            yield Text(at_m, y_m + 0.0065, f"{eighth // 8}{unit}", 0.0021, "middle")
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
