"""The characters that the views draw with, and what stands for them where a terminal knows only ASCII."""

from __future__ import annotations

import codecs
import io
import unicodedata
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the plain view starts sooner without rich
    from rich.console import Console
    from rich.text import Text

# What stands for a character where a terminal or file cannot take it.
PLAIN = {
    "±": "+-", "°": " deg", "…": "...", "²": "2", "³": "3", "—": "-", "–": "-", "−": "-", "·": "-", "•": "*", "→": "->",
    "←": "<-", "≥": ">=", "≤": "<=", "≈": "~", "×": "x", "÷": "/", "σ": "sigma", "µ": "u", "μ": "u", "π": "pi",
    "ω": "omega", "Ω": "ohm",
    "\N{LEFT SINGLE QUOTATION MARK}": "'", "\N{RIGHT SINGLE QUOTATION MARK}": "'", "“": '"', "”": '"', "„": '"',
    "━": "=", "│": "|", "┃": "|", "█": "#", "▀": "#", "▄": "#", "✓": "ok", "✗": "x",
    "\N{NO-BREAK SPACE}": " ", "\N{NARROW NO-BREAK SPACE}": " ",
}  # fmt: skip

# The name of the error handler for encodings that puts `plain` in place of what an encoding lacks.
PLAIN_ERRORS = "stadimeter.plain"


def plain(character: str) -> str:
    """Return what stands for a character in ASCII; its number for a letter, which may be part of a file's name."""
    if character.isascii():
        return character
    if character in PLAIN:
        return PLAIN[character]
    if "BOX DRAWINGS" in (name := unicodedata.name(character, "")):
        return "-" if name.endswith("HORIZONTAL") and "AND" not in name else "+"
    return character.encode("ascii", "backslashreplace").decode("ascii")


def _write_plain(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(plain, error.object[error.start : error.end])), error.end


def _plain_codec(name: str) -> codecs.CodecInfo | None:
    if name != _PLAIN_ASCII:
        return None
    ascii_codec = codecs.lookup("ascii")
    return codecs.CodecInfo(
        *ascii_codec,
        incrementalencoder=ascii_codec.incrementalencoder,
        incrementaldecoder=ascii_codec.incrementaldecoder,
        name=name,
    )


# ASCII under a name of its own. Typer takes a stream of the other name for a mistake, and writes UTF-8 to it.
_PLAIN_ASCII = "plain_ascii"

codecs.register_error(PLAIN_ERRORS, _write_plain)
codecs.register(_plain_codec)


def write_plainly(stream: io.TextIOWrapper) -> None:
    """Have a stream take every text: with plain characters in place of those that its encoding lacks."""
    is_ascii = codecs.lookup(stream.encoding).name == "ascii"
    stream.reconfigure(encoding=_PLAIN_ASCII if is_ascii else None, errors=PLAIN_ERRORS)


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
        return "".join(map(plain, shown))

    def hang(self, label: Text, words: Text, width: int) -> list[Text]:
        """Return a label and the words beside it, on as many lines as they take; each begins below the first."""
        console, text = _rich()
        first, *more = words.wrap(console, max(1, width - label.cell_len)) or [text()]
        return [text.assemble(label, first), *(text(" " * label.cell_len).append_text(line) for line in more)]

    def fit(self, text: Text, width: int) -> Text:
        """Return a line cut or filled to a width in columns."""
        text.truncate(width, overflow="crop" if self.ascii_only else "ellipsis", pad=True)
        return text


@cache
def _rich() -> tuple[Console, type[Text]]:
    """Return a console, which rich wants for wrapping and does not look at, and the class of its texts."""
    from rich import console, text  # noqa: PLC0415 - the plain view starts sooner without rich

    return console.Console(file=io.StringIO(), width=80), text.Text


UNICODE = Glyphs()
ASCII = Glyphs(
    ascii_only=True, line="-", bar="=", bar_rest=".", left_end="[", right_end="]", middle="|", mark="o",
    beyond_left="<", beyond_right=">", forwards="^", backwards="v", standing="#", turns_left="<", turns_right=">",
    axis="|", tick="+", corner="+", dots=".o*o#!?",
)  # fmt: skip


def heading(name: str, width: int, glyphs: Glyphs, *details: tuple[str, str]) -> Text:
    """Return a line across the screen with a name in it, and details behind it, each with its style."""
    _, text = _rich()
    line = text.assemble((f"{glyphs.line} ", "dim"), (glyphs.words(name), "bold"), " ")
    for words, style in details:
        line.append(glyphs.words(words), style).append(" ")
    line.append(glyphs.line * max(0, width - line.cell_len), "dim")
    return glyphs.fit(line, width)
