"""Without CONFIG, a command takes the configuration that is in this folder, and says so."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from stadimeter.app.bootstrap import demo_configuration
from stadimeter.cli.main import app

COMMANDS = (("check",), ("test",), ("run", "--frames", "2", "--speed", "0"))


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])
def test_without_a_name_the_configuration_in_this_folder_is_used_and_named(
    command: tuple[str, ...], folder: Path
) -> None:
    shutil.copy(demo_configuration().path, folder / "stadimeter.toml")
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0
    assert result.stderr.splitlines()[0] == "using stadimeter.toml"


def test_without_a_configuration_it_says_what_makes_one() -> None:
    for command in [*COMMANDS, ("wiring",)]:
        result = CliRunner().invoke(app, command)
        assert result.exit_code == 2
        assert "there is no stadimeter.toml in this folder. `stadimeter init` writes one" in result.stderr
