"""A text that nests deeper than anybody can mean is refused before it costs time or the stack."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from stadimeter.config.camera_file import load_camera_model
from stadimeter.config.loader import load_camera_choice, load_configuration
from stadimeter.config.toml_depth import DEEPEST, line_that_is_too_deep, loads
from stadimeter.errors import ConfigError

MEGABYTE = 1_000_000


def repeated(line: str) -> str:
    """Return a text of a megabyte: a line again and again, each time with another key."""
    count = MEGABYTE // len(line)
    return "\n".join(line.replace("#", str(number)) for number in range(count))


DEEP = {
    "lists": repeated("a# = " + "[" * 500 + "]" * 500),
    "tables": repeated("a# = " + "{ a = " * 500 + "1" + " }" * 500),
    "keys": repeated(".".join(["a#", *["a"] * 499]) + " = 1"),
    "headers": repeated("[" + ".".join(["a#", *["a"] * 499]) + "]"),
    "arrays of tables": repeated("[[" + ".".join(["a#", *["a"] * 499]) + "]]"),
    "not even closed": "a = " + "[" * 500,
}


@pytest.mark.parametrize("text", DEEP.values(), ids=DEEP.keys())
@pytest.mark.parametrize("load", [load_configuration, load_camera_choice, load_camera_model])
def test_a_megabyte_that_nests_five_hundred_deep_is_refused_with_its_line(tmp_path: Path, text: str, load) -> None:
    file = tmp_path / "deep.toml"
    file.write_text("# a comment\n" + text, encoding="utf-8")
    with pytest.raises(ConfigError, match="stand inside each other more than 64 deep") as caught:
        load(file)
    (problem,) = caught.value.problems
    assert (problem.file, problem.line) == (str(file), 2)


@pytest.mark.parametrize(
    "text",
    [
        "[" * DEEPEST + "]" * DEEPEST,
        "{ a = " * DEEPEST + "1" + " }" * DEEPEST,
        f'"{"[" * 500}"',
        f"'{'{' * 500}'",
        f'"""\n{"[" * 500}\n"""',
        f"'''\n{'[' * 500}\n'''",
        f'"\\"{"[" * 500}"',
        f"1 # {'[' * 500}",
        "[" + ", ".join(["1.5"] * 500) + "]",
        "[" + ", ".join(["{ x.y = 1.5 }"] * 500) + "]",
    ],
)
def test_what_only_looks_deep_is_read(text: str) -> None:
    assert loads(f"a = {text}\n") == tomllib.loads(f"a = {text}\n")


def test_many_keys_with_dots_below_each_other_are_not_deep() -> None:
    text = "\n".join(f"a.b{number}.c = {number}.5" for number in range(500))
    assert line_that_is_too_deep(text) == 0


def test_the_line_is_that_of_the_first_bracket_too_many() -> None:
    assert line_that_is_too_deep("a = [\n[\n[\n[]]]]", deepest=3) == 4
    assert line_that_is_too_deep("a = [\n[\n[\n]]]", deepest=3) == 0


def test_a_text_that_nests_too_deep_is_no_toml_to_those_who_ask() -> None:
    with pytest.raises(tomllib.TOMLDecodeError, match=r"more than 64 deep \(at line 1, column 1\)"):
        loads("a = " + "[" * 65 + "]" * 65)
