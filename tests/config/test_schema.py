"""The JSON Schema that editors complete from says the same as the program that reads a configuration."""

from __future__ import annotations

import copy
import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from stadimeter.config import plugins
from stadimeter.config.plugins import DriverOptions
from stadimeter.config.schema import configuration_schema
from stadimeter.errors import DriverUnavailableError

ROOT = Path(__file__).parents[2]
SHIPPED = sorted((ROOT / "config").glob("*.toml"))
SOUND = [*SHIPPED, *sorted((Path(__file__).parent / "analysis").glob("*.good.toml"))]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "deploy").glob("*.md"))]
FENCE = re.compile(r"(?<!<!-- answers -->\n)^```toml\n(.*?)^```", re.MULTILINE | re.DOTALL)
HEAD = """\
[camera]
driver = "simulated"
[targets.ball]
detector = "ideal"
"""

Validator = jsonschema.Draft202012Validator


@pytest.fixture(scope="module")
def schema() -> dict[str, Any]:
    return configuration_schema()


def complaints(schema: dict[str, Any], table: dict[str, Any]) -> list[str]:
    return [error.message for error in Validator(schema).iter_errors(table)]


@pytest.mark.long
def test_it_is_a_schema_of_draft_2020_12(schema: dict[str, Any]) -> None:
    Validator.check_schema(schema)
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert json.loads(json.dumps(schema, allow_nan=False)) == schema


@pytest.mark.long
def test_what_the_program_accepts_it_accepts(schema: dict[str, Any]) -> None:
    texts = {file.name: file.read_text(encoding="utf-8") for file in SOUND}
    assert refused(schema, texts) == {}


def refused(schema: dict[str, Any], texts: dict[str, str]) -> dict[str, list[str]]:
    found = {name: complaints(schema, tomllib.loads(text)) for name, text in texts.items()}
    return {name: said for name, said in found.items() if said}


def test_what_the_documentation_shows_it_accepts(schema: dict[str, Any]) -> None:
    texts = {
        f"{page.name}-{number}": text
        for page in PAGES
        for number, text in enumerate(FENCE.findall(page.read_text(encoding="utf-8")))
        if not any(word in text for word in ("entry-points", "kernel-led", "wish = "))
    }
    assert texts
    assert refused({key: value for key, value in schema.items() if key != "required"}, texts) == {}


def tables(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if isinstance(value, dict):
        yield path
    for key, entry in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from tables(entry, (*path, key))


@pytest.mark.long
def test_a_misspelt_key_is_told_in_whatever_table_it_stands(schema: dict[str, Any]) -> None:
    for file in SHIPPED:
        sound = tomllib.loads(file.read_text(encoding="utf-8"))
        for path in tables(sound):
            broken = copy.deepcopy(sound)
            holder = broken
            for key in path:
                holder = holder[key]
            holder["misspelt"] = 1
            assert complaints(schema, broken), (file.name, path)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('[actuators.b]\ndriver = "buzzer"\npin = 3\nminimum_duty = 0.5', "'minimum_duty' was unexpected"),
        ('[actuators.b]\ndriver = "buzer"', "'buzer' is not one of"),
        ('[actuators."a b"]\ndriver = "simulated"', "'a b' does not match"),
        ('[rules.near]\nwhen = { below = "1 furlong" }', "'1 furlong' does not match"),
        ("[rules.near]\nwhen = { seen = false }", "True was expected"),
        ('[rules.near]\nwhen = { all = [{ any = [{ not = { belwo = "1 m" } }] }] }', "'belwo' was unexpected"),
        ('[rules.near]\nfollow = { distance = "1 m" }\nramp = { from = "1 m", to = "2 m" }', "each of"),
        ('[rules.near]\nactuator = "motor"', "'when' is a required property"),
        ('[rules.near]\nwhen = { time = { between = ["22:00"] } }', "is too short"),
        ('[world]\npath = [{ at = "0 s", x = "2 m", y = "0 m", zz = "1 m" }]', "'zz' was unexpected"),
        ('[camera.model]\nwidth_px = 640\nfy = 1', "is not valid under any of the given schemas"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_by_the_driver_and_the_key(schema: dict[str, Any], text: str, complaint: str) -> None:
    head = HEAD.replace("[targets", f"{text}\n[targets") if text.startswith("[camera.") else f"{HEAD}{text}\n"
    found = list(Validator(schema).iter_errors(tomllib.loads(head)))
    inner = [each.message for error in found for each in (error, *leaf_errors(error))]
    assert any(complaint in message for message in inner), inner


def leaf_errors(error: Any) -> Iterator[Any]:
    for inner in error.context or ():
        yield inner
        yield from leaf_errors(inner)


@pytest.mark.long
def test_a_driver_whose_library_is_missing_may_have_any_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    load = plugins.load_driver

    def without_buzzer(group: str, name: str) -> type[DriverOptions]:
        if name == "buzzer":
            raise DriverUnavailableError("no library")
        return load(group, name)

    monkeypatch.setattr(plugins, "load_driver", without_buzzer)
    schema = configuration_schema()
    assert complaints(schema, tomllib.loads(f'{HEAD}[actuators.b]\ndriver = "buzzer"\nwhatever = 1\n')) == []
    assert complaints(schema, tomllib.loads(f'{HEAD}[actuators.b]\ndriver = "led"\nwhatever = 1\n'))
