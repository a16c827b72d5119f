"""A drawing at true scale, made of a few plain shapes: printed targets and wiring. Its frame is x right, y down."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Literal, NamedTuple, TypeAlias

BLACK, WHITE = "#000000", "#ffffff"


class Rectangle(NamedTuple):
    """A rectangle by its upper left corner; without ``outline_m`` it is filled, else drawn with a line so wide."""

    x_m: float
    y_m: float
    width_m: float
    height_m: float
    colour: str = BLACK
    outline_m: float = 0.0


class Circle(NamedTuple):
    """A filled circle around its centre."""

    x_m: float
    y_m: float
    radius_m: float
    colour: str = BLACK


class Line(NamedTuple):
    """A straight line."""

    x1_m: float
    y1_m: float
    x2_m: float
    y2_m: float
    width_m: float = 0.0002
    colour: str = BLACK


class Text(NamedTuple):
    """One line of text; `x_m` is where it starts, has its middle or ends, `y_m` is its baseline."""

    x_m: float
    y_m: float
    text: str
    size_m: float
    anchor: Literal["start", "middle", "end"] = "start"
    is_fixed_width: bool = False
    colour: str = BLACK


Shape: TypeAlias = Rectangle | Circle | Line | Text


class Drawing(NamedTuple):
    """Shapes, the later above the earlier, on a white ground of this size."""

    width_m: float
    height_m: float
    shapes: tuple[Shape, ...]

    def moved(self, x_m: float, y_m: float) -> tuple[Shape, ...]:
        """Return its shapes, moved."""
        return tuple(_moved(shape, x_m, y_m) for shape in self.shapes)


def black_cells(black: Sequence[Sequence[bool]], cell_m: float) -> Drawing:
    """Return the black cells of a grid, such as a tag's, row by row; neighbours in a row are one rectangle."""
    runs = tuple(
        Rectangle(start * cell_m, row * cell_m, (end - start) * cell_m, cell_m)
        for row, cells in enumerate(black)
        for start, end in _runs(cells)
    )
    return Drawing(len(black[0]) * cell_m, len(black) * cell_m, runs)


def _runs(cells: Sequence[bool]) -> Iterator[tuple[int, int]]:
    column = 0
    for is_black, group in groupby(cells):
        end = column + len(list(group))
        if is_black:
            yield column, end
        column = end


def _moved(shape: Shape, x_m: float, y_m: float) -> Shape:
    if isinstance(shape, Line):
        return shape._replace(
            x1_m=shape.x1_m + x_m, y1_m=shape.y1_m + y_m, x2_m=shape.x2_m + x_m, y2_m=shape.y2_m + y_m
        )
    return shape._replace(x_m=shape.x_m + x_m, y_m=shape.y_m + y_m)
