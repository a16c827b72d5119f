"""The line that a problem is about is shown, and no secret with it."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from stadimeter.cli.check import print_problems
from stadimeter.config.findings import Finding, problems
from stadimeter.config.toml_lines import key_spans


def shown(tmp_path: Path, text: str, key: str, line: int) -> str:
    file = tmp_path / "run.toml"
    file.write_text(text)
    console = Console(width=120)
    with console.capture() as capture:
        found = problems([Finding(tuple(key.split(".")), "it is wrong")], str(file), key_spans(text))
        assert [each.line for each in found] == [line]
        print_problems(console, found, "error")
    return capture.get()


def test_an_address_is_covered_and_the_rest_of_its_line_is_not(tmp_path: Path) -> None:
    text = '[notifiers]\nphone = { driver = "apprise", url = "tgram://123:token/4", retry_for = "1" }\n'
    said = shown(tmp_path, text, "notifiers.phone.retry_for", 2)
    line, underline = said.splitlines()[-2:]
    assert "token" not in said
    assert f'url = "tgram://{"…" * len("123:token/4")}", retry_for = "1"' in line
    assert line.index("retry_for") == underline.index("^")


def test_a_line_without_an_address_is_shown_as_it_is(tmp_path: Path) -> None:
    assert 'pin = "18"' in shown(tmp_path, '[actuators.motor]\npin = "18"\n', "actuators.motor.pin", 2)


def test_of_a_line_that_fills_the_screen_only_what_matters_is_shown(tmp_path: Path) -> None:
    text = f'a = "{"x" * 100_000}"\nb = {{ c = "{"y" * 1000}", here = 1, d = "{"z" * 1000}" }}\n'
    assert len(shown(tmp_path, text, "a", 1)) < 1000
    said = shown(tmp_path, text, "b.here", 2).replace("\n", "")
    assert "…" in said
    assert "here = 1" in said
    assert "^" in said
