"""Completion in a shell: names of rules and targets, as the configurations at hand have them, without a word beside."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import typer

# More files of a folder are not looked into for names.
MAX_FILES = 20


def completing(names: Iterable[str]) -> Callable[[str], list[str]]:
    """Return a function that completes one of some names."""
    known = [*names]
    return lambda incomplete: [name for name in known if name.startswith(incomplete)]


def complete_rule(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the rules that begin so: of the configuration that the line names, of those that run, or of this folder.

    A file is read as TOML and no further: one that is wrong has names all the same, and no library need be loaded.
    """
    return completing(_names(ctx, "rules"))(incomplete)


def complete_target(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the targets that begin so, from the same files."""
    return completing(_names(ctx, "targets"))(incomplete)


def _names(ctx: typer.Context, table: str) -> list[str]:
    named = ctx.params.get("config")
    files = [Path(named)] if named else [*_running(), *sorted(Path.cwd().glob("*.toml"))[:MAX_FILES]]
    found: dict[str, None] = {}
    for file in files:
        with suppress(OSError, ValueError, RecursionError):
            tables = tomllib.loads(file.read_text(encoding="utf-8")).get(table)
            found |= dict.fromkeys(tables if isinstance(tables, dict) else ())
    return [*found]


def _running() -> Iterator[Path]:
    """Yield the configurations of the instances that run, which are asked no more than that."""
    from stadimeter.app.control.client import introduce  # noqa: PLC0415 - a line that names its configuration needs none
    from stadimeter.app.places import running  # noqa: PLC0415
    from stadimeter.errors import StadimeterError  # noqa: PLC0415

    for socket in running():
        with suppress(StadimeterError):
            yield introduce(socket).configuration
