"""The example of a robot with each of the bases that it has ready behind ``#``."""

from __future__ import annotations

import re
from pathlib import Path

FOLLOW_BALL = (Path(__file__).parents[2] / "config" / "follow-ball.toml").read_text(encoding="utf-8")
_USED = re.findall(r'^driver = "gpio-motors"\n(?:.+\n)+', FOLLOW_BALL, re.MULTILINE)[0]
_OTHERS = re.findall(r'^(?=#driver = "([\w-]+)")((?:#\w.*\n)+)', FOLLOW_BALL, re.MULTILINE)

READY = {"gpio-motors": _USED} | {name: re.sub("^#", "", lines, flags=re.MULTILINE) for name, lines in _OTHERS}
"""The lines of each base, by its name; the first is used."""


def follow_ball(base: str) -> str:
    """Return the example with this base."""
    return FOLLOW_BALL.replace(_USED, READY[base])
