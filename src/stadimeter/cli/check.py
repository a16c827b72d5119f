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
from stadimeter.cli.problems import print_problems
from stadimeter.config.describe import describe
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.errors import ConfigError, Problem

EXIT_WRONG = 2
"""The exit code for a configuration that cannot be used."""


def register(app: typer.Typer) -> None:
    """Add the command to the command line.

    Args:
        app: The command line.
    """
    app.command()(check)


def check(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="The configuration, a TOML file.")],
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object, for programs.")] = False,
) -> None:
    """Check a configuration: print every error in one pass, or say in words what it does.

    Nothing is opened and nothing moves. Leaves with 0 if the configuration can be used and with 2 if it cannot.
    """
    try:
        configuration = load_configuration(config)
    except ConfigError as error:
        _report_errors(config, error.problems, as_json=as_json)
        raise typer.Exit(EXIT_WRONG) from error
    _report_success(configuration, as_json=as_json)


def _report_errors(config: Path, problems: tuple[Problem, ...], *, as_json: bool) -> None:
    if as_json:
        _print_json(problems, (), ())
        return
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    print_problems(console, problems, "error")
    count = f"{len(problems)} error{'s' if len(problems) > 1 else ''}"
    console.print(Text(f"{count}: {config} cannot be used", "bold red"))


def _report_success(configuration: Configuration, *, as_json: bool) -> None:
    sentences = describe(configuration)
    warnings = (*configuration.warnings, *feasibility_warnings(configuration))
    if as_json:
        _print_json((), warnings, sentences)
        return
    console = Console(highlight=False, soft_wrap=True)
    print_problems(console, warnings, "warning")
    for sentence in sentences:
        text = Text(sentence)
        text.highlight_regex("`[^`]+`", "cyan")
        console.print(text)
    count = f", with {len(warnings)} warning{'s' if len(warnings) > 1 else ''}" if warnings else ""
    console.print(Text(f"{configuration.path} can be used{count}", "bold green"))


def _print_json(problems: tuple[Problem, ...], warnings: tuple[Problem, ...], describes: tuple[str, ...]) -> None:
    record = {
        "usable": not problems,
        "problems": [dataclasses.asdict(problem) for problem in problems],
        "warnings": [dataclasses.asdict(warning) for warning in warnings],
        "describes": describes,
    }
    typer.echo(json.dumps(record, ensure_ascii=False))
