"""Sheets that have a name, such as ``A4`` or ``letter``, and their sides as people write them."""

from __future__ import annotations

import difflib
import re
from typing import Annotated

from pydantic import BeforeValidator, WithJsonSchema

# Width and height by name: ISO 216, ANSI/ASME Y14.1 and its relatives, and ISO/IEC 7810 ID-1.
PAPER = {
    "A1": ("594 mm", "841 mm"),
    "A2": ("420 mm", "594 mm"),
    "A3": ("297 mm", "420 mm"),
    "A4": ("210 mm", "297 mm"),
    "A5": ("148 mm", "210 mm"),
    "A6": ("105 mm", "148 mm"),
    "letter": ("8.5 in", "11 in"),
    "legal": ("8.5 in", "14 in"),
    "tabloid": ("11 in", "17 in"),
    "index card": ("5 in", "3 in"),
    "business card": ("85 mm", "55 mm"),
    "US business card": ("3.5 in", "2 in"),
    "credit card": ("85.6 mm", "53.98 mm"),
}

_ALSO = {"us letter": "letter", "us legal": "legal", "bank card": "credit card"}
_BY_KEY = {name.casefold(): name for name in PAPER} | _ALSO


def paper_sides(text: object) -> tuple[str, str]:
    """Return width and height of a sheet by its name, in any case; a ValueError for another one has all names."""
    return PAPER[_parse_paper(text)]


def _parse_paper(text: object) -> str:
    key = re.sub(r"[\s_-]+", " ", text).strip().casefold() if isinstance(text, str) else ""
    if key in _BY_KEY:
        return _BY_KEY[key]
    close = difflib.get_close_matches(key, _BY_KEY, n=1)
    guess = f"; did you mean {_BY_KEY[close[0]]!r}?" if close else "."
    raise ValueError(f"{text!r} is no sheet with a name{guess} Known names: {', '.join(PAPER)}")


# The name of a sheet, as `PAPER` has it.
Paper = Annotated[
    str, BeforeValidator(_parse_paper), WithJsonSchema({"type": "string", "examples": [*PAPER], "title": "Paper"})
]
