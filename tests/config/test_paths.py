"""Paths are relative to the configuration."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import ValidationError

from stadimeter.config.plugins import DriverOptions
from stadimeter.config.units import FilePath, path_from, validation_context


class Named(DriverOptions):
    file: FilePath
    files: tuple[FilePath, ...] = ()


def test_a_relative_path_is_relative_to_the_configuration(tmp_path: Path) -> None:
    table = {"file": "pictures/a.png", "files": ["b.png", "/c.png"]}
    named = Named.model_validate(table, context=validation_context(tmp_path / "test.toml"))
    assert named.file == tmp_path / "pictures" / "a.png"
    assert named.files == (tmp_path / "b.png", Path("/c.png"))


def test_a_tilde_is_the_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/somebody")
    named = Named.model_validate({"file": "~/a.png"}, context=validation_context(tmp_path / "test.toml"))
    assert named.file == Path("/home/somebody/a.png")


def test_without_a_configuration_a_path_stays_as_written() -> None:
    assert Named(file=Path("a.png")).file == Path("a.png")


@pytest.mark.parametrize("value", ["", 5, True, ["a.png"]])
def test_what_is_no_path_is_refused(value: object) -> None:
    with pytest.raises(ValidationError, match=r"is not a path; write it as text, such as 'pictures/desk\.png'"):
        Named.model_validate({"file": value})


def test_a_name_that_only_begins_like_a_home_folder_is_a_name(tmp_path: Path) -> None:
    assert path_from(tmp_path, "~$table.png") == tmp_path / "~$table.png"
    assert path_from(tmp_path, "~/table.png") == Path.home() / "table.png"
