"""Drawings as SVG."""

from __future__ import annotations

from xml.sax.saxutils import escape

from stadimeter.core.drawing import WHITE, Circle, Drawing, Line, Rectangle, Shape

PER_M = 1000.0
"""A unit of the picture is a millimetre."""

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
