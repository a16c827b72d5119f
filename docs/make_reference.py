"""Writes the pages of the reference, ``docs/reference/*.md``, from the code: ``make reference``.

Tables come from the models that read a configuration. Each example is accepted by these models before it is written;
``reference.toml`` has those that cannot be derived from a model.
"""

from __future__ import annotations

import inspect
import itertools
import math
import re
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from reference_code import CODE_PAGES, table

from stadimeter.config.describe import describe
from stadimeter.config.driver_tables import DRIVER_KINDS
from stadimeter.config.loader import load_configuration
from stadimeter.config.schema import configuration_schema
from stadimeter.config.toml_source import as_toml
from stadimeter.config.units import validation_context
from stadimeter.core import templates
from stadimeter.errors import StadimeterError

Schema = Mapping[str, Any]
DOCS = Path(__file__).parent
PAGES = DOCS / "reference"
GIVEN = tomllib.loads((DOCS / "reference.toml").read_text(encoding="utf-8"))
COLUMNS = ("key", "what it says", "value", "example")
KINDS = {
    "m": "length", "s": "duration", "rad": "angle", "m/s": "speed", "rad/s": "turn rate", "Hz": "rate", "V": "voltage",
    "B": "bytes", "m/s2": "acceleration", "rad/s2": "turn acceleration", "m/s²": "acceleration",
}  # fmt: skip
SAME_DRIVERS = {"second_camera": "camera", "status_led": "actuators.NAME"}
LIKELIHOOD = ("probability", "probability_off", "deadband_sigmas")
SECTIONS = {
    "camera": ("camera", "second_camera"),
    "targets": ("targets",),
    "outputs": ("actuators", "base", "sensors", "buttons", "status_led"),
    "rules": ("rules",),
    "tests": ("tests",),
    "messages": ("messenger", "notifiers"),
    "more": (
        "safety", "tracking", "mounting", "web", "recording", "timeline", "black_box", "place", "landmarks", "figures",
        "world",
    ),
}  # fmt: skip


@cache
def schema() -> Schema:
    """Return the schema of a configuration."""
    return configuration_schema()


@cache
def models() -> Mapping[str, type[BaseModel]]:
    """Return the model of each table, by the name that the schema has for it."""
    schema()

    def below(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
        for each in model.__subclasses__():
            yield each
            yield from below(each)

    return {each.__name__: each for each in below(BaseModel) if each.__name__ in schema()["$defs"]}


@cache
def found_tables() -> tuple[Mapping[str, Any], ...]:
    """Return every table of the configurations of `reference.toml`, short ones first: examples are taken from them."""

    def inside(value: object) -> Iterator[Mapping[str, Any]]:
        if isinstance(value, dict):
            yield value
        parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        for part in parts:
            yield from inside(part)

    tables = [found for text in GIVEN["tables"].values() for found in inside(tomllib.loads(text))]
    return tuple(sorted(tables, key=len))


def resolve(given: Schema) -> Schema:
    """Return a schema with what it refers to."""
    if "$ref" not in given:
        return given
    found: Any = schema()
    for part in given["$ref"].removeprefix("#/").split("/"):
        found = found[part]
    return {**resolve(found), **{key: value for key, value in given.items() if key != "$ref"}}


def tables_in(given: Schema) -> Iterator[str]:
    """Yield the names of the tables that a value of this schema may hold."""
    if "$ref" in given:
        name = given["$ref"].removeprefix("#/$defs/")
        if "/" in name:
            yield from tables_in(resolve(given))
        elif name in models():
            yield name
    for part in (
        *given.get("anyOf", ()),
        *given.get("oneOf", ()),
        given.get("items"),
        given.get("additionalProperties"),
    ):
        if isinstance(part, dict):
            yield from tables_in(part)


def is_accepted(name: str, written: Mapping[str, Any]) -> bool:
    """Check whether a table's model accepts what is written."""
    try:
        models()[name].model_validate(written, context=validation_context(DOCS / "reference.toml"))
    except (ValidationError, StadimeterError):
        return False
    return True


def guesses(name: str, key: str, given: Schema) -> Iterator[Any]:
    """Yield values that a key may have, the most telling ones first."""
    if (own := GIVEN["examples"].get(f"{name}.{key}", GIVEN["examples"].get(key))) is not None:
        yield own
    known = set(resolve({"$ref": f"#/$defs/{name}"})["properties"])
    yield from (found[key] for found in found_tables() if key in found and set(found) <= known)
    whole = resolve(given)
    if "x-unit" in whole and not str(whole.get("default", "0 ")).startswith("0 "):
        yield in_degrees(whole["default"])
    yield from whole.get("examples", ())
    yield from (each for each in whole.get("enum", ()) if each != whole.get("default"))
    if whole.get("type") == "boolean":
        yield not whole.get("default", False)
    yield from (whole[each] for each in ("default", "const", "minimum") if each in whole)
    if isinstance(part := whole.get("items"), dict):
        size = max(whole.get("minItems", 1), 1)
        yield from ([each] * size for each in guesses(name, key, part))
    for part in (*whole.get("anyOf", ()), *whole.get("oneOf", ())):
        yield from guesses(name, key, part)
    yield from (inner for each in tables_in(given) if (inner := smallest(each)) is not None)
    yield from (value for word, value in GIVEN["least"].get(name, {}).items() if word == key)
    if whole.get("type") in {"integer", "number"}:
        yield from (1, 0.5)


@cache
def smallest(name: str) -> dict[str, Any] | None:
    """Return the least that a table may hold; None if it can be found nowhere."""
    given = schema()["$defs"][name]
    known, needed = given["properties"], given.get("required", ())
    made = {key: next(guesses(name, key, known[key]), None) for key in needed}

    def options() -> Iterator[Mapping[str, Any]]:
        yield GIVEN["least"].get(name, made)
        yield from (each for each in found_tables() if each.keys() <= known.keys())
        yield from ({**made, key: value} for key in known for value in guesses(name, key, known[key]))

    return next((dict(each) for each in options() if each and is_accepted(name, each)), None)


def example(name: str, key: str) -> dict[str, Any]:
    """Return a table that shows a key, and is accepted."""
    prop = schema()["$defs"][name]["properties"][key]
    for value in guesses(name, key, prop):
        around = [{}, smallest(name) or {}, *(each for each in found_tables() if key in each)]
        for each in around:
            if is_accepted(name, {**each, key: value}):
                return {**each, key: value}
    raise LookupError(f"reference.toml needs an example of {name}.{key}")


def in_degrees(value: Any) -> Any:
    """Return a quantity as people would write it: an angle that is a whole number of degrees, in degrees."""
    radians = re.fullmatch(r"([\d.]+) rad", str(value))
    degrees = math.degrees(float(radians[1])) if radians else 0.5
    return f"{degrees:.0f} deg" if abs(degrees - round(degrees)) < 1e-3 else value


def kind(given: Schema) -> str:
    """Return what kind of value it is, in a few words."""
    whole = resolve(given)
    if (parts := [*whole.get("anyOf", ()), *whole.get("oneOf", ())]) and "properties" not in whole:
        return " or ".join(dict.fromkeys(kind(each) for each in parts))
    if whole.get("x-unit") in KINDS:
        return KINDS[whole["x-unit"]]
    if "enum" in whole or "const" in whole:
        return ", ".join(f"`{as_toml(each)}`" for each in whole.get("enum", [whole.get("const")]))
    if "properties" in whole or whole.get("type") == "object":
        return "table"
    if isinstance(whole.get("items"), dict):
        return f"list: {kind(whole['items'])}"
    limits = [
        f"{sign} {whole[word]:g}"
        for word, sign in (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"), ("exclusiveMaximum", "<"))
        if isinstance(whole.get(word), int | float) and abs(whole[word]) < 1e12
    ]
    names = {"integer": "whole number", "boolean": "true or false", "string": "text", "array": "list"}
    return " ".join([names.get(str(whole.get("type")), str(whole.get("type", "text"))), *limits])


def row(name: str, key: str) -> tuple[str, str, str, str]:
    """Return the row of a key."""
    table_of = schema()["$defs"][name]
    prop = resolve(table_of["properties"][key])
    default = f"; default `{as_toml(in_degrees(prop['default']))}`" if "default" in prop else ""
    needed = "; **needed**" if key in table_of.get("required", ()) else ""
    shown = f"`{key} = {as_toml(example(name, key)[key])}`"
    words = re.sub(r",? in (?:seconds|metres|hertz)(?=[;:.,])", "", prop.get("description", ""))
    return f"`{key}`", words, kind(table_of["properties"][key]) + default + needed, shown


def words_of(name: str) -> str:
    """Return the sentences of a table's docstring, without what is for those who read the code."""
    text = re.split(r"\n\n(?=\w+:\n)", inspect.getdoc(models()[name]) or "")[0]
    rest = text.partition("\n\n")[2].replace("``", "`")
    return " ".join([str(schema()["$defs"][name].get("description", "")), *rest.split()])


def section(name: str, path: str, shown: set[str], depth: int = 3) -> Iterator[str]:
    """Yield a table of keys, and the tables inside it, each once on a page."""
    properties = schema()["$defs"][name]["properties"]
    likely = [each for each in properties if each in LIKELIHOOD]
    yield table(COLUMNS, [row(name, each) for each in properties if each not in likely])
    if likely:
        words = ", ".join(f"`{each}` (default {properties[each].get('default')})" for each in likely)
        yield f"Also {words}, as for a distance."
    for key in properties:
        yield from inner_sections(name, key, path, shown, depth)


def inner_sections(name: str, key: str, path: str, shown: set[str], depth: int = 3) -> Iterator[str]:
    """Yield the tables that may stand at a key."""
    prop = schema()["$defs"][name]["properties"][key]
    for inner in dict.fromkeys(tables_in(prop)):
        if inner not in shown:
            shown.add(inner)
            at = f"{path}.{key}"
            yield f"{'#' * depth} `{f'[[{at}]]' if 'items' in resolve(prop) else f'[{at}]'}`\n\n{words_of(inner)}"
            yield from section(inner, at, shown, depth)


def drivers_page(part: str, shown: set[str]) -> Iterator[str]:
    """Yield what belongs to a section that names drivers: keys of all, keys of several, and each driver's own."""
    sort, given = DRIVER_KINDS[part], schema()["properties"][part]
    path = f"{part}.NAME" if sort.is_named else part
    yield f"## `[{path}]`\n\n{given['description']}"
    listed = (given["additionalProperties"] if sort.is_named else given)["properties"][sort.key]["enum"]
    if sort.common.model_fields:
        yield f"Keys of every `[{path}]`:"
        yield from section(sort.common.__name__, path, shown)
    if part in SAME_DRIVERS:
        names = ", ".join(f"`{each}`" for each in listed)
        yield f"`{sort.key}` is one of {names}, each with its keys as in `[{SAME_DRIVERS[part]}]`."
        return
    own = {driver: dict(own_keys(part, driver)) for driver in listed}
    said = {driver: {key: row(model, key) for key, model in keys.items()} for driver, keys in own.items()}
    counts = Counter(each[:3] for rows in said.values() for each in rows.values())
    several = {each for each, count in counts.items() if count > 1}
    if several:
        rows = {each[:3]: each for rows in said.values() for each in rows.values() if each[:3] in several}
        of = {key: [name for name, rows in said.items() if key in {each[:3] for each in rows.values()}] for key in rows}
        drivers = {key: ", ".join(f"`{name}`" for name in of[key]) for key in rows}
        yield f"### Keys of several drivers of `[{path}]`"
        yield table((*COLUMNS, "drivers"), [(*each, drivers[key]) for key, each in rows.items()])
    for driver, keys in own.items():
        mine = {key for key in keys if said[driver][key][:3] not in several}
        yield f'### `{sort.key} = "{driver}"`\n\n{schema()["$defs"][f"{part}.{driver}"]["description"]}'
        if mine:
            yield table(COLUMNS, [said[driver][key] for key in keys if key in mine])
        for key, model in keys.items():
            yield from inner_sections(model, key, path, shown)


def own_keys(part: str, driver: str) -> Iterator[tuple[str, str]]:
    """Yield the keys of a driver that not every driver has, each with the table that it comes from."""
    for key, prop in schema()["$defs"][f"{part}.{driver}"]["properties"].items():
        match = re.fullmatch(r"#/\$defs/(\w+)/properties/.*", prop.get("$ref", ""))
        if match and match[1] != DRIVER_KINDS[part].common.__name__:
            yield key, match[1]


# Conditions -----------------------------------------------------------------------------------------------------------


def conditions_page() -> Iterator[str]:
    """Yield each condition: an example, what `stadimeter check` says of it, and the keys of its table."""
    properties = schema()["$defs"]["WhenTable"]["properties"]
    simple = [key for key in properties if GIVEN["when"][key].startswith("{ below")]
    yield "## Limits on the distance"
    yield table(COLUMNS, [row("WhenTable", key) for key in simple])
    yield from (f"    when = {GIVEN['when'][key]}\n\n{say_condition(key)}" for key in ("below", "between"))
    shown = {"WhenTable"}
    for key in [*(each for each in properties if each not in simple)]:
        yield f"## `{key}`\n\n{resolve(properties[key]).get('description', '')}"
        yield f"    when = {GIVEN['when'][key]}\n\n{say_condition(key)}"
        yield from inner_sections("WhenTable", key, "when", shown, depth=3)


def condition_file(key: str) -> str:
    """Return a whole configuration with the example of a condition."""
    return f'{GIVEN["tables"]["around"]}\n[rules.near]\ntarget = "ball"\nwhen = {GIVEN["when"][key]}\n'


def say_condition(key: str) -> str:
    """Return what `stadimeter check` says of the example of a condition."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "example.toml"
        path.write_text(condition_file(key), encoding="utf-8")
        said = next(each for each in describe(load_configuration(path)) if each.startswith("`near` "))
    return "Holds " + re.sub(r"^`near` gives the alert \(\w+\) ", "", said).partition("; clears")[0] + "."


# The pages ------------------------------------------------------------------------------------------------------------


def tables_page(parts: Iterable[str]) -> Iterator[str]:
    """Yield the tables of some sections."""
    shown = {"WhenTable"}
    for part in parts:
        if part in DRIVER_KINDS:
            yield from drivers_page(part, shown)
            if part == "camera":
                yield f"## `[camera.model]`, or a camera file\n\n{words_of('CameraModelTable')}"
                yield from section("CameraModelTable", "camera.model", shown)
            continue
        given = schema()["properties"][part]
        name = next(tables_in(given), "RuleTable")
        title = f"[[{part}]]" if "items" in given else f"[{part}.NAME]" if "propertyNames" in given else f"[{part}]"
        yield f"## `{title}`\n\n{words_of(name)}"
        yield from section(name, title.strip("[]"), shown)


def fields_section() -> Iterator[str]:
    """Yield the fields of a template."""
    yield "## Fields of a text\n\nTexts of messages and notifications hold these in braces, such as `{distance_m:.1f}`."
    yield ", ".join(f"`{each}`" for each in templates.FIELDS)


def pages() -> dict[str, str]:
    """Return the text of each page, by its name."""
    made: dict[str, Iterable[str]] = {name: tables_page(parts) for name, parts in SECTIONS.items()}
    made["messages"] = itertools.chain(made["messages"], fields_section())
    made |= {"conditions": conditions_page()} | {name: make() for name, make in CODE_PAGES.items()}
    texts = {name: "\n\n".join([f"# {about[0]}", about[1], *made[name]]) for name, about in GIVEN["pages"].items()}
    lines = ["# Reference\n\nEvery key, command and message, made from the program itself.\n"]
    for name, (title, words) in GIVEN["pages"].items():
        first, *_ = re.split(r"(?<=[\w`])[.:](?=\s|$)", " ".join(words.split()))
        lines.append(f"- [{title}]({name}.md): {first}.")
    texts["index"] = "\n".join(lines)
    return {name: f"{text}\n" for name, text in texts.items()}


if __name__ == "__main__":
    PAGES.mkdir(exist_ok=True)
    for page, text in pages().items():
        (PAGES / f"{page}.md").write_text(text, encoding="utf-8")
