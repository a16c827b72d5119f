"""A text that nests deeper than anybody can mean is refused before it costs time or the stack."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from stadimeter.config.camera_file import load_camera_model
from stadimeter.config.loader import load_camera_choice, load_configuration
from stadimeter.config.toml_source import MAX_DEPTH, MAX_WORD_LENGTH, parse_toml
from stadimeter.errors import ConfigError

SIZE = 200_000


def repeated(line: str) -> str:
    """Return a long text: a line again and again, each time with another key."""
    count = SIZE // len(line)
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
def test_a_long_text_that_nests_five_hundred_deep_is_refused_with_its_line(tmp_path: Path, text: str, load) -> None:
    file = tmp_path / "deep.toml"
    file.write_text("# a comment\n" + text, encoding="utf-8")
    with pytest.raises(ConfigError, match="stand inside each other more than 64 deep") as caught:
        load(file)
    (problem,) = caught.value.problems
    assert (problem.file, problem.line) == (str(file), 2)


SHALLOW = [
    "[" * MAX_DEPTH + "]" * MAX_DEPTH,
    "{ a = " * MAX_DEPTH + "1" + " }" * MAX_DEPTH,
    f'"{"[" * 500}"',
    f"'{'{' * 500}'",
    f'"""\n{"[" * 500}\n"""',
    f"'''\n{'[' * 500}\n'''",
    f'"\\"{"[" * 500}"',
    f"1 # {'[' * 500}",
    "[" + ", ".join(["1.5"] * 500) + "]",
    "[" + ", ".join(["{ x.y = 1.5 }"] * 500) + "]",
]


def test_what_only_looks_deep_is_read(subtests: pytest.Subtests) -> None:
    for text in SHALLOW:
        with subtests.test(text=text):
            assert parse_toml(f"a = {text}\n", "").table == tomllib.loads(f"a = {text}\n")


@pytest.mark.parametrize("number", ["9", "0xf", "0o7", "0b1", "1_0", "0.1"])
@pytest.mark.parametrize("load", [load_configuration, load_camera_choice, load_camera_model])
def test_a_number_of_five_thousand_digits_is_refused_with_its_line(tmp_path: Path, number: str, load) -> None:
    file = tmp_path / "long.toml"
    file.write_text(f"# a comment\nwidth_px = {number}{number[-1] * 5000}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"a number or a name of 500\d characters") as caught:
        load(file)
    (problem,) = caught.value.problems
    assert (problem.file, problem.line) == (str(file), 2)


def test_a_word_as_long_as_it_may_be_is_read() -> None:
    name = "a" * MAX_WORD_LENGTH
    assert parse_toml(f"{name} = 1", "").table == {name: 1}
    assert parse_toml(f'{name} = "{name}{name}" # {name}{name}', "").table == {name: 2 * name}


@pytest.mark.parametrize(
    ("number", "words"),
    [
        ("9223372036854775808", "does not fit into 64 bits"),
        ("-9223372036854775809", "does not fit into 64 bits"),
        ("0x1_0000_0000_0000_0000", "does not fit into 64 bits"),
        ("1e300", r"too large a number; at most 1e\+18 is taken"),
        ("-1e19", r"too large a number; at most 1e\+18 is taken"),
    ],
)
def test_a_number_that_no_key_means_is_refused_with_its_key(number: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        parse_toml(f"[a]\nb = [\n1,\n{number}]\n", "file.toml")
    (problem,) = caught.value.problems
    assert (problem.file, problem.line, problem.key) == ("file.toml", 4, "a.b.1")
    assert parse_toml("a = 9223372036854775807", "").table == {"a": 2**63 - 1}


def test_a_list_with_a_wrong_entry_is_not_called_too_short_as_well(tmp_path: Path) -> None:
    file = tmp_path / "path.toml"
    file.write_text('[world]\npath = [{ at = "0 s", x = "1e300 m", y = "0 m" }]\n', encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_configuration(file)
    keys = [problem.key for problem in caught.value.problems]
    assert "world.path.0.x" in keys
    assert "world.path" not in keys
