"""Recipes: configurations with blanks. Each is a file that says itself what is asked about its blanks.

A file of ``recipes/`` is something that shall happen, or that is so; one of ``recipes/targets/``, a kind of target. Its
first part is TOML: ``[recipe]``, see `Recipe`, and a table ``[blanks.NAME]`` for each `Blank`. Behind `HEAD_END` the
configuration follows, in which ``{near}`` stands for the answer to the blank ``near``, ``{near:3}`` for three times as
much, ``{near:1/s}`` for a speed of as much in a second, ``{near:m}`` for its number of metres, ``{times:+1}`` for one
more, and ``{at:-10}`` for ten seconds before a time of day. ``{target}`` is the target's name, ``{output}`` the
output's, and ``{drives}`` the lines that name both. A line with ``{member}`` is repeated for each of several targets.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct
from pydantic.fields import FieldInfo
from pydantic.json_schema import WithJsonSchema

from stadimeter.config.plugins import DriverOptions
from stadimeter.config.schema import documented_fields
from stadimeter.config.toml_source import as_toml, key_and_value
from stadimeter.config.units import (
    ANGLES_RAD,
    DURATIONS_S,
    LENGTHS_M,
    SPEEDS_MPS,
    PortMark,
    parse_length,
    parse_quantity,
    parse_time_of_day,
    split_quantities,
    split_spread,
)
from stadimeter.core.clock import DAY_S
from stadimeter.core.words import time_of_day
from stadimeter.errors import ConfigError
from stadimeter.workbench.setup.camera_step import table_of

# Behind this line of a file is the configuration.
HEAD_END = "\n# Configuration:\n"

# An output that only the views show; and none, where the rule reports and drives nothing.
SCREEN, NOTHING = "screen", "nothing"

# A count is of at least two, since one is what the rule that is counted does; a rule counts up to a thousand.
MIN_COUNT, MAX_COUNT = 2, 999

_UNITS = {"m": LENGTHS_M, "s": DURATIONS_S, "m/s": SPEEDS_MPS, "rad": ANGLES_RAD}
_PLACE = re.compile(r"\{(\w+)(?::([+-]?[\d.]+|m)(/s)?)?\}")


class Blank(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A part that a recipe leaves open, or an option of a driver.

    Attributes:
        ready: The answer that is taken if none is given; empty if there is none.
        form: How an answer may look, beside ``ready``.
        kind: A ``quantity``, in units like those of ``ready``; ``count``; ``number``; ``time`` of day; ``text``;
            ``toml``; or what stands for lines of a table: ``part`` (a driver and its pin), ``camera``, ``option`` of a
            driver, ``size`` (a length that may be known to ±), ``sides`` (two of them), ``tag``, ``tags``.
        above: What it must be above, with blanks; empty for zero.
        below: What it must be below, with blanks; empty for nothing.
        option: The option of the driver whose examples are names that an answer may have.
        names: These names.
        tries: Answers that are tried on the picture. The first with which the target is found is ready, and behind it
            the number that the target bears.
        files: Of an answer that names a file, what such files are called, such as ``*.onnx``.
    """

    text: str
    key: str = ""
    ready: str = ""
    form: str = ""
    kind: str = "quantity"
    above: str = ""
    below: str = ""
    option: str = ""
    names: tuple[str, ...] = ()
    tries: tuple[str, ...] = ()
    files: str = ""

    @property
    def unit(self) -> str:
        """Its SI unit: m, s, m/s or rad; empty of what is no quantity."""
        return _si_unit(self.ready) if self.kind == "quantity" else ""

    def check(self, text: str, answers: Mapping[str, str]) -> None:
        """Check a figure against its limits; a ConfigError says what is wrong with it.

        Args:
            answers: Those to the other blanks of the recipe.
        """
        such = f"write it such as {self.ready!r}"
        if self.kind in {"count", "number"}:
            low, high = (MIN_COUNT, MAX_COUNT) if self.kind == "count" else (0, MAX_COUNT)
            if not (text.isdecimal() and low <= int(text) <= high):
                raise ConfigError(f"{text!r} is no number from {low} to {high}; {such}")
        elif self.kind == "time":
            self._read(text)
        elif self.kind == "quantity":
            value = self._read(text)
            if value <= 0:
                raise ConfigError(f"{text!r} is not above zero; {such}")
            for limit, sign, words in ((self.above, 1, "more"), (self.below, -1, "less")):
                if limit and sign * value <= sign * self._read(other := fill(limit, answers)):
                    raise ConfigError(f"{text} is not {words} than {other}, as it must be")

    def _read(self, text: str) -> float:
        try:
            if self.kind == "time":
                return parse_time_of_day(text)
            return parse_quantity(text, _UNITS[self.unit], self.ready)
        except ValueError as error:
            raise ConfigError(str(error)) from error


class Recipe(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Something that people want to happen, or that is so; or a kind of target.

    Attributes:
        rank: Where it stands in the list.
        group: What it is listed below; those of one group stand together.
        picture: A drawing of it, as the path of an SVG of 80 by 60.
        output: The ready answer to what it drives; ``base`` for a robot, ``mqtt`` for messages only.
        camera: What else stands in ``[camera]``; `target` in the target's table, `lens` in the camera file.
        brings_lens: Whether a file that it names has the lens, so that the camera has no `model`.
        needs_several: Whether it is for several targets of one kind.
        driver: Of a kind of target, its detector.
        thing: Of a kind of target, one of it, for sentences; empty for the key.
        has_colour: Of a kind of target, whether a range of colours is asked for behind the blanks.
    """

    title: str
    rank: int = 1000
    key: str = ""
    group: str = ""
    picture: str = ""
    output: str = ""
    camera: str = ""
    target: str = ""
    lens: str = ""
    brings_lens: bool = False
    needs_several: bool = False
    driver: str = ""
    thing: str = ""
    has_colour: bool = False
    blanks: tuple[Blank, ...] = ()
    configuration: str = ""

    @property
    def needs_output(self) -> bool:
        """True if it is nothing without something that it drives: a level alone reports nothing."""
        return "}ramp" in self.configuration

    def texts(self, answers: Mapping[str, str]) -> dict[str, str]:
        """Return the text that stands for each of its blanks, whose answers have the keys of the blanks alone."""
        texts = {blank.key: " ".join(answers.get(blank.key, blank.ready).split()) for blank in self.blanks}
        return {blank.key: written(blank, texts[blank.key]) for blank in self.blanks}


@cache
def load_recipes(folder: str = "recipes") -> Mapping[str, Recipe]:
    """Return the recipes of a folder beside this module, by name, in the order of the list."""
    found = (read_recipe(path) for path in (Path(__file__).parent / folder).glob("*.toml"))
    return {each.key: each for each in sorted(found, key=lambda recipe: recipe.rank)}


def read_recipe(path: Path) -> Recipe:
    """Read the file of a recipe."""
    head, _, configuration = path.read_text(encoding="utf-8").partition(HEAD_END)
    table = tomllib.loads(head)
    blanks = [{"key": key, **blank} for key, blank in table.get("blanks", {}).items()]
    fields = {"key": path.stem, **table["recipe"], "blanks": blanks, "configuration": configuration.lstrip("\n")}
    return msgspec.convert(fields, Recipe)


def fill(template: str, texts: Mapping[str, str]) -> str:
    """Return a template with a text in place of each blank."""

    def text_of(place: re.Match[str]) -> str:
        name, factor, per_second = place.groups()
        text = texts[name]
        if not factor:
            return text
        if factor == "m":
            return as_toml(parse_length(text))
        if text.isdecimal():
            return f"{int(text) + int(factor)}" if factor[0] in "+-" else f"{int(text) * float(factor):g}"
        if ":" in text:
            return time_of_day((parse_time_of_day(text) + float(factor)) % DAY_S)
        unit = _si_unit(text)
        return f"{float(factor) * parse_quantity(text, _UNITS[unit], ''):.4g} {unit}{per_second or ''}"

    return _PLACE.sub(text_of, template)


def _si_unit(figure: str) -> str:
    unit = figure.lstrip("+-.,0123456789eE ")  # no unit begins with an e
    return next(si for si, units in _UNITS.items() if unit in units)


def lines(table: Mapping[str, Any]) -> str:
    """Return the lines of a table."""
    return "\n".join(f"{key} = {as_toml(value)}" for key, value in table.items())


def written(blank: Blank, text: str) -> str:
    """Return the text in a configuration for an answer."""
    if blank.kind == "option":
        return lines({blank.key: option_value(text)})
    if (table_for := _TABLES.get(blank.kind)) is not None:
        return lines(table_for(text))
    if blank.kind in {"toml", "count", "number"}:
        return text
    return as_toml(split_spread(text)[0] if blank.kind == "size" else text)[1:-1]


def _sides(text: str) -> dict[str, Any]:
    width, *height = split_quantities(split_spread(text)[0].replace(" x ", ", "))
    return {"width": width, "height": ", ".join(height)} if height else {"size": width}


def _tag(text: str) -> dict[str, Any]:
    family, _, number = text.partition(" ")
    return {"family": family, **({"id": option_value(number)} if number else {})}


def _tags(text: str) -> dict[str, Any]:
    family, *numbers = text.replace(",", " ").split()
    if numbers[:1] == ["any"]:
        return {"family": family, "count": option_value(" ".join(numbers[1:]))}
    return {"family": family, "ids": [*map(option_value, numbers)]}


def part_table(text: str) -> dict[str, Any]:
    """Return the table of a part on a pin, such as ``buzzer 23``, or of one that is simulated."""
    driver, *pin = text.split() or [""]
    if driver == SCREEN:
        return {"driver": "simulated"}
    return {"driver": driver, **({"pin": option_value(pin[0])} if pin else {})}


# What answers of these kinds stand for.
_TABLES: Mapping[str, Callable[[str], Mapping[str, Any]]] = {
    "part": part_table, "camera": table_of, "sides": _sides, "tag": _tag, "tags": _tags,
}  # fmt: skip


def option_value(text: str) -> Any:
    """Return a value as TOML would have it, such as ``1440`` or ``{ forward = 17 }``; else the text."""
    return key_and_value(f"value = {text}")[1]


def option_examples(option: FieldInfo) -> list[Any]:
    """Return the examples of a driver's option: its own, then those of its type."""
    of_type = [(mark.json_schema or {}) for mark in option.metadata if isinstance(mark, WithJsonSchema)]
    return [*(option.examples or ()), *(example for schema in of_type for example in schema.get("examples", ()))]


def driver_blanks(model: type[DriverOptions], prefix: str = "") -> Iterator[Blank]:
    """Yield a blank for each option of a driver that it needs, or has an example for, as its schema describes them."""
    words = dict(documented_fields(model))
    for name, option in model.model_fields.items():
        if not (option.is_required() or option.examples):
            continue
        is_port = any(isinstance(mark, PortMark) for mark in option.metadata)
        ports = sorted(map(str, Path("/dev/serial/by-id").glob("*"))) if is_port else []
        ready = next(iter((*ports, *(["/dev/ttyUSB0"] if is_port else ()), *option_examples(option))), "")
        ready = ready if isinstance(ready, str) and ready.isprintable() else as_toml(ready)
        form = f"such as {ready}" if ready else ""
        text = f"{name}: {words.get(name, '')}"
        yield Blank(key=f"{prefix}{name}", text=text, ready=ready, form=form, kind="option", names=tuple(ports))
