"""Shows what is wrong in a configuration beside the line that it is about."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rich.console import Console
from rich.text import Text

from stadimeter.cli.exits import MOST_SHOWN
from stadimeter.config.toml_lines import Place
from stadimeter.config.toml_source import parse_toml
from stadimeter.config.untrusted_file import CONFIGURATION_MAX_BYTES, read_untrusted_text
from stadimeter.errors import ConfigError, Problem, UnreadableError

Kind = Literal["error", "warning"]

_LONGEST_LINE = 240
_COLOURS = {"error": "red", "warning": "yellow"}

_ADDRESS = re.compile(r"""(?<=://)[^\s"']+""")
"""What may hold a password or a token, and is not for every eye that sees a screen or a log."""


@dataclass(frozen=True, slots=True)
class Source:
    """A file with problems: its lines, and the place of each key, if it could be parsed."""

    lines: list[str]
    places: Mapping[str, Place]


def print_problems(
    console: Console, problems: Iterable[Problem], kind: Kind, sources: dict[str, Source] | None = None
) -> None:
    """Print each problem with its line, underlined, and what to do about it.

    Args:
        sources: The files that were read for this before; those that are read now are added.
    """
    sources = {} if sources is None else sources
    every = list(problems)
    for problem in every[:MOST_SHOWN]:
        if problem.file not in sources:
            sources[problem.file] = _source(problem.file)
        console.print(_title(problem, kind))
        margin = " " * (len(str(problem.line)) + 2)
        for line in _fragment(problem, sources[problem.file], kind):
            console.print(line)
        if problem.hint:
            console.print(Text.assemble(f"{margin}   ", (problem.hint, "green")))
    if len(every) > MOST_SHOWN:
        console.print(f"and {len(every) - MOST_SHOWN} more of this kind")


def _title(problem: Problem, kind: Kind) -> Text:
    place = f"{problem.file}:{problem.line}" if problem.line else problem.file
    return Text.assemble(
        (f"{place}: " if place else "", "bold"),
        (f"{kind}: ", f"bold {_COLOURS[kind]}"),
        (f"{problem.key}: " if problem.key else "", "cyan"),
        problem.message,
    )


def _fragment(problem: Problem, source: Source, kind: Kind) -> list[Text]:
    lines = source.lines
    if not 0 < problem.line <= len(lines):
        return []
    line = _ADDRESS.sub(lambda match: "…" * len(match[0]), lines[problem.line - 1].replace("\t", " "))
    number = f"  {problem.line}"
    line, begin, end = _cropped(line, *_span(problem, source, line))
    return [
        Text.assemble((f"{number} | ", "dim"), line),
        Text.assemble((f"{' ' * len(number)} | ", "dim"), " " * begin, ("^" * max(1, end - begin), _COLOURS[kind])),
    ]


def _cropped(line: str, begin: int, end: int) -> tuple[str, int, int]:
    """Return a line, and what is underlined in it; of one that fills the screen only what is around that."""
    if len(line) <= _LONGEST_LINE:
        return line, begin, end
    start = max(0, begin - _LONGEST_LINE // 4)
    shown = line[start : start + _LONGEST_LINE]
    before, after = "…" * (start > 0), "…" * (start + len(shown) < len(line))
    shift = len(before) - start
    return f"{before}{shown}{after}", begin + shift, min(end + shift, len(before) + len(shown))


def _span(problem: Problem, source: Source, line: str) -> tuple[int, int]:
    """Return the columns to underline: those of the key, or else the whole line without its margin and comment."""
    place = _place(problem, source)
    if place is not None and place.line == problem.line:
        return place.column, place.end_column
    return len(line) - len(line.lstrip()), len(line.rstrip())


def _place(problem: Problem, source: Source) -> Place | None:
    key = problem.key
    while key and key not in source.places:
        key = key.rpartition(".")[0]
    return source.places.get(key)


def _source(file: str) -> Source:
    text = _read(file)
    try:
        places = parse_toml(text, file).places
    except ConfigError:
        places = {}
    return Source(text.split("\n"), {".".join(map(str, path)): place for path, place in places.items()})


def _read(file: str) -> str:
    try:
        return read_untrusted_text(Path(file), CONFIGURATION_MAX_BYTES) if file else ""
    except UnreadableError:
        return ""
