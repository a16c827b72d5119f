"""The characters that the views draw with, and what stands for them where a terminal knows only ASCII."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the plain view starts sooner without rich
    from rich.text import Text

_ASCII_WORDS = str.maketrans(
    {
        "±": "+/-", "°": " deg", "…": "...", "²": "2", "—": "-", "–": "-", "→": "->", "≥": ">=", "≤": "<=", "·": "-",
        "σ": "sigma", "µ": "u", "×": "x",
    }
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Glyphs:
    """One set of characters, each one column wide; `dots` are those of the states in `RuleStatus`, in its order."""

    ascii_only: bool = False
    line: str = "─"
    bar: str = "━"
    bar_rest: str = "─"
    left_end: str = "├"
    right_end: str = "┤"
    middle: str = "┼"
    mark: str = "●"
    beyond_left: str = "◀"
    beyond_right: str = "▶"
    forwards: str = "▲"
    backwards: str = "▼"
    standing: str = "■"
    turns_left: str = "↺"
    turns_right: str = "↻"
    axis: str = "│"
    tick: str = "┤"
    corner: str = "└"
    dots: str = "○◔●◑■◇?"

    def words(self, text: str) -> str:
        """Return a text as it can be shown: one line, no control characters, ASCII if it must be."""
        shown = "".join(character if character.isprintable() else " " for character in text)
        if not self.ascii_only:
            return shown
        return shown.translate(_ASCII_WORDS).encode("ascii", "replace").decode("ascii")

    def fit(self, text: Text, width: int) -> Text:
        """Return a line cut or filled to a width in columns."""
        text.truncate(width, overflow="crop" if self.ascii_only else "ellipsis", pad=True)
        return text


UNICODE = Glyphs()
ASCII = Glyphs(
    ascii_only=True, line="-", bar="=", bar_rest=".", left_end="[", right_end="]", middle="|", mark="o",
    beyond_left="<", beyond_right=">", forwards="^", backwards="v", standing="#", turns_left="<", turns_right=">",
    axis="|", tick="+", corner="+", dots=".o*o#!?",
)  # fmt: skip


def heading(name: str, width: int, glyphs: Glyphs, *details: tuple[str, str]) -> Text:
    """Return a line across the screen with a name in it, and details behind it, each with its style."""
    from rich.text import Text  # noqa: PLC0415 - the plain view starts sooner without rich

    line = Text.assemble((f"{glyphs.line} ", "dim"), (glyphs.words(name), "bold"), " ")
    for words, style in details:
        line.append(glyphs.words(words), style).append(" ")
    line.append(glyphs.line * max(0, width - line.cell_len), "dim")
    return glyphs.fit(line, width)
