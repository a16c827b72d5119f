"""Texts with gaps that are filled when something happens: ``{rule}: {distance_m:.2f} m``.

A gap holds the name of a field, and after a colon how it is written, as Python's format strings have it. Nothing else
is looked up, called or computed: a template comes from a configuration, and what fills it may come from anybody.
"""

from __future__ import annotations

import json
import math
import re
import string
from collections.abc import Collection, Iterator, Mapping
from functools import lru_cache

from stadimeter.core.decision import Notice
from stadimeter.core.measurement import Track
from stadimeter.core.rule import Rule, Template
from stadimeter.core.words import FOOT_M

Value = str | float | bool | None

# What a number that is not known is in a text. In JSON it is null.
UNKNOWN = "unknown"

# No template is longer than this.
MAX_TEXT_CHARACTERS = 4000

INCH_M = 0.0254

TEXT_FIELDS = ("rule", "target", "event", "severity", "reason", "by", "group", "time", "time_of_day", "clip")

# The figures of a track: how many decimals each has in a text that does not say, which figure it is, and its unit.
_FIGURES = {
    "distance_m": (2, "distance_m", 1), "distance_cm": (0, "distance_m", 100), "distance_mm": (0, "distance_m", 1000),
    "distance_ft": (1, "distance_m", 1 / FOOT_M), "distance_in": (1, "distance_m", 1 / INCH_M),
    "sigma_m": (3, "sigma_m", 1), "sigma_cm": (1, "sigma_m", 100), "depth_m": (2, "depth_m", 1),
    "closing_mps": (2, "closing_mps", 1), "closing_kmh": (1, "closing_mps", 3.6),
    "closing_mph": (1, "closing_mps", 3600 / (5280 * FOOT_M)),
    "bearing_deg": (0, "bearing_rad", 180 / math.pi), "elevation_deg": (0, "elevation_rad", 180 / math.pi),
}  # fmt: skip

_COUNTS = ("sequence", "count")
NUMBER_FIELDS = {name: decimals for name, (decimals, _, _) in _FIGURES.items()} | dict.fromkeys(_COUNTS, 0)

# Every field that a template may name.
FLAG_FIELDS = ("first_out",)
_NOT_NUMBERS = frozenset((*TEXT_FIELDS, *FLAG_FIELDS))
FIELDS = (*TEXT_FIELDS, *NUMBER_FIELDS, *FLAG_FIELDS)

# A number that stands alone in JSON is rounded to this.
JSON_DECIMALS = 3

# Widths and precisions of two digits: a template must not fill the memory.
_NUMBER_FORM = re.compile(r"[<>^=]?[+\- ]?0?\d{0,2},?(\.\d{1,2})?[feg]?")
_FIGURE = re.compile(r"[A-Za-z0-9_-]+")
_TEXT_FORM = re.compile(r"[<>^]?\d{0,2}(\.\d{1,3})?s?")
_JSON = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False, allow_nan=False)


class TemplateError(ValueError):
    """A template cannot be used.

    Attributes:
        field: The name of the field that there is not; empty for other troubles.
    """

    def __init__(self, message: str, field: str = "") -> None:
        self.field = field
        super().__init__(message)


def check(template: Template, figures: Collection[str] = ()) -> None:
    """Make sure that a template can be filled, whatever happens.

    Args:
        figures: The names of remembered figures: each is a field, too.

    Raises:
        TemplateError: It cannot; the message says what is wrong.
    """
    if len(template.text) > MAX_TEXT_CHARACTERS:
        raise TemplateError(f"the template has {len(template.text)} characters, and may have {MAX_TEXT_CHARACTERS}")
    for text in _texts_in(json.loads(template.text)) if template.is_json else (template.text,):
        for _, name, _ in _parts(text):
            if name and name not in FIELDS and name not in figures:
                raise _no_field(name)


def render(template: Template, values: Mapping[str, Value]) -> str:
    """Fill a template.

    Args:
        template: A template that `check` has accepted.
        values: Every one of `FIELDS`. A number that is None or not finite is not known.

    Returns:
        The text, or JSON on one line.
    """
    if template.is_json:
        return _JSON.encode(_filled(json.loads(template.text), values))
    return _text(template.text, values)


def fields(rule: Rule, notice: Notice, track: Track | None, time: str, group: str = "") -> dict[str, Value]:
    """Return the values that a template may tell of an event; the name of its clip is for others to fill in.

    Args:
        track: The rule's target now; only figures that may be acted on are filled in.
        time: The local time, as RFC 3339 has it.

    Returns:
        A value for each of `FIELDS`.
    """
    event = notice.event
    inputs = track if track is not None and track.is_valid else Track(target=rule.target)
    return {
        "rule": rule.name,
        "target": rule.target,
        "event": event.kind.value,
        "severity": event.severity.value,
        "reason": event.reason,
        "by": event.by,
        "group": group,
        "time": time,
        "time_of_day": time[11:19],
        "clip": None,
        "sequence": event.sequence,
        "count": notice.count,
        "first_out": event.first_out,
        **{name: _convert(getattr(inputs, figure), factor) for name, (_, figure, factor) in _FIGURES.items()},
    }


def _convert(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


@lru_cache(maxsize=256)
def _parts(text: str) -> tuple[tuple[str, str, str], ...]:
    """Split a text into its parts: what stands as it is, then a field, then how it is written."""
    try:
        parsed = list(string.Formatter().parse(text))
    except ValueError as error:
        raise TemplateError(
            f"{_short(text)}: {error}; write {{{{ and }}}} for braces that stand in the text"
        ) from error
    return tuple(_part(*part) for part in parsed)


def _part(literal: str, field: str | None, form: str | None, conversion: str | None) -> tuple[str, str, str]:
    if field is None:
        return literal, "", ""
    if conversion is not None:
        raise TemplateError(f"{{{field}!{conversion}}}: a gap cannot convert; write {{{field}}}")
    if field not in FIELDS and not _FIGURE.fullmatch(field):
        raise _no_field(field)
    pattern = _TEXT_FORM if field in _NOT_NUMBERS else _NUMBER_FORM
    if not pattern.fullmatch(form or ""):
        example = f"{{{field}:.1f}}" if field not in _NOT_NUMBERS else f"{{{field}:>20}}"
        raise TemplateError(
            f"{{{_short(f'{field}:{form}')}}}: a field cannot be written so; write it such as {example}"
        )
    return literal, field, form or ""


def _no_field(field: str) -> TemplateError:
    name = re.split(r"[.\[]", field, maxsplit=1)[0]
    if name in FIELDS:
        return TemplateError(f"{{{_short(field)}}}: a gap holds the name of a field and nothing else; write {{{name}}}")
    if not field:
        return TemplateError("the gap {} names no field; write {{}} for braces that stand in the text")
    return TemplateError(f"there is no field '{_short(field)}' that a template can tell", field)


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:40]}…"


def _text(text: str, values: Mapping[str, Value]) -> str:
    return "".join(
        literal + (_written(values.get(field), field, form) if field else "") for literal, field, form in _parts(text)
    )


def _written(value: Value, field: str, form: str) -> str:
    if field not in _NOT_NUMBERS:
        if not isinstance(value, int | float) or not math.isfinite(value):
            return UNKNOWN
        return format(float(value), form or f"z.{NUMBER_FIELDS.get(field, 2)}f")
    if isinstance(value, bool):
        value = "yes" if value else "no"
    return format(UNKNOWN if value is None else str(value), form)


def _filled(value: object, values: Mapping[str, Value]) -> object:
    """Fill the gaps in the strings of a structure."""
    if isinstance(value, dict):
        return {key: _filled(inner, values) for key, inner in value.items()}
    if isinstance(value, list):
        return [_filled(inner, values) for inner in value]
    if not isinstance(value, str):
        return value
    parts = _parts(value)
    if len(parts) == 1 and parts[0][1] and not parts[0][0]:
        return _alone(values.get(parts[0][1]), *parts[0][1:])
    return _text(value, values)


def _alone(value: Value, field: str, form: str) -> Value:
    """Return a field that is all of a string: a number stays a number, as precise as the gap says."""
    if field in _NOT_NUMBERS:
        return _written(value, field, form) if isinstance(value, str) else value
    if not isinstance(value, int | float) or not math.isfinite(value):
        return None
    if not form:
        return round(float(value), JSON_DECIMALS) + 0.0 if field not in _COUNTS else value
    written = format(float(value), form)
    try:
        return float(written)
    except ValueError:
        return written


def _texts_in(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for inner in value.values():
            yield from _texts_in(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _texts_in(inner)
