"""What shall happen: the wishes of ``wishes.toml``, and how their blanks are filled."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stadimeter.config.units import DURATIONS_S, LENGTHS_M, SPEEDS_MPS, parse_length, parse_quantity

# Ready distances are within this share of how far away the target is found reliably: hysteresis needs the rest.
WITHIN_REACH = 0.8

_UNITS = {"m": LENGTHS_M, "s": DURATIONS_S, "m/s": SPEEDS_MPS}

_BLANK = re.compile(r"\{(\w+)(?::([\d.]+)(/s)?)?\}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Blank:
    """A figure that a wish leaves open; its units are those of the ready answer.

    Attributes:
        beyond: The blank before it that it must be above; empty if it may be anything.
        within: The blank before it that it must be below.
    """

    key: str
    text: str
    ready: str
    beyond: str = ""
    within: str = ""

    @property
    def is_length(self) -> bool:
        """Whether it is a distance."""
        return _si_unit(self.ready) == "m"


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """Something that people want to happen; ``wishes.toml`` says what its parts mean."""

    key: str
    title: str
    sentence: str
    blanks: tuple[Blank, ...]
    output: str
    rules: str
    targets: tuple[str, ...] = ()


def _wish(key: str, table: dict[str, Any]) -> Wish:
    blanks = tuple(Blank(key=name, **blank) for name, blank in table.pop("blanks").items())
    return Wish(key=key, blanks=blanks, targets=tuple(table.pop("targets", ())), **table)


_FILE = Path(__file__).with_name("wishes.toml")

WISHES = tuple(_wish(key, table) for key, table in tomllib.loads(_FILE.read_text(encoding="utf-8")).items())


def fill_blanks(template: str, answers: Mapping[str, str]) -> str:
    """Return a template with an answer in place of each blank."""

    def answer(blank: re.Match[str]) -> str:
        text = " ".join(answers[blank[1]].split())
        if not blank[2]:
            return text
        unit = _si_unit(text)
        return f"{float(blank[2]) * parse_quantity(text, _UNITS[unit], ''):.4g} {unit}{blank[3] or ''}"

    return _BLANK.sub(answer, template)


def figure_si(text: str, blank: Blank) -> float:
    """Return a figure in SI units; a ValueError unless it is above zero, in units such as those of the ready answer."""
    value = parse_quantity(text, _UNITS[_si_unit(blank.ready)], blank.ready)
    if value <= 0:
        raise ValueError(f"{text!r} is not above zero; write it such as {blank.ready!r}")
    return value


def ready_answers(wish: Wish, seen_up_to_m: float) -> dict[str, str]:
    """Return the ready answers to the blanks, nearer where the camera would not see that far."""
    lengths = [parse_length(blank.ready) for blank in wish.blanks if blank.is_length]
    nearer = min(1.0, WITHIN_REACH * seen_up_to_m / max(lengths, default=1.0))
    return {
        blank.key: f"{nearer * parse_length(blank.ready):.2g} m" if nearer < 1 and blank.is_length else blank.ready
        for blank in wish.blanks
    }


def _si_unit(figure: str) -> str:
    unit = figure.lstrip("+-.,0123456789eE ")  # no unit begins with an e
    return next(si for si, units in _UNITS.items() if unit in units)
