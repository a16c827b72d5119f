"""The commands ``what-if`` and ``teach``."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from stadimeter.cli.exits import plain_errors, working
from stadimeter.config.files import CONFIGURATION_MAX_BYTES, read_untrusted_text
from stadimeter.config.loader import load_configuration
from stadimeter.core.words import figure_in_words
from stadimeter.errors import ChangedMeanwhileError
from stadimeter.workbench.rule_settings import alarm_named, settings_of
from stadimeter.workbench.saving import save_files
from stadimeter.workbench.server.teaching import answer_fields
from stadimeter.workbench.teaching.lesson import Answer, Lesson, in_words
from stadimeter.workbench.teaching.search import FiringMark, parse_mark

_Rule = Annotated[str, typer.Argument(metavar="RULE", help="The alarm.")]
_Config = Annotated[Path, typer.Option("--config", metavar="CONFIG", help="The configuration with the alarm.")]
_Write = Annotated[
    bool, typer.Option("--write", help="Save the change, with a rule test; the former text is kept as a version.")
]
_Json = Annotated[bool, typer.Option("--json", help="Print one JSON object, with all alarms before and after.")]
DEFAULT = Path("stadimeter.toml")


def what_if_command(
    rule: _Rule,
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING", help="What `run --journal` or `run --record` recorded.")
    ],
    changes: Annotated[
        list[str], typer.Option("--set", metavar="KEY=VALUE", help='Such as below="1.2 m" or off_delay="2 s".')
    ],
    config: _Config = DEFAULT,
    write: _Write = False,
    as_json: _Json = False,
) -> None:
    """Say what an alarm with other thresholds or delays would have done on recordings.

    Compares with what it does now: how often it would have fired, how many of that are new, and how many of its alarms
    it would have missed. What can be set: its thresholds, by the names of their keys (`below`, `closing_speed.above`),
    `deadband`, `deadband_sigmas`, `on_delay` and `off_delay`. With --write, a test holds the alarms that came or went.

    **Examples**

    - `stadimeter what-if near run.mcap --set below="80 cm"`

    - `stadimeter what-if near run.mcap --set on_delay="2 s" --write`

    **Exit code**: 0 done; 2 an error in what was given.
    """
    with plain_errors():
        lesson = _read(config, recordings)
        values = dict(_split(each) for each in changes)
        answers = lesson.answer(lesson.load(rule, values).plan)
        _tell(lesson, rule, values, answers, as_json=as_json)
        if write:
            _save(lesson, rule, values, ())


def teach_command(
    rule: _Rule,
    marks: Annotated[
        list[str],
        typer.Option("--mark", metavar="MARK", help='Such as "run.mcap@14.2s fire" or "run.mcap@14s..20s no".'),
    ],
    others: Annotated[
        list[Path] | None, typer.Argument(metavar="RECORDING", help="Recordings without marks, to hold it against.")
    ] = None,
    config: _Config = DEFAULT,
    write: _Write = False,
    as_json: _Json = False,
) -> None:
    """Propose the smallest change of an alarm by marks in recordings: should have fired, or not.

    A mark is a moment or a span, in seconds from the beginning of the recording. The change of threshold, deadband
    and delays meets all marks, changes as few other alarms as it can, and as few settings. It is held against all
    recordings. Marks that no settings meet are refused, with the two that contradict each other.

    **Examples**

    - `stadimeter teach near --mark "run.mcap@14.2s fire" --mark "run.mcap@61s no"`

    - `stadimeter teach near tuesday.mcap --mark "monday.mcap@61s no" --write`

    **Exit code**: 0 done; 2 the marks contradict each other, or an error in what was given.
    """
    with plain_errors():
        parsed = [parse_mark(each) for each in marks]
        lesson = _read(config, [*(Path(mark.recording) for mark in parsed), *(others or ())])
        with working(f"trying settings of '{rule}'"):
            found = lesson.propose(rule, parsed)
        _tell(lesson, rule, found.values, found.answers, as_json=as_json)
        if write:
            _save(lesson, rule, found.values, found.marks)


def _read(config: Path, recordings: Iterable[Path]) -> Lesson:
    configuration = load_configuration(config)
    lesson = Lesson(configuration=configuration, text=read_untrusted_text(config, CONFIGURATION_MAX_BYTES))
    for path in recordings:
        lesson.add(str(path), path)
    with working("reading the recordings"):
        lesson.go_on(math.inf)
    return lesson


def _split(change: str) -> tuple[str, str]:
    key, equals, value = change.partition("=")
    if not equals:
        raise typer.BadParameter(f'{change!r} is not of the form below="1.2 m"', param_hint="--set")
    return key.strip(), value.strip().strip('"')


def _tell(
    lesson: Lesson, rule: str, values: Mapping[str, float | str], answers: Sequence[Answer], *, as_json: bool
) -> None:
    if as_json:
        typer.echo(json.dumps({"changes": dict(values), **answer_fields(lesson, rule, answers)}, ensure_ascii=False))
        return
    was = settings_of(lesson.configuration, rule)
    for key, value in values.items():
        now = value if isinstance(value, str) else figure_in_words(value, was[key].unit)
        typer.echo(f"{key}: {now}; it was {figure_in_words(was[key].value, was[key].unit)}")
    for each in answers:
        _, alarm = alarm_named(lesson.configuration, rule)
        new, missed = each.counts(alarm.name)
        damage = f" It is damaged: {each.kept.damage}" if each.kept.damage else ""
        damage = damage or (" Its end is missing." if each.kept.recording.is_cut_off() else "")
        typer.echo(f"{each.name}: {new} new, {missed} missed, in {each.difference.minutes:.1f} minutes.{damage}")
    typer.echo(in_words(rule, answers))


def _save(lesson: Lesson, rule: str, values: Mapping[str, float | str], marks: Sequence[FiringMark]) -> None:
    place = lesson.configuration.path
    text, tests = lesson.write(rule, values, marks)
    _, kept = save_files(place.parent, {place.name: text}, lambda: _refuse_if_changed(lesson))
    typer.echo(f"Saved {place}, with {len(tests)} test{'' if len(tests) == 1 else 's'}; what was there is in {kept}.")


def _refuse_if_changed(lesson: Lesson) -> None:
    place = lesson.configuration.path
    if (theirs := read_untrusted_text(place, CONFIGURATION_MAX_BYTES)) != lesson.text:
        words = f"{place} was changed by another since it was read; nothing was saved: teach it again"
        raise ChangedMeanwhileError(words, theirs, [])
