"""The command ``check``: everything that is wrong with a configuration, or what it does."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.text import Text

from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.cli.exits import WRONG
from stadimeter.cli.problems import Source, print_problems
from stadimeter.config.describing.describe import describe
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.errors import ConfigError, Problem

WARNED = 1
"""The exit code where a warning counts, with ``--strict``."""


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command()(check)


def check(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="The configuration, a TOML file.")],
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object, for programs.")] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Leave with 1 if there is a warning.")] = False,
) -> None:
    """Check a configuration: print every error in one pass, or say in words what it does.

    Finds values that cannot be read, names that stand for nothing, and rules that contradict each other: conditions
    that never hold, rules that always lose their output, rules that suppress themselves, rules that are too late for
    how fast the target comes, and limits beyond what camera and target can resolve. Nothing is opened and nothing
    moves.

    **Example**

    - `stadimeter check config/follow-ball.toml --strict`

    **Exit code**: 0 the configuration can be used; 1 with --strict, it can be used and there is a warning; 2 it cannot
    be used.
    """
    try:
        configuration = load_configuration(config)
    except ConfigError as error:
        _report_errors(config, error, as_json=as_json)
        raise typer.Exit(WRONG) from error
    warnings = _in_order((*configuration.warnings, *feasibility_warnings(configuration)))
    _report_success(configuration, warnings, as_json=as_json)
    if strict and warnings:
        raise typer.Exit(WARNED)


def _in_order(warnings: tuple[Problem, ...]) -> tuple[Problem, ...]:
    return tuple(sorted(warnings, key=lambda warning: warning.line))


def _report_errors(config: Path, error: ConfigError, *, as_json: bool) -> None:
    if as_json:
        _print_json(error.problems, error.warnings, ())
        return
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    sources: dict[str, Source] = {}
    print_problems(console, error.problems, "error", sources)
    print_problems(console, error.warnings, "warning", sources)
    count = _counted(len(error.problems), "error")
    also = f", {_counted(len(error.warnings), 'warning')}" if error.warnings else ""
    console.print(Text(f"{count}{also}: {config} cannot be used", "bold red"))


def _report_success(configuration: Configuration, warnings: tuple[Problem, ...], *, as_json: bool) -> None:
    sentences = describe(configuration)
    if as_json:
        _print_json((), warnings, sentences)
        return
    console = Console(highlight=False, soft_wrap=True)
    print_problems(console, warnings, "warning")
    for sentence in sentences:
        text = Text(sentence)
        text.highlight_regex("`[^`]+`", "cyan")
        console.print(text)
    count = f", with {_counted(len(warnings), 'warning')}" if warnings else ""
    console.print(Text(f"{configuration.path} can be used{count}", "bold green"))


def _counted(count: int, word: str) -> str:
    return f"{count} {word}{'' if count == 1 else 's'}"


def _print_json(problems: tuple[Problem, ...], warnings: tuple[Problem, ...], describes: tuple[str, ...]) -> None:
    record = {
        "usable": not problems,
        "problems": [dataclasses.asdict(problem) for problem in problems],
        "warnings": [dataclasses.asdict(warning) for warning in warnings],
        "describes": describes,
    }
    typer.echo(json.dumps(record, ensure_ascii=False))
