"""The command ``check``: what is wrong with a configuration or what it does, and what may be in one."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console
from rich.text import Text

from stadimeter.app.exact_json import plain
from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.app.this_computer import warnings_here
from stadimeter.cli.exits import MAX_SHOWN, WRONG, ConfigArgument, configuration_path, plain_errors
from stadimeter.config.describe import describe
from stadimeter.config.files import CONFIGURATION_MAX_BYTES, is_file, read_untrusted_text
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.schema import configuration_schema
from stadimeter.core.words import counted
from stadimeter.errors import ConfigError, Problem, UnreadableError

Kind = Literal["error", "warning"]

# The exit code where a warning counts, with ``--strict``.
WARNED = 1

_COLOURS = {"error": "red", "warning": "yellow"}

# What may hold a password or a token, and is not for every eye that sees a screen or a log.
_ADDRESS = re.compile(r"""(?<=://)[^\s"']+""")


def check(
    config: ConfigArgument = None,
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object, for programs.")] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Leave with 1 if there is a warning.")] = False,
    elsewhere: Annotated[
        bool, typer.Option("--elsewhere", help="Leave out what this computer lacks: it runs on another one.")
    ] = False,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print a JSON Schema of configurations instead, for editors.")
    ] = False,
) -> None:
    """Name every mistake in a configuration, or say what it does.

    Finds values that cannot be read, names that stand for nothing, and rules that contradict each other: conditions
    that never hold, rules that always lose their output, rules that suppress themselves, rules that are too late for
    how fast the target comes, and limits beyond what camera and target can resolve. Then what this computer lacks to
    run it: a camera, a serial port, a library, a permission. Nothing is opened and nothing moves. Root sees what the
    service would: a configuration in /etc/stadimeter is checked as the service's user.

    --schema knows every driver that is installed here, and its keys. Put `#:schema ./stadimeter.schema.json` into the
    first line of a configuration, and editors with a TOML language server complete and check while you write, such as
    Visual Studio Code with Even Better TOML.

    **Examples**

    - `stadimeter check config/follow-ball.toml --strict`

    - `stadimeter check --schema > stadimeter.schema.json`

    **Exit code**: 0 the configuration can be used; 1 with --strict, it can be used and there is a warning; 2 it cannot
    be used.
    """
    if schema:  # editors read it, and people do not: it is half as long without white space
        typer.echo(json.dumps(configuration_schema(), separators=(",", ":"), ensure_ascii=False))
        return
    with plain_errors():
        path = configuration_path(config)
    try:
        configuration = load_configuration(path)
    except ConfigError as error:
        _report_errors(path, error, as_json=as_json)
        raise typer.Exit(WRONG) from error
    here = () if elsewhere else warnings_here(configuration)
    found = (*configuration.warnings, *feasibility_warnings(configuration), *here)
    warnings = tuple(sorted(found, key=lambda warning: warning.line))
    _report_success(configuration, warnings, is_lacking=bool(here), as_json=as_json)
    if strict and warnings:
        raise typer.Exit(WARNED)


def _report_errors(config: Path, error: ConfigError, *, as_json: bool) -> None:
    if as_json:
        _print_json(error.problems, (), ())
        return
    console = prose_console(stderr=True)
    print_problems(console, error.problems, "error")
    console.print(Text(f"{counted(len(error.problems), 'error')}: {config} cannot be used", "bold red"))


def _report_success(
    configuration: Configuration, warnings: tuple[Problem, ...], *, is_lacking: bool, as_json: bool
) -> None:
    sentences = (*describe(configuration), *_set_thresholds(configuration))
    if as_json:
        _print_json((), warnings, sentences)
        return
    console = prose_console()
    print_problems(console, warnings, "warning")
    for sentence in sentences:
        text = Text(sentence)
        text.highlight_regex("`[^`]+`", "cyan")
        console.print(text)
    count = f", with {counted(len(warnings), 'warning')}" if warnings else ""
    verdict = "is valid, but this computer lacks something" if is_lacking else "can be used"
    words = f"{configuration.path} {verdict}{count}"
    console.print(Text(words, "bold yellow" if is_lacking else "bold green"))


def _set_thresholds(configuration: Configuration) -> tuple[str, ...]:
    """Return in words what operators have set that the next run goes by, as the usual state file has it."""
    from stadimeter.app.places import state_file  # noqa: PLC0415 - not for other commands

    file = state_file(configuration.path)
    if file is None or not is_file(file):
        return ()
    from stadimeter.app.persistence.alarm_store import describe_kept  # noqa: PLC0415 - it needs SQLite

    return tuple(describe_kept(file, configuration.plan.rules))


def _print_json(problems: tuple[Problem, ...], warnings: tuple[Problem, ...], describes: tuple[str, ...]) -> None:
    record = {
        "usable": not problems,
        "problems": [plain(problem) for problem in problems],
        "warnings": [plain(warning) for warning in warnings],
        "describes": describes,
    }
    typer.echo(json.dumps(record, ensure_ascii=False))


def prose_console(*, stderr: bool = False) -> Console:
    """Return a console that wraps sentences at words in a terminal, and leaves lines whole in a file or a pipe."""
    console = Console(stderr=stderr, highlight=False)
    console.soft_wrap = not console.is_terminal
    return console


def print_problems(console: Console, problems: Sequence[Problem], kind: Kind) -> None:
    """Print each problem with its line, underlined, and what to do about it."""
    lines = {file: _lines(file) for file in {problem.file for problem in problems}}
    for problem in problems[:MAX_SHOWN]:
        console.print(_title(problem, kind))
        margin = " " * (len(str(problem.line)) + 2)
        for line in _fragment(problem, lines[problem.file], kind):
            console.print(line)
        if problem.hint:
            console.print(Text.assemble(f"{margin}   ", (problem.hint, "green")))
    if len(problems) > MAX_SHOWN:
        console.print(f"and {len(problems) - MAX_SHOWN} more of this kind")


def _title(problem: Problem, kind: Kind) -> Text:
    where = f"{problem.file}:{problem.line}" if problem.line else problem.file
    return Text.assemble(
        (f"{where}: " if where else "", "bold"),
        (f"{kind}: ", f"bold {_COLOURS[kind]}"),
        (f"{problem.key}: " if problem.key else "", "cyan"),
        problem.message,
    )


def _fragment(problem: Problem, lines: list[str], kind: Kind) -> list[Text]:
    if not 0 < problem.line <= len(lines):
        return []
    line = _ADDRESS.sub(lambda match: "…" * len(match[0]), lines[problem.line - 1].replace("\t", " "))
    number = f"  {problem.line}"
    begin, end = problem.column, problem.end_column
    if not end:  # the whole line without its margin
        begin, end = len(line) - len(line.lstrip()), len(line.rstrip())
    return [
        Text.assemble((f"{number} | ", "dim"), line),
        Text.assemble((f"{' ' * len(number)} | ", "dim"), " " * begin, ("^" * max(1, end - begin), _COLOURS[kind])),
    ]


def _lines(file: str) -> list[str]:
    try:
        return read_untrusted_text(Path(file), CONFIGURATION_MAX_BYTES).split("\n") if file else []
    except UnreadableError:
        return []
