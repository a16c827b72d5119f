"""Every key is found in its line, for any TOML that the standard library accepts."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.config.camera_file import load_camera_model
from stadimeter.config.loader import load_camera_choice, load_configuration
from stadimeter.config.toml_lines import KeyPath, find_span, key_spans, set_value, syntax_error
from stadimeter.config.toml_source import MAX_DEPTH, parse_toml
from stadimeter.errors import ConfigError
from support.each_case import each_case


def paths_and_values(value: Any, path: KeyPath = ()) -> Iterator[tuple[KeyPath, Any]]:
    if path:
        yield path, value
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from paths_and_values(inner, (*path, key))
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            yield from paths_and_values(inner, (*path, number))


RANDOMS = st.randoms(use_true_random=True)
BARE = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_")
NAMES = ("a", "b", "c-1", "when", "Ä.x", "#", "]=", 'q"', "it's", "1", "", "tab\t", "line\n", "🎾", "\\")


class Writer:
    """Writes random TOML in which every number is written once, so that a number names its line."""

    def __init__(self, random: Random) -> None:
        self.random = random
        self.last = 1000

    def number(self) -> str:
        self.last += 1
        return str(self.last)

    def some(self, most: int) -> range:
        return range(self.random.randint(0, most))

    def blank(self) -> str:
        return self.random.choice(["", "", " ", "\t", "  "])

    def key(self, used: set[str]) -> str:
        name = self.random.choice([name for name in NAMES if name not in used])
        used.add(name)
        forms = [json.dumps(name, ensure_ascii=False)]
        if "'" not in name and name.isprintable():
            forms.append(f"'{name}'")
        if name and BARE.issuperset(name):
            forms += [name] * 3
        return f"{self.blank()}{self.random.choice(forms)}{self.blank()}"

    def value(self, depth: int = 0) -> str:
        kinds = [self.number, self.text, self.long_text]
        if depth < 3:
            kinds += [lambda: self.array(depth), lambda: self.inline_table(depth)]
        return self.random.choice(kinds)()

    def text(self) -> str:
        return self.random.choice([f'"# [x] = {self.number()} \\" , }} ]"', f"'{self.number()} \\'", '""', "''"])

    def long_text(self) -> str:
        number = self.number()
        basic = f'"""{number}\n[no.table]\nno = "key" \\""" ""\\" """""'
        return self.random.choice([basic, f"'''{number}\n[[no]]\n# no'''''"])

    def array(self, depth: int) -> str:
        def between() -> str:
            return self.random.choice(["", " ", "\n", " # no ] , comment\n\n\t"])

        entries = [f"{between()}{self.value(depth + 1)}{between()}" for _ in self.some(3)]
        comma = self.random.choice(["", ","]) if entries else ""
        return f"[{','.join(entries)}{comma}{between()}]"

    def inline_table(self, depth: int) -> str:
        used: set[str] = set()
        return "{" + ",".join(self.pair(used, depth + 1) for _ in self.some(3)) + self.blank() + "}"

    def pair(self, used: set[str], depth: int = 0) -> str:
        keys = [self.key(used), *(self.key(set()) for _ in self.some(1))]
        return f"{'.'.join(keys)}={self.blank()}{self.value(depth)}{self.blank()}"

    def table(self, header: str, used: set[str] | None = None) -> list[str]:
        used = set() if used is None else used
        head = [f"{header}{self.random.choice(['', ' # head'])}"] if header else []
        ends = ["", "# [comment] = 1", "\n", "\r"]
        return head + [f"{self.pair(used)}{self.random.choice(ends)}" for _ in self.some(3)]

    def document(self) -> str:
        used: set[str] = set()
        lines = self.table("", used)
        for _ in self.some(4):
            key = self.key(used)
            header = self.random.choice([f"[{key}]", f"[[{key}]]"])
            for _ in range(self.random.randint(1, 3) if header.startswith("[[") else 1):
                lines += self.table(header)
                lines += self.table(f"[{key}.'sub-table'.{key}]") if self.random.random() < 0.4 else []
        return "\n".join(lines)


def document(random: Random) -> str:
    """Return a text that the standard parser accepts."""
    while True:
        text = Writer(random).document().replace("\r\n", "\n")
        if is_toml(text):
            return text


def is_toml(text: str) -> bool:
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return False
    return True


@given(RANDOMS)
def test_exactly_the_keys_of_the_standard_parser_are_found(random: Random) -> None:
    text = document(random)
    assert set(key_spans(text)) == {path for path, _ in paths_and_values(tomllib.loads(text))}


@given(RANDOMS)
def test_the_place_of_a_value_holds_it(random: Random) -> None:
    text = document(random)
    spans, lines = key_spans(text), text.split("\n")
    for path, value in paths_and_values(tomllib.loads(text)):
        if isinstance(value, int):
            span = spans[path]
            # A value below another in an array or table may begin lines after it, never before.
            assert lines[span.line - 1][span.column : span.end_column].rstrip().endswith(str(value))


DOCUMENT = """\
# a comment with [no.table]
title = "x"  # a = b

[rules.near]
when = { below = "50 cm", "of" = 'depth' }
text = \"\"\"
[not.a.table]
neither = "a key"
\"\"\"
many = [
  { at = 1 },  # first
  { at = 2 },
]
"quoted.key".inner = 3
[[list]]
a = 1
[[list]]
a = 2
[list.sub]
b = 3
"""


@each_case(
    ("path", "line", "fragment"),
    [
        (("title",), 2, 'title = "x"'),
        (("rules",), 4, "[rules.near]"),
        (("rules", "near"), 4, "[rules.near]"),
        (("rules", "near", "when", "below"), 5, 'below = "50 cm"'),
        (("rules", "near", "when", "of"), 5, "\"of\" = 'depth'"),
        (("rules", "near", "text"), 6, 'text = """'),
        (("rules", "near", "many", 1, "at"), 12, "at = 2"),
        (("rules", "near", "quoted.key", "inner"), 14, '"quoted.key".inner = 3'),
        (("list", 0, "a"), 16, "a = 1"),
        (("list", 1, "a"), 18, "a = 2"),
        (("list", 1, "sub", "b"), 20, "b = 3"),
    ],
)
def test_a_key_is_found_where_a_person_sees_it(path: KeyPath, line: int, fragment: str) -> None:
    span = key_spans(DOCUMENT)[path]
    assert span.line == line
    assert DOCUMENT.split("\n")[line - 1][span.column : span.end_column] == fragment


def test_a_key_that_is_not_there_is_placed_at_the_table_around_it() -> None:
    spans = key_spans(DOCUMENT)
    missing = find_span(spans, ("rules", "near", "when", "above"))
    assert missing == spans["rules", "near", "when"]
    assert find_span(spans, ("camera", "model")) is None


@pytest.mark.parametrize(
    ("text", "line"),
    [("a = 1\nb = 10 ft\n", 2), ("a = 1\n\n[x\nb = 2", 3), ("a = 1\na = 2\n", 2), ('a = 1\nb = """x\ny\n\n', 3)],
)
def test_a_syntax_error_tells_its_line(text: str, line: int) -> None:
    with pytest.raises(tomllib.TOMLDecodeError) as caught:
        tomllib.loads(text)
    message, found = syntax_error(caught.value, text)
    assert found == line
    assert "(at" not in message


# One value of a TOML text is changed, and everything else stays as it was written.


TEXT = """# the door
[rules.near]   # sounds
when = { below = "1 m", target = "ball" }  # at the door
on_delay = "0 s"

[rules."far = away"]
when.above = "3 m"
any = [{ below = "1 m" }, { between = ["1 m", "2 m"] }]
"""
NEAR, FAR = ("rules", "near"), ("rules", "far = away")


@pytest.mark.parametrize(
    ("path", "was", "now"),
    [
        ((*NEAR, "when", "below"), 'below = "1 m", target', 'below = "2 m", target'),
        ((*NEAR, "on_delay"), 'on_delay = "0 s"', 'on_delay = "2 m"'),
        ((*NEAR, "when", "deadband"), 'target = "ball" }  #', 'target = "ball", deadband = "2 m" }  #'),
        ((*NEAR, "off_delay"), "# sounds\n", '# sounds\noff_delay = "2 m"\n'),
        ((*FAR, "when", "above"), 'above = "3 m"', 'above = "2 m"'),
        ((*FAR, "when", "deadband"), 'away"]\n', 'away"]\nwhen.deadband = "2 m"\n'),
        ((*FAR, "any", 1, "between", 0), '["1 m", "2 m"]', '["2 m", "2 m"]'),
        ((*FAR, "any", 0, "deadband"), '[{ below = "1 m" }', '[{ below = "1 m", deadband = "2 m" }'),
    ],
)
def test_the_value_alone_changes(path: tuple[str | int, ...], was: str, now: str) -> None:
    assert set_value(TEXT, path, '"2 m"') == TEXT.replace(was, now, 1)


def test_a_form_that_cannot_be_changed_is_refused_with_what_to_write() -> None:
    text = '[rules.near]\nbetween = [\n  "1 m",\n  "2 m",\n]\n'
    with pytest.raises(ConfigError, match="by hand"):
        set_value(text, ("rules", "near", "between"), '"2 m"')


STRINGS = st.sampled_from(["a", "b c", 'd"e', "f=g", "ä"])


NESTED = st.recursive(st.integers(0, 9), lambda inner: st.dictionaries(STRINGS, inner, max_size=3), max_leaves=8)


@given(NESTED, STRINGS)
def test_whatever_is_written_means_what_was_meant_or_is_refused(table: object, name: str) -> None:
    def written(value: object) -> str:
        if not isinstance(value, dict):
            return str(value)
        quoted = (f'"{key}"'.replace('d"e', 'd\\"e') + f" = {written(each)}" for key, each in value.items())
        return "{ " + ", ".join(quoted) + " }"

    text = f"[t]\nx = {written(table)}\n"
    try:
        changed = set_value(text, ("t", "x", name), "77")
    except ConfigError:
        return
    assert tomllib.loads(changed)["t"]["x"][name] == 77


# A text that nests deeper than anybody can mean is refused before it costs time or the stack.


@pytest.mark.parametrize("load", [load_configuration, load_camera_choice, load_camera_model])
@pytest.mark.parametrize(("depth", "line"), [(MAX_DEPTH + 1, 2), (500, 0)])
def test_lists_inside_lists_are_refused_where_they_are_too_deep(tmp_path: Path, depth: int, line: int, load) -> None:
    file = tmp_path / "deep.toml"
    file.write_text(f"# a comment\na = {'[' * depth}{']' * depth}", encoding="utf-8")
    with pytest.raises(ConfigError, match="stand inside each other more than 64 deep") as caught:
        load(file)
    assert {(problem.file, problem.line) for problem in caught.value.problems} == {(str(file), line)}


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


def test_a_number_of_five_thousand_digits_is_refused() -> None:
    with pytest.raises(ConfigError, match="a number has too many digits"):
        parse_toml("a = " + "9" * 5000, "file.toml")


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
