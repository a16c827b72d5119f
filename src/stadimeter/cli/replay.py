"""The command ``replay``."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any

import typer
from msgspec import Struct

from stadimeter.app.exact_json import plain
from stadimeter.app.recordings.journal import Journal, JournalWriter
from stadimeter.cli.exits import NOT_FOUND, plain_errors, working
from stadimeter.config.files import sha256_of
from stadimeter.core.decision import Event
from stadimeter.errors import JournalError
from stadimeter.workbench.replay.comparison import (
    AgainTally,
    Comparison,
    EventChange,
    MeasuredAgain,
    ReplayDiff,
    ReplayResult,
    RuleChange,
    compare,
)
from stadimeter.workbench.replay.replay import (
    AnyRecording,
    Replayed,
    ReplayRun,
    journal_record,
    read_recording,
    replay_run,
)
from stadimeter.workbench.replay.replay_figures import RuleFigures, Tally


def replay(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="What `stadimeter run --journal` or `--record` wrote.")
    ],
    config: Annotated[
        Path | None,
        typer.Option("--config", metavar="CONFIG", help="The rules to run over it. Without: those of the recording."),
    ] = None,
    diff: Annotated[
        Path | None, typer.Option("--diff", metavar="OLD", help="Show what CONFIG changes against this configuration.")
    ] = None,
    from_images: Annotated[
        bool, typer.Option("--from-images", help="Measure again in the recorded pictures, as CONFIG says.")
    ] = False,
    journal: Annotated[
        Path | None, typer.Option("--journal", metavar="FILE", help="Write what is decided now to a journal.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit with 1 if any decision is not the recorded one.")
    ] = False,
) -> None:
    """Run rules over a recording. Nothing is opened and nothing moves.

    Takes what was observed, decides again with the rules of CONFIG, and prints the events and how many decisions are
    the recorded ones. With the configuration of the recording, all of them are. With changed rules, this shows what
    they would have done; with --diff, compared with other rules: events that come, go and move, and for each rule its
    transitions, latency, false alarms, and how near the target came while it was silent.

    **Examples**

    - `stadimeter replay run.jsonl --config config/distance-alert.toml`

    - `stadimeter replay run.jsonl --config new.toml --diff old.toml`

    - `stadimeter replay run.mcap --config new.toml --from-images`

    **Exit code**: 0 done; 1 with --strict, a decision differs; 2 the recording or a configuration is wrong.
    """
    with plain_errors():
        source = read_recording(recording)
        new = replay_run(source, config, from_images=from_images)
        old = replay_run(source, diff, from_images=from_images) if diff is not None else None
        with working("replaying"):
            outcome = _replay(new, old, journal)
        if not outcome.result.cycles:
            raise JournalError(f"{recording} holds no whole cycle, so there is nothing to replay")
    result = outcome.result
    for warning in _warnings(source, new, result):
        typer.echo(f"warning: {warning}", err=True)
    same_rules = sha256_of(new.configuration.text) == source.header.configuration_sha256
    if as_json:
        typer.echo(json.dumps(_figures(outcome, same_rules=same_rules)))
    elif outcome.diff is not None:
        typer.echo("\n".join([*diff_lines(outcome.diff), *again_lines(outcome.again)]))
    else:
        typer.echo("\n".join(_lines(outcome, same_rules=same_rules)))
    if strict and result.identical != result.cycles:
        raise typer.Exit(NOT_FOUND)


class _Outcome(Struct, frozen=True):
    """The results of a replay; those that were not asked for are None, or empty."""

    result: ReplayResult
    diff: ReplayDiff | None
    again: tuple[MeasuredAgain, ...]


def _replay(new: ReplayRun, old: ReplayRun | None, journal: Path | None) -> _Outcome:
    before = _tally(old) if old is not None else None
    comparison, after, again = Comparison(), Tally(new.configuration.plan), AgainTally()
    with _open_journal(new, journal) as replayed:
        for cycle, observation, decision in replayed:
            comparison.add(cycle, observation, decision)
            if before is not None:
                after.add(observation, decision)
            if new.from_images:
                again.add(cycle.observation(), observation)
    diff = compare(before, after) if before is not None else None
    return _Outcome(comparison.result, diff, again.targets())


def _tally(run: ReplayRun) -> Tally:
    tally = Tally(run.configuration.plan)
    for _, observation, decision in run:
        tally.add(observation, decision)
    return tally


@contextmanager
def _open_journal(run: ReplayRun, journal: Path | None) -> Iterator[Iterator[Replayed]]:
    """Go through a replay, and write what is decided to a journal if there is to be one."""
    if journal is None:
        yield iter(run)
        return
    source = run.recording
    with suppress(FileNotFoundError):
        if journal.samefile(source.path):
            raise JournalError(f"{journal} is the recording that is replayed; choose another file")
    with ExitStack() as closing:
        writer = JournalWriter(journal, run.to_be_recorded, source.header.began_at)
        closing.callback(writer.close)
        writer.note_resumption(source.header.resumed)
        yield _writing(run, writer)
        if writer.older_file():
            typer.echo(writer.older_file(), err=True)


def _writing(run: ReplayRun, writer: JournalWriter) -> Iterator[Replayed]:
    for replayed in run:
        cycle, observation, _ = replayed
        if run.is_recorded and cycle.reloaded is not None:
            writer.note_reload(observation.now_s, cycle.reloaded)
        writer.write(journal_record(replayed))
        yield replayed


def _warnings(source: AnyRecording, run: ReplayRun, result: ReplayResult) -> Iterator[str]:
    if source.is_cut_off():
        end = "the last line is cut off" if isinstance(source, Journal) else "its end is missing"
        yield f"{source.path}: {end}; the {result.cycles} whole cycles are used"
    missing = sorted(set(run.configuration.plan.targets) - result.targets)
    if result.frames and missing:
        yield f"{source.path}: no frame was searched for {', '.join(repr(name) for name in missing)}"
    if run.from_images and result.frames < result.recorded_frames:
        yield (
            f"{source.path}: only {result.frames} of {result.recorded_frames} frames are recorded with their pictures; "
            "the others count as missing"
        )


def _figures(outcome: _Outcome, *, same_rules: bool) -> dict[str, Any]:
    result = outcome.result
    figures: dict[str, Any] = {
        "cycles": result.cycles,
        "identical": result.identical,
        "same_configuration": same_rules,
        "events": [plain(event) for event in result.events],
        "differences": [plain(difference) for difference in result.differences],
    }
    if outcome.diff is not None:
        figures["diff"] = outcome.diff.record()
    if outcome.again:
        figures["measured_again"] = [plain(target) for target in outcome.again]
    return figures


def _lines(outcome: _Outcome, *, same_rules: bool) -> Iterator[str]:
    yield from map(event_line, outcome.result.events)
    if outcome.again:
        yield from again_lines(outcome.again)
    else:
        yield from comparison_lines(outcome.result, same_rules=same_rules)


# At most this many events that changed are listed; ``--json`` has all of them.
SHOWN_CHANGES = 40

_FIGURES: tuple[tuple[str, Callable[[RuleFigures], str]], ...] = (
    ("raised", lambda rule: str(rule.raised)),
    ("transitions a minute", lambda rule: f"{rule.transitions_per_minute:.2f}"),
    ("latency, median", lambda rule: _seconds(rule.late_median_s)),
    ("latency, worst", lambda rule: _seconds(rule.late_worst_s)),
    ("crossings missed", lambda rule: _count(rule.missed)),
    ("false alarms", lambda rule: _count(rule.unfounded)),
    ("nearest while silent", lambda rule: _metres(rule.least_distance_m)),
)


def event_line(event: Event) -> str:
    """Return an event in a line."""
    return f"{event.at_s:9.3f} s  {event.kind.value:<16} {event.source:<16} {event.reason}"


def comparison_lines(result: ReplayResult, *, same_rules: bool) -> Iterator[str]:
    """Return in lines how decisions compare with the recorded ones."""
    rules = "the configuration of the recording" if same_rules else "another configuration than the recording's"
    yield f"{result.cycles} cycles, {result.identical} decisions identical, with {rules}."
    for difference in result.differences:
        yield f"differs at {difference.now_s:.3f} s (cycle {difference.cycle}): {', '.join(difference.what)}"


def again_lines(targets: Iterable[MeasuredAgain]) -> Iterator[str]:
    """Return in lines how what was measured again compares with what was recorded."""
    for target in targets:
        found = f"found in {target.found_again} of {target.frames} pictures, {target.found_before} when recorded"
        if target.differs_median_m is None or target.differs_most_m is None:
            yield f"{target.target}: {found}."
            continue
        apart = f"median {target.differs_median_m * 1000:.1f} mm, at most {target.differs_most_m * 1000:.1f} mm"
        yield f"{target.target}: {found}; difference of the distances: {apart}."


def diff_lines(diff: ReplayDiff) -> Iterator[str]:
    """Describe what other rules change, in lines."""
    for change in diff.changes[:SHOWN_CHANGES]:
        yield _change_line(change)
    if len(diff.changes) > SHOWN_CHANGES:
        yield f"… and {len(diff.changes) - SHOWN_CHANGES} more; --json has all of them"
    yield diff.summary()
    for rule in diff.rules:
        yield from _rule_lines(rule)


def _change_line(change: EventChange) -> str:
    by = f"by {change.by_s:+.3f} s" if change.change == "moved" else ""
    return f"{change.change:<5} {by:<14} {event_line(change.event)}"


def _rule_lines(change: RuleChange) -> Iterator[str]:
    yield ""
    yield f"{change.rule:<28} {'old':>10} {'new':>10}"
    for name, shown in _FIGURES:
        old, new = (_format_figures(shown, figures) for figures in (change.old, change.new))
        if {old, new} != {"-"}:
            yield f"  {name:<26} {old:>10} {new:>10}"


def _format_figures(shown: Callable[[RuleFigures], str], figures: RuleFigures | None) -> str:
    return "-" if figures is None else shown(figures)


def _seconds(seconds: float | None) -> str:
    return "-" if seconds is None else f"{seconds:.2f} s"


def _metres(metres: float | None) -> str:
    return "-" if metres is None else f"{metres:.2f} m"


def _count(count: int | None) -> str:
    return "-" if count is None else str(count)
