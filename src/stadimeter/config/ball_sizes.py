"""Balls that have a name, such as ``tennis ball``, and the diameter of a ball as people write it."""

from __future__ import annotations

import difflib
import re
from typing import Annotated

from pydantic import BeforeValidator, WithJsonSchema

from stadimeter.config.units import parse_length

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

_ALSO = {"ping pong ball": "table tennis ball", "soccer ball": "football", "billiard ball": "pool ball"}
_BY_KEY = {name: name for name in BALLS} | _ALSO


def parse_ball_diameter(text: object) -> float:
    """Read a diameter such as ``"6.4 cm"`` or ``"tennis ball"`` and return it in metres.

    Raises:
        ValueError: It is neither a length above zero nor the name of a ball.
    """
    if not isinstance(text, str) or not re.match(r"\s*[a-zA-Z]", text):
        return parse_length(text)
    key = re.sub(r"[\s_-]+", " ", text).strip().casefold()
    if key in _BY_KEY:
        return parse_length(BALLS[_BY_KEY[key]])
    close = difflib.get_close_matches(key, _BY_KEY, n=1)
    guess = f"; did you mean {_BY_KEY[close[0]]!r}?" if close else "."
    raise ValueError(f"{text!r} is neither a length such as '6.4 cm' nor a ball with a name{guess} {_list_names()}")


def _list_names() -> str:
    return f"Known names: {', '.join(BALLS)}"


# A length, or the name of a ball, as `BALLS` has it.
BallDiameter = Annotated[
    float,
    BeforeValidator(parse_ball_diameter),
    WithJsonSchema({"type": "string", "examples": ["6.4 cm", *BALLS], "title": "Diameter of a ball", "x-unit": "m"}),
]
