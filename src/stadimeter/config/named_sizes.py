"""Sheets and balls that have a name, such as ``A4`` or ``tennis ball``, as people write them for a size."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from typing import Annotated

from pydantic import BeforeValidator, WithJsonSchema

from stadimeter.config.units import parse_length

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

# The middle of what each sport's rules allow, which is about a hundredth of it to either side. A measured diameter is
# better: an old tennis ball may be 64 mm.
BALLS = {
    "table tennis ball": "40 mm",
    "golf ball": "42.7 mm",
    "pool ball": "57.2 mm",
    "tennis ball": "67 mm",
    "cricket ball": "72 mm",
    "baseball": "74 mm",
    "softball": "97 mm",
    "handball": "18.8 cm",
    "volleyball": "21 cm",
    "football": "22 cm",
    "basketball": "24.3 cm",
}

# What a person writes for a size that is not known, in lower case.
UNKNOWN_SIZE = frozenset({"unknown", "?", "i don't know", "don't know"})

# Other names of the same things.
_PAPER_ALIASES = {"us letter": "letter", "us legal": "legal", "bank card": "credit card"}
_BALL_ALIASES = {"ping pong ball": "table tennis ball", "soccer ball": "football", "billiard ball": "pool ball"}


def paper_sides(text: object) -> tuple[str, str]:
    """Return width and height of a sheet by its name, in any case; a ValueError for another one has all names."""
    return PAPER[_parse_paper(text)]


def parse_ball_diameter(text: object) -> float:
    """Read a diameter such as ``"6.4 cm"`` or ``"tennis ball"`` and return it in metres.

    Raises:
        ValueError: It is neither a length above zero nor the name of a ball.
    """
    if isinstance(text, str) and re.match(r"\s*[a-zA-Z]", text):
        text = BALLS[_find_name(text, BALLS, _BALL_ALIASES, "neither a length such as '6.4 cm' nor a ball with a name")]
    return parse_length(text)


def _parse_paper(text: object) -> str:
    return _find_name(text, PAPER, _PAPER_ALIASES, "no sheet with a name")


def _find_name(text: object, names: Mapping[str, object], aliases: dict[str, str], trouble: str) -> str:
    """Return one of the names, in whatever case and with whatever between its words it was written."""
    by_key = {name.casefold(): name for name in names} | aliases
    key = re.sub(r"[\s_-]+", " ", text).strip().casefold() if isinstance(text, str) else ""
    if key in by_key:
        return by_key[key]
    close = difflib.get_close_matches(key, by_key, n=1)
    guess = f"; did you mean {by_key[close[0]]!r}?" if close else "."
    raise ValueError(f"{text!r} is {trouble}{guess} Known names: {', '.join(names)}")


# The name of a sheet, as `PAPER` has it.
Paper = Annotated[
    str, BeforeValidator(_parse_paper), WithJsonSchema({"type": "string", "examples": [*PAPER], "title": "Paper"})
]

# A length, or the name of a ball, as `BALLS` has it.
BallDiameter = Annotated[
    float,
    BeforeValidator(parse_ball_diameter),
    WithJsonSchema({"type": "string", "examples": ["6.4 cm", *BALLS], "title": "Diameter of a ball", "x-unit": "m"}),
]
