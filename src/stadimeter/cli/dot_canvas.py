"""A picture made of the dots of braille characters, two by four in a cell; in ASCII, of one character a cell."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from rich.text import Text

BRAILLE_BLANK = 0x2800
BRAILLE_BITS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
"""The bit of each dot, by column and row in the cell, as Unicode numbers them (chapter 21.1, Braille)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Layer:
    """One kind of thing that is drawn.

    Attributes:
        style: The colour of cells where this layer is on top.
        character: What stands for it in ASCII.
    """

    style: str
    character: str


class DotCanvas:
    """Dots in cells. A cell has the colour of the topmost layer in it.

    Args:
        width: Its columns of cells.
        height: Its rows of cells.
        layers: What will be drawn, lowest first.
        ascii_only: Whether a cell holds one dot, shown as the character of the layer.
    """

    def __init__(self, width: int, height: int, layers: Iterable[Layer], *, ascii_only: bool = False) -> None:
        self._layers = tuple(layers)
        self._ascii_only = ascii_only
        self._dots_across, self._dots_down = (1, 1) if ascii_only else (2, 4)
        self._width, self._height = width, height
        self._bits = [[0] * width for _ in range(height)]
        self._top = [[-1] * width for _ in range(height)]

    @property
    def width_dots(self) -> int:
        """How many dots are side by side."""
        return self._width * self._dots_across

    @property
    def height_dots(self) -> int:
        """How many dots are one above the other."""
        return self._height * self._dots_down

    def dots_of_row(self, position: float) -> int:
        """Return the row of dots that is nearest to a place between rows of cells.

        Args:
            position: 0 is the middle of the top row of cells, 1 that of the next, and so on.

        Returns:
            The row of dots, from the top, at most one outside of the canvas.
        """
        row = round(position * self._dots_down + (self._dots_down - 1) / 2)
        return min(max(row, -1), self.height_dots)

    def dot(self, x: int, y: int, layer: Layer) -> None:
        """Set a dot; outside the canvas it does nothing.

        Args:
            x: Column of dots, from the left.
            y: Row of dots, from the top.
            layer: One of the canvas's layers.
        """
        if not (0 <= x < self.width_dots and 0 <= y < self.height_dots):
            return
        column, row = x // self._dots_across, y // self._dots_down
        self._bits[row][column] |= BRAILLE_BITS[x % self._dots_across][y % self._dots_down]
        self._top[row][column] = max(self._top[row][column], self._layers.index(layer))

    def rows(self) -> list[Text]:
        """Return the picture, one text for each row of cells."""
        return [
            Text.assemble(*(self._cell(bits, top) for bits, top in zip(bits_row, top_row, strict=True)))
            for bits_row, top_row in zip(self._bits, self._top, strict=True)
        ]

    def _cell(self, bits: int, top: int) -> tuple[str, str]:
        if top < 0:
            return " ", ""  # not the blank of braille: some fonts draw circles for it
        layer = self._layers[top]
        return (layer.character if self._ascii_only else chr(BRAILLE_BLANK + bits)), layer.style
