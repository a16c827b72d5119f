"""Answers in a file: saved after each of them, so that nothing is lost, and read from a file that a script gives."""

from __future__ import annotations

import glob
import os
import shlex
from collections.abc import Mapping
from pathlib import Path

from stadimeter.config.atomic_file import write_atomically
from stadimeter.config.toml_source import as_toml, read_toml
from stadimeter.config.untrusted_file import CONFIGURATION_MAX_BYTES
from stadimeter.errors import ConfigError, Problem, reason_of

ANSWERS = "init-answers.toml"
"""The file in the folder in which answers are kept."""

_TITLE = "# Answers to the questions of `stadimeter init`. `stadimeter init --answers FILE` gives them again.\n"


def save_answers(path: Path, answers: Mapping[str, str]) -> None:
    """Write the answers, or leave what was there.

    Raises:
        ConfigError: They cannot be written there.
    """
    lines = "".join(f"{key} = {as_toml(answer)}\n" for key, answer in answers.items())
    try:
        write_atomically(path, (_TITLE + lines).encode())
    except OSError as error:
        raise ConfigError([Problem(f"the answers cannot be written: {reason_of(error)}", str(path))]) from error


def load_answers(path: Path) -> dict[str, str]:
    """Read answers. A number counts as text, and a list as one answer that holds several things.

    Raises:
        ConfigError: It is no TOML file, or a value is something else; with the line.
    """
    source = read_toml(path, CONFIGURATION_MAX_BYTES)
    answers = {key: _answer(value) for key, value in source.table.items()}
    wrong = [key for key, answer in answers.items() if answer is None]
    if wrong:
        hint = 'write it such as size = "6.4 cm"'
        raise ConfigError(
            Problem("an answer is text, a number, or a list of these", str(path), source.spans[(key,)].line, key, hint)
            for key in wrong
        )
    return {key: answer for key, answer in answers.items() if answer is not None}


def _answer(value: object) -> str | None:
    if isinstance(value, list):
        parts = [_answer(each) for each in value]
        return None if None in parts else shlex.join(part for part in parts if part is not None)
    return str(value) if isinstance(value, str | int | float) and not isinstance(value, bool) else None


def words_of(text: str) -> list[str]:
    """Return the words of an answer; what has a space stands in quotation marks.

    Raises:
        ConfigError: A quotation mark is missing.
    """
    try:
        return shlex.split(text)
    except ValueError as error:
        raise ConfigError(f"{text!r} lacks a quotation mark") from error


def seen_from(folder: Path, text: str) -> str:
    """Return an answer in which files of the current folder are named as the folder of the setup sees them.

    Files are looked for in the folder of the setup first. What is no file in either stays as it is.

    Raises:
        ConfigError: A quotation mark is missing.
    """
    words = words_of(text)
    moved = [_seen_from(folder, word) for word in words]
    return text if moved == words else shlex.join(moved)


def _seen_from(folder: Path, word: str) -> str:
    name, at, rest = word.partition("@")  # what follows is a place or a distance
    is_here_only = bool(glob.glob(name)) and not glob.glob(str(folder / name))  # noqa: PTH207 - Path's are relative
    if not is_here_only:
        return word
    return os.path.relpath(name, folder) + at + rest
