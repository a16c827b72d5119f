"""A drawing at true scale, made of a few plain shapes: printed targets and wiring. Its frame is x right, y down."""

from __future__ import annotations

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


def _moved(shape: Shape, x_m: float, y_m: float) -> Shape:
    if isinstance(shape, Line):
        return shape._replace(
            x1_m=shape.x1_m + x_m, y1_m=shape.y1_m + y_m, x2_m=shape.x2_m + x_m, y2_m=shape.y2_m + y_m
        )
    return shape._replace(x_m=shape.x_m + x_m, y_m=shape.y_m + y_m)
