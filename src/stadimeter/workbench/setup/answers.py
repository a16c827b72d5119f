"""What the setup writes: the answers, saved after each one, and the files made from them, with older files kept."""

from __future__ import annotations

import glob
import os
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path

import stadimeter
from stadimeter.config.atomic_file import write_atomically
from stadimeter.config.toml_source import as_toml, read_toml
from stadimeter.config.untrusted_file import CONFIGURATION_MAX_BYTES
from stadimeter.errors import ConfigError, Problem, reason_of
from stadimeter.workbench.saving import save_files

# The file in the folder in which answers are kept.
ANSWERS = "init-answers.toml"

_ANSWERS_TITLE = "# Answers to the questions of `stadimeter init`. `stadimeter init --answers FILE` gives them again.\n"


def save_answers(path: Path, answers: Mapping[str, str]) -> None:
    """Write the answers, or leave what was there.

    Raises:
        ConfigError: They cannot be written there.
    """
    lines = "".join(f"{key} = {as_toml(answer)}\n" for key, answer in answers.items())
    try:
        write_atomically(path, (_ANSWERS_TITLE + lines).encode())
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


def relative_to_setup(folder: Path, text: str) -> str:
    """Return an answer in which files of the current folder are named as the folder of the setup sees them.

    Files are looked for in the folder of the setup first. What is no file in either stays as it is.

    Raises:
        ConfigError: A quotation mark is missing.
    """
    words = words_of(text)
    moved = [_relative_word(folder, word) for word in words]
    return text if moved == words else shlex.join(moved)


def _relative_word(folder: Path, word: str) -> str:
    name, at, rest = word.partition("@")  # what follows is a place or a distance
    is_here_only = bool(glob.glob(name)) and not glob.glob(str(folder / name))  # noqa: PTH207 - Path's are relative
    if not is_here_only:
        return word
    return os.path.relpath(name, folder) + at + rest


def write_files(folder: Path, files: Mapping[str, str]) -> Iterator[str]:
    """Write files; yield a sentence for each. One that would stay the same is left alone.

    Raises:
        ConfigError: A file cannot be written there; then none is.
    """
    written, kept = save_files(folder, files)
    for name in files:
        path = folder / name
        if name not in written:
            path.touch()  # newer than the answers, as `was_left` wants it
            yield f"{path} is as it was"
        else:
            was_there = kept is not None and (kept / name).exists()
            yield f"wrote {path}{f'; the one that was there is {kept / name} now' if kept and was_there else ''}"


def was_left(answers: Path, configuration: Path) -> bool:
    """Return whether an interview was left before its end: its answers are newer than what came of the last one."""
    answered_ns = _modified_ns(answers)
    return answered_ns is not None and answered_ns > (_modified_ns(configuration) or 0)


def _modified_ns(path: Path) -> int | None:
    try:
        return path.stat().st_mtime_ns
    except FileNotFoundError:
        return None


def example(name: str) -> str:
    """Return an example configuration that comes with the program.

    Raises:
        ConfigError: There is none of that name; it lists them.
    """
    folder = Path(stadimeter.__file__).parent / "configurations"
    texts = {path.stem: path for path in sorted(folder.glob("*.toml"))}
    if name not in texts:
        raise ConfigError([Problem(f"there is no example {name!r}, only {', '.join(texts)}", key="--example")])
    return texts[name].read_text(encoding="utf-8")
