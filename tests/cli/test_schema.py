"""The command `schema` prints what editors complete from."""

from __future__ import annotations

import json
from pathlib import Path

import typer
from typer.testing import CliRunner, Result

from stadimeter.cli import schema
from stadimeter.config.schema import configuration_schema


def run_schema(*arguments: str) -> Result:
    app = typer.Typer()
    schema.register(app)
    return CliRunner().invoke(app, [*arguments])


def test_the_schema_is_printed_and_nothing_else() -> None:
    result = run_schema()
    assert result.exit_code == 0
    assert json.loads(result.stdout) == configuration_schema()
    assert result.stderr == ""


def test_it_is_written_to_a_file(tmp_path: Path) -> None:
    file = tmp_path / "stadimeter.schema.json"
    result = run_schema("-o", str(file))
    assert result.exit_code == 0
    assert result.stdout == ""
    assert json.loads(file.read_text(encoding="utf-8")) == configuration_schema()


def test_a_folder_that_is_not_there_is_one_clear_line(tmp_path: Path) -> None:
    result = run_schema("-o", str(tmp_path / "nowhere" / "schema.json"))
    assert result.exit_code == 2
    assert result.stderr.splitlines() == [
        f"error: {tmp_path}/nowhere/schema.json: it cannot be written: no such file or directory"
    ]
