"""The command ``fleet apply``: one configuration for many devices."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stadimeter.cli.exits import NOT_FOUND, configuration_path, plain_errors, read_option
from stadimeter.cli.fleet import Below, FleetConnection, Wait, broker_of
from stadimeter.config.toml_source import parse_toml
from stadimeter.config.units import parse_duration
from stadimeter.errors import ConfigError

if TYPE_CHECKING:
    from stadimeter.workbench.fleet.reports import FleetOutcome

_SHOWN = 10
_MAX_DIFFERENCE = "Go on if at most this share of the decisions of a device differs."


def apply(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="What they shall run: a file of a git repository.")],
    config: Annotated[Path | None, typer.Option(metavar="CONFIG", help="Its [messenger] is the broker.")] = None,
    below: Below = None,
    to: Annotated[list[str] | None, typer.Option(metavar="NODE", help="Only this device; may be given again.")] = None,
    commit: Annotated[str, typer.Option(metavar="REVISION", help="As this commit has it.")] = "HEAD",
    why: Annotated[str, typer.Option(metavar="TEXT", help="By default the subject of the commit.")] = "",
    key: Annotated[Path | None, typer.Option(metavar="FILE", help="The SSH key to sign with; else git's.")] = None,
    max_difference: Annotated[float | None, typer.Option(metavar="PERCENT", min=0, help=_MAX_DIFFERENCE)] = None,
    wait: Wait = None,
    within: Annotated[str, typer.Option(metavar="TIME", help="How long a device may take for a phase.")] = "20 min",
) -> None:
    """Give devices a configuration, as a commit has it: signed, and to 5, 25 and 100 % of them.

    First each device of a cohort tries it: its check, its tests, and a replay of the device's own last hour. Only when
    all have, and their decisions differ no more than you allow, they apply it. The first failure stops it. What may be
    changed, each device's own policy says: see `stadimeter fleet receive`. Done again, it goes on where it stopped.

    **Examples**

    - `stadimeter fleet apply rules.toml --config config/appliance.toml`

    - `stadimeter fleet apply rules.toml --to hall/press --max-difference 0.5`

    - `stadimeter fleet apply rules.toml --commit HEAD~1 --why "back to Monday"`

    **Exit code**: 0 every device that is online runs it; 1 it was stopped; 2 nothing was sent.
    """
    from stadimeter.workbench.fleet.desired import clock_trouble  # noqa: PLC0415 - not to show a fleet
    from stadimeter.workbench.fleet.rollout import Rollout, choose, read_committed, signing_key  # noqa: PLC0415

    with plain_errors():
        wait_s, within_s = (
            read_option(parse_duration, wait or "6 s", "--wait"),
            read_option(parse_duration, within, "--within"),
        )
        desired = read_committed(file, commit, why)
        parse_toml(desired.configuration, str(file))
        if trouble := clock_trouble():
            raise ConfigError(f"{trouble}: set it first, since devices know by it which configuration is newer")
        messenger = broker_of(configuration_path(config), {})
        with closing(FleetConnection(messenger, below or messenger.base.partition("/")[0])) as listener:
            listener.listen(wait_s)
            cohorts, notes = choose(listener.fleet, desired.sha256, to or ())
            typer.echo("".join(f"{note}\n" for note in notes), nl=False)
            judge = partial(_judge, max_percent=max_difference)
            rollout = Rollout(listener.fleet, listener.subscription, judge, typer.echo, within_s)
            rollout.prepare(desired, cohorts, key or signing_key(file))
            stopped = rollout.run(cohorts)
    if stopped:
        runs = f"run by {', '.join(rollout.applied)}" if rollout.applied else "run by no device because of this"
        typer.echo(f"stopped: {stopped}\n{desired.commit[:12]} is {runs}", err=True)
        raise typer.Exit(NOT_FOUND)
    typer.echo(f"{len(rollout.applied)} devices have begun to run {desired.commit[:12]}")


def _judge(outcomes: Mapping[str, FleetOutcome], max_percent: float | None) -> str:
    """Print what the trials of a cohort found, and return why not to go on; ask where that is left to a person."""
    trials = {name: outcome.trial for name, outcome in outcomes.items() if outcome.trial is not None}
    found = {name: each.differences for name, each in trials.items() if each.differences is not None}
    for name, trial in trials.items():
        for words in filter(None, (*trial.warnings, trial.not_replayed)):
            typer.echo(f"  {name}: {words}")
    for name, each in sorted(found.items(), key=lambda item: -item[1].percent)[:_SHOWN]:
        typer.echo(f"  {name}: {each.percent:.3g} % of {each.cycles} decisions in {each.minutes:g} min differ")
        counts = [f"{source}: {count} {kind}" for source, kinds in each.events.items() for kind, count in kinds.items()]
        counts += [f"{output}: another command in {count} cycles" for output, count in each.outputs.items()]
        typer.echo("".join(f"    {words}\n" for words in counts), nl=False)
    most = max((each.percent for each in found.values()), default=0.0)
    is_asked = max_percent is None and most > 0 and sys.stdin.isatty()
    if most <= (max_percent or 0.0) or (is_asked and typer.confirm("Apply it?")):
        return ""
    return f"{most:.3g} % of the decisions of a device differ; --max-difference says how many may"
