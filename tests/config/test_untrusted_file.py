"""One reader for every file that others made: it waits for nothing, and reads no more than its kind can have."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from pydantic import ValidationError

import stadimeter
from stadimeter.config.files import is_file, lines_of, open_untrusted, read_untrusted, read_untrusted_text
from stadimeter.config.plugins import DriverOptions
from stadimeter.config.units import FilePath, path_from, validation_context
from stadimeter.errors import UnreadableError


def refusal(path: Path, most_bytes: int = 1000) -> UnreadableError:
    with pytest.raises(UnreadableError) as raised:
        read_untrusted_text(path, most_bytes)
    return raised.value


def test_a_file_up_to_its_bound_is_read_and_one_byte_more_is_not(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"x" * 1000)
    assert read_untrusted(path, 1000) == b"x" * 1000
    assert "larger than 1 kB" in refusal(path, 999).reason


def test_a_text_loses_its_mark_and_its_carriage_returns(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"\xef\xbb\xbfa\r\n\xc3\xa4\n")
    assert read_untrusted_text(path, 1000) == "a\nä\n"
    path.write_bytes(b"a\nb\n\xff\n")
    assert refusal(path).line == 3


def test_what_is_no_regular_file_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    assert refusal(tmp_path / "pipe").reason == "it is not a regular file"
    assert refusal(Path("/dev/zero")).reason == "it is not a regular file"
    assert refusal(tmp_path).reason == "it is a folder"
    assert refusal(tmp_path / "none").reason == "there is no such file"
    assert "symbolic links" in refusal(tmp_path / "loop").reason
    assert "too long" in refusal(tmp_path / ("n" * 300)).reason
    assert "null" in refusal(tmp_path / "a\0b").reason
    assert not any(is_file(tmp_path / name) for name in ("pipe", "loop", "n" * 300, "a\0b"))


def test_a_message_about_a_name_that_is_no_text_can_be_written(tmp_path: Path) -> None:
    error = refusal(tmp_path / os.fsdecode(b"a\xff.toml"))
    assert r"a\udcff.toml" in str(error)
    assert str(error).encode("utf-8")


def test_lines_are_read_up_to_their_bound(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"aaa\nbb\n" + b"c" * 5)
    with open_untrusted(path) as file:
        assert list(lines_of(file, 5)) == [b"aaa\n", b"bb\n", b"ccccc"]
    with open_untrusted(path) as file, pytest.raises(UnreadableError) as raised:
        list(lines_of(file, 4))
    assert raised.value.line == 3


def test_whoever_decodes_catches_value_error_which_a_byte_that_is_no_utf_8_raises_too() -> None:
    """`UnicodeDecodeError` is outside the tree of msgspec's errors and of JSON's; all three are `ValueError`."""
    package = Path(stadimeter.__file__).parent
    narrow = re.compile(r"except\b[^:]*\b(MsgspecError|DecodeError|JSONDecodeError)\b")
    assert [str(file) for file in package.rglob("*.py") if narrow.search(file.read_text("utf-8"))] == []


# Paths are relative to the configuration.


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
