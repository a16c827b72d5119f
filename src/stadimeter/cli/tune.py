"""The command ``tune``."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from stadimeter.cli.completion import complete_rule
from stadimeter.cli.exits import NOT_FOUND, plain_errors, working
from stadimeter.config.files import CONFIGURATION_MAX_BYTES, read_untrusted_text
from stadimeter.config.loader import load_configuration
from stadimeter.core.words import counted, figure_in_words
from stadimeter.errors import ChangedMeanwhileError
from stadimeter.workbench.saving import save_files
from stadimeter.workbench.server.tuning import answer_fields
from stadimeter.workbench.tune import FiringMark, Proposal, RuleSetting, Tuning, in_words, parse_mark, settings_of

DEFAULT = Path("stadimeter.toml")


def tune_command(
    rule: Annotated[str, typer.Argument(metavar="RULE", help="The alarm.", autocompletion=complete_rule)],
    recordings: Annotated[
        list[Path] | None, typer.Argument(metavar="RECORDING", help="What `run --journal` or `run --record` recorded.")
    ] = None,
    marks: Annotated[
        list[str] | None,
        typer.Option("--mark", metavar="MARK", help='Such as "run.mcap@14.2s fire" or "run.mcap@14s..20s no".'),
    ] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help='Try this alone, such as below="1.2 m" or off_delay="2 s".'),
    ] = None,
    config: Annotated[Path, typer.Option("--config", metavar="CONFIG", help="The configuration with the alarm.")] = (
        DEFAULT
    ),
    save: Annotated[
        int | None,
        typer.Option("--save", min=1, metavar="N", help="Save this one, with a rule test; the former text is kept."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object, with all alarms.")] = False,
) -> None:
    """Find an alarm's threshold, delays and deadband from recordings.

    A mark is a moment or a span, in seconds from the beginning of its recording: the alarm should have fired there, or
    not. With marks, the settings that meet them all are shown, those first that change the fewest other alarms, and the
    fewest settings. Without, thresholds stay: delays and deadband are sought with which the alarm is raised whenever
    the target truly crossed them, and never else. With --set, only that is tried. `new` and `gone` count the alarms
    that it would have had and has not, and the other way round. Nothing is changed without --save.

    **Examples**

    - `stadimeter tune near run.jsonl`

    - `stadimeter tune near --mark "run.mcap@14.2s fire" --mark "run.mcap@61s no" --save 1`

    - `stadimeter tune near run.mcap --set below="80 cm"`

    **Exit code**: 0 done; 1 nothing that was tried is better; 2 marks that contradict each other, or another error.
    """
    with plain_errors():
        parsed = [parse_mark(each) for each in marks or ()]
        paths = [*(Path(mark.recording) for mark in parsed), *(recordings or ())]
        if not paths:
            raise typer.BadParameter("name a recording, or a mark in one", param_hint="RECORDING")
        tuning = _read(config, paths)
        with working(f"trying settings of '{rule}'"):
            as_it_is = tuning.propose(rule, {})
            values = dict(_split(each) for each in changes or ())
            proposals = [tuning.propose(rule, values)] if values else tuning.best(rule, parsed)
            proposals = [each for each in proposals if each.values]
        if as_json:
            answers = [answer_fields(tuning, rule, each) for each in (as_it_is, *proposals)]
            typer.echo(json.dumps({"as_it_is": answers[0], "proposals": answers[1:]}, ensure_ascii=False))
        else:
            _tell(tuning, rule, [as_it_is, *proposals])
        if save is not None:
            if save > len(proposals):
                raise typer.BadParameter(f"there are only {len(proposals)}", param_hint="--save")
            _save(tuning, rule, proposals[save - 1], parsed)
    if not proposals:
        raise typer.Exit(NOT_FOUND)


def _read(config: Path, recordings: Sequence[Path]) -> Tuning:
    configuration = load_configuration(config)
    tuning = Tuning(configuration=configuration, text=read_untrusted_text(config, CONFIGURATION_MAX_BYTES))
    for path in recordings:
        tuning.add(str(path), path)
    with working("reading the recordings"):
        tuning.go_on(math.inf)
    return tuning


def _split(change: str) -> tuple[str, str]:
    key, equals, value = change.partition("=")
    if not equals:
        raise typer.BadParameter(f'{change!r} is not of the form below="1.2 m"', param_hint="--set")
    return key.strip(), value.strip().strip('"')


def _tell(tuning: Tuning, rule: str, proposals: Sequence[Proposal]) -> None:
    for each in proposals[0].answers:
        damage = f"it is damaged: {each.kept.damage}" if each.kept.damage else ""
        damage = damage or ("its end is missing" if each.kept.recording.is_cut_off() else "")
        if damage:
            typer.echo(f"{each.name}: {damage}; what was before that is used", err=True)
    was = settings_of(tuning.configuration, rule)
    table = Table()
    table.add_column("")
    table.add_column("settings")
    for heading in ("alarms", "new", "gone", "false", "late at most"):
        table.add_column(heading, justify="right")
    for number, proposal in enumerate(proposals):
        words = "\n".join(_settings(proposal, was)) or "as it is"
        table.add_row(str(number or ""), words, *_counts(proposal))
    Console().print(table)
    if len(proposals) == 1:
        typer.echo("Nothing that was tried is better than what is set.")
    elif len(proposals) == 2:
        typer.echo(in_words(rule, proposals[1].answers))


def _settings(proposal: Proposal, was: dict[str, RuleSetting]) -> Iterator[str]:
    for key, value in proposal.values.items():
        now = value if isinstance(value, str) else figure_in_words(value, was[key].unit)
        yield f"{key} {now} (was {figure_in_words(was[key].value, was[key].unit)})"


def _counts(proposal: Proposal) -> Iterator[str]:
    figures = [each.figures for each in proposal.answers]
    yield str(sum(each.raised for each in figures))
    yield from (str(sum(each.count(change) for each in proposal.answers)) for change in ("added", "lost"))
    false = [each.unfounded for each in figures if each.unfounded is not None]
    yield str(sum(false)) if false else "-"
    late_s = [each.late_worst_s for each in figures if each.late_worst_s is not None]
    yield f"{max(0.0, *late_s):.2f} s" if late_s else "-"


def _save(tuning: Tuning, rule: str, proposal: Proposal, marks: Sequence[FiringMark]) -> None:
    place = tuning.configuration.path
    files, tests = tuning.write(rule, proposal.values, marks)
    _, kept = save_files(place.parent, files, lambda: _refuse_if_changed(tuning))
    typer.echo(f"Saved {place}, with {counted(len(tests), 'test')}; what was there is in {kept}.")


def _refuse_if_changed(tuning: Tuning) -> None:
    place = tuning.configuration.path
    if read_untrusted_text(place, CONFIGURATION_MAX_BYTES) != tuning.text:
        words = f"{place} was changed by another since it was read; nothing was saved: tune it again"
        raise ChangedMeanwhileError(words)
