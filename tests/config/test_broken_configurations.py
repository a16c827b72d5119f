"""Whatever is wrong in a configuration, and however much, it is told as problems with places: never as a crash."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.config.describe import describe
from stadimeter.config.loader import load_configuration
from stadimeter.config.schema import configuration_schema
from stadimeter.config.toml_source import as_toml
from stadimeter.errors import ConfigError, Problem

FOLDERS = (Path(__file__).parents[2] / "config", Path(__file__).parent / "analysis")
FILES = [file for folder in FOLDERS for file in sorted(folder.glob("*.toml"))]
SOUND = {file.name: tomllib.loads(file.read_text(encoding="utf-8")) for file in FILES}
GONE = object()
JUNK = [
    GONE, 0, -1, 1, 2.5, 10**30, True, False, "", "x", "ball", "near", "base", "none", "safety", "1 m", "0 m", "-1 m",
    "5 s", "0 s", "9 h", "22:00", [], {}, [1, 2], ["1 m", "2 m"], ["2 m", "1 m"], ["ball", "tag"], [{}], {"x": 1},
    {"below": "1 m"},
    {"rule": "near"}, {"all": []}, {"all": [{"seen": True}]}, {"not": {"lost": True}}, {"of": ["ball", "ball"]},
    {"frames": 3, "of": 5}, {"above": "2 m", "below": "1 m"}, {"policy": "assert"},
]  # fmt: skip


def paths(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if path:
        yield path
    if isinstance(value, dict | list):
        for key in value if isinstance(value, dict) else range(len(value)):
            yield from paths(value[key], (*path, key))


@st.composite
def broken(draw: st.DrawFn) -> dict[str, Any]:
    table = copy.deepcopy(SOUND[draw(st.sampled_from(sorted(SOUND)))])
    for _ in range(draw(st.integers(1, 4))):
        every = list(paths(table))
        if not every:
            break
        *way, last = draw(st.sampled_from(every))
        holder = table
        for key in way:
            holder = holder[key]
        junk = draw(st.sampled_from(JUNK))
        if junk is GONE:
            del holder[last]
        else:
            holder[last] = copy.deepcopy(junk)
    return table


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("broken") / "broken.toml"


@pytest.fixture(scope="module")
def schema() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(configuration_schema())


def problems_in(file: Path) -> tuple[Problem, ...]:
    try:
        loaded = load_configuration(file)
    except ConfigError as error:
        return error.problems
    assert describe(loaded)
    assert all(warning.code for warning in feasibility_warnings(loaded))
    return ()


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(table=broken())
def test_what_is_broken_is_told_and_what_is_not_fits_the_schema(
    file: Path, schema: jsonschema.Draft202012Validator, table: dict[str, Any]
) -> None:
    file.write_text("".join(f"{as_toml(key)} = {as_toml(value)}\n" for key, value in table.items()), encoding="utf-8")
    problems = problems_in(file)
    assert all(problem.message and problem.code and problem.file for problem in problems)
    if not problems:
        assert [error.message for error in schema.iter_errors(table)] == []
