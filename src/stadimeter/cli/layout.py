"""Lines of text for a terminal: cut, filled, hung beside a label, and headings."""

from __future__ import annotations

import io

from rich.console import Console
from rich.text import Text

# Rich wants one for wrapping, and does not look at it.
_CONSOLE = Console(file=io.StringIO(), width=80)


def hang(label: Text, words: Text, width: int) -> list[Text]:
    """Return a label and the words beside it, on as many lines as they take; each begins below the first."""
    first, *more = words.wrap(_CONSOLE, max(1, width - label.cell_len)) or [Text()]
    return [Text.assemble(label, first), *(Text(" " * label.cell_len).append_text(line) for line in more)]


def fit(text: Text, width: int) -> Text:
    """Return a line cut or filled to a width in columns."""
    text.truncate(width, overflow="ellipsis", pad=True)
    return text


def heading(name: str, width: int, *details: tuple[str, str]) -> Text:
    """Return a line across the screen with a name in it, and details behind it, each with its style."""
    line = Text.assemble(("─ ", "dim"), (name, "bold"), " ")
    for words, style in details:
        line.append(words, style).append(" ")
    line.append("─" * max(0, width - line.cell_len), "dim")
    return fit(line, width)
