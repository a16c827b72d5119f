"""The command ``replay``."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from stadimeter.app.journal import read_journal, sha256_of
from stadimeter.app.replay import ReplayResult, replay
from stadimeter.cli.exits import NOT_FOUND, told_plainly
from stadimeter.config.loader import load_configuration
from stadimeter.core.decision import Event


def register(app: typer.Typer) -> None:
    """Add the command.

    Args:
        app: The command line.
    """
    app.command("replay")(replay_command)


def replay_command(
    journal: Annotated[Path, typer.Argument(metavar="JOURNAL", help="What `stadimeter run --journal` recorded.")],
    config: Annotated[Path, typer.Option("--config", metavar="CONFIG", help="The rules to run over it.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit with 1 if any decision is not the recorded one.")
    ] = False,
) -> None:
    """Run rules over a recording. Nothing is opened and nothing moves.

    Takes what was observed, decides again with the rules of CONFIG, and prints the events and how many decisions are
    the recorded ones. With the configuration of the recording, all of them are. With changed rules, this shows what
    they would have done.

    **Example**

    - `stadimeter replay run.jsonl --config config/distance-alert.toml`

    **Exit code**: 0 done; 1 with --strict, a decision differs; 2 the journal or the configuration is wrong.
    """
    with told_plainly():
        recording = read_journal(journal)
        configuration = load_configuration(config)
        result = replay(recording, configuration.plan)
    if recording.is_cut_off():
        typer.echo(f"warning: {journal}: the last line is cut off; the {result.cycles} whole cycles are used", err=True)
    same_rules = sha256_of(configuration.text) == recording.header.configuration_sha256
    if as_json:
        typer.echo(json.dumps(_figures(result, same_rules=same_rules)))
    else:
        _tell(result, same_rules=same_rules)
    if strict and result.identical != result.cycles:
        raise typer.Exit(NOT_FOUND)


def _figures(result: ReplayResult, *, same_rules: bool) -> dict[str, object]:
    return {
        "cycles": result.cycles,
        "identical": result.identical,
        "same_configuration": same_rules,
        "events": [asdict(event) for event in result.events],
        "differences": [asdict(difference) for difference in result.differences],
    }


def _tell(result: ReplayResult, *, same_rules: bool) -> None:
    for event in result.events:
        typer.echo(_line(event))
    rules = "the configuration of the recording" if same_rules else "another configuration than the recording's"
    typer.echo(f"{result.cycles} cycles, {result.identical} decisions identical, with {rules}.")
    for difference in result.differences:
        what = ", ".join(difference.what)
        typer.echo(f"differs at {difference.now_s:.3f} s (cycle {difference.cycle}): {what}")


def _line(event: Event) -> str:
    return f"{event.at_s:9.3f} s  {event.kind.value:<16} {event.source:<16} {event.reason}"
