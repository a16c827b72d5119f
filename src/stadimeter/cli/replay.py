"""The command ``replay``."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import typer
from msgspec import Struct, field

from stadimeter.app.exact_json import plain
from stadimeter.app.recordings.journal import Journal, JournalWriter, RecordedCycle
from stadimeter.cli.exits import NOT_FOUND, plain_errors, working
from stadimeter.config.files import sha256_of
from stadimeter.core.decision import Decision, Event
from stadimeter.core.observation import Observation
from stadimeter.errors import JournalError
from stadimeter.workbench.replay import AnyRecording, Replayed, ReplayRun, journal_record, read_recording, replay_run
from stadimeter.workbench.trial import EventChange, RuleChange, RuleFigures, Trial, TrialDiff, compare


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
    latency and its false alarms.

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
            found = replay_beside(new, old, journal)
        if not found.trial.cycles:
            raise JournalError(f"{recording} holds no whole cycle, so there is nothing to replay")
    for warning in _warnings(source, new, found):
        typer.echo(f"warning: {warning}", err=True)
    same_rules = sha256_of(new.configuration.text) == source.header.configuration_sha256
    if as_json:
        typer.echo(json.dumps(_figures(found, same_rules=same_rules)))
    else:
        typer.echo("\n".join(_lines(found, same_rules=same_rules)))
    if strict and found.identical != found.trial.cycles:
        raise typer.Exit(NOT_FOUND)


class MeasuredAgain(Struct, frozen=True, kw_only=True):
    """One target in the pictures of a recording.

    Attributes:
        frames: Pictures in which it was looked for again.
        found_before: Those of them in which it was measured when they were recorded.
        found_again: Those of them in which it is measured now.
        differs_median_m: Median difference of the two distances; None if it was never measured both times.
    """

    target: str
    frames: int
    found_before: int
    found_again: int
    differs_median_m: float | None = None
    differs_most_m: float | None = None


class Replay(Struct, kw_only=True):
    """A replay beside its recording.

    Attributes:
        trial: What is decided now; None without cycles.
        identical: Cycles in which the decision was the recorded one, to the last bit.
        frames: Cycles with a frame; of a replay from pictures, with one whose picture was recorded.
        diff: What other rules change; None if that was not asked for.
    """

    trial: Trial
    identical: int = 0
    frames: int = 0
    recorded_frames: int = 0
    targets: set[str] = field(default_factory=set)
    diff: TrialDiff | None = None
    _pairs: dict[str, list[tuple[float | None, float | None]]] = field(default_factory=dict)

    def add(self, cycle: RecordedCycle, observation: Observation, decision: Decision) -> None:
        """Add one cycle; raises JournalError if the recorded one is damaged."""
        self.identical += decision == cycle.decision()
        self.trial.add(observation, decision)
        self.recorded_frames += cycle.has_frame()
        if observation.frame is not None:
            self.frames += 1
            self.targets.update([measured.target for measured in observation.measurements])

    def add_again(self, before: Observation, again: Observation) -> None:
        """Add what was observed in a cycle when it was recorded, and what is measured in it again."""
        before_m = {measured.target: measured.distance_m for measured in before.measurements}
        for measured in again.measurements:
            pair = before_m.get(measured.target), measured.distance_m
            self._pairs.setdefault(measured.target, []).append(pair)

    def measured_again(self) -> Iterator[MeasuredAgain]:
        """Yield how each target that was measured again compares."""
        for target, pairs in self._pairs.items():
            apart_m = [abs(again - before) for before, again in pairs if before is not None and again is not None]
            yield MeasuredAgain(
                target=target,
                frames=len(pairs),
                found_before=sum(before is not None for before, _ in pairs),
                found_again=sum(again is not None for _, again in pairs),
                differs_median_m=median(apart_m) if apart_m else None,
                differs_most_m=max(apart_m, default=None),
            )


def replay_beside(new: ReplayRun, old: ReplayRun | None = None, journal: Path | None = None) -> Replay:
    """Replay a recording; with other rules, compare the two; write what is decided to a journal, if there is one."""
    found = Replay(trial=Trial(plan=new.configuration.plan))
    with _open_journal(new, journal) as write:
        for replayed in new:
            cycle, observation, decision = replayed
            write(replayed)
            found.add(cycle, observation, decision)
            if new.from_images:
                found.add_again(cycle.observation(), observation)
    if old is not None:
        before = Trial(plan=old.configuration.plan)
        for _, observation, decision in old:
            before.add(observation, decision)
        found.diff = compare(before, found.trial)
    return found


@contextmanager
def _open_journal(run: ReplayRun, journal: Path | None) -> Iterator[Callable[[Replayed], None]]:
    """Yield what writes a cycle to the journal, if there is to be one."""
    if journal is None:
        yield lambda _replayed: None
        return
    source = run.recording
    with suppress(FileNotFoundError):
        if journal.samefile(source.path):
            raise JournalError(f"{journal} is the recording that is replayed; choose another file")

    def write(replayed: Replayed) -> None:
        cycle, observation, _ = replayed
        if run.is_recorded and cycle.reloaded is not None:
            writer.note_reload(observation.now_s, cycle.reloaded)
        writer.write(journal_record(replayed))

    with closing(JournalWriter(journal, run.to_be_recorded, source.header.began_at)) as writer:
        writer.note_resumption(source.header.resumed)
        yield write
        if writer.older_file():
            typer.echo(writer.older_file(), err=True)


def _warnings(source: AnyRecording, run: ReplayRun, found: Replay) -> Iterator[str]:
    if source.is_cut_off():
        end = "the last line is cut off" if isinstance(source, Journal) else "its end is missing"
        yield f"{source.path}: {end}; the {found.trial.cycles} whole cycles are used"
    missing = sorted(set(run.configuration.plan.targets) - found.targets)
    if found.frames and missing:
        yield f"{source.path}: no frame was searched for {', '.join(repr(name) for name in missing)}"
    if run.from_images and found.frames < found.recorded_frames:
        yield (
            f"{source.path}: only {found.frames} of {found.recorded_frames} frames are recorded with their pictures; "
            "the others count as missing"
        )


def _figures(found: Replay, *, same_rules: bool) -> dict[str, Any]:
    figures: dict[str, Any] = {
        "cycles": found.trial.cycles,
        "identical": found.identical,
        "same_configuration": same_rules,
        "events": [plain(event) for event in found.trial.events],
    }
    if found.diff is not None:
        figures["diff"] = plain(found.diff)
    if again := [plain(target) for target in found.measured_again()]:
        figures["measured_again"] = again
    return figures


def _lines(found: Replay, *, same_rules: bool) -> Iterator[str]:
    again = list(_again_lines(found.measured_again()))
    if found.diff is not None:
        yield from (*_diff_lines(found.diff), *again)
        return
    yield from map(_event_line, found.trial.events)
    rules = "the configuration of the recording" if same_rules else "another configuration than the recording's"
    yield from again or [f"{found.trial.cycles} cycles, {found.identical} decisions identical, with {rules}."]


# At most this many events that changed are listed; ``--json`` has all of them.
SHOWN_CHANGES = 40

_FIGURES: tuple[tuple[str, Callable[[RuleFigures], str]], ...] = (
    ("raised", lambda rule: str(rule.raised)),
    ("latency, worst", lambda rule: "-" if rule.late_worst_s is None else f"{rule.late_worst_s:.2f} s"),
    ("crossings missed", lambda rule: _count(rule.missed)),
    ("false alarms", lambda rule: _count(rule.unfounded)),
)


def _event_line(event: Event) -> str:
    """Return an event in a line."""
    return f"{event.at_s:9.3f} s  {event.kind.value:<16} {event.source:<16} {event.reason}"


def _again_lines(targets: Iterable[MeasuredAgain]) -> Iterator[str]:
    """Return in lines how what was measured again compares with what was recorded."""
    for target in targets:
        found = f"found in {target.found_again} of {target.frames} pictures, {target.found_before} when recorded"
        if target.differs_median_m is None or target.differs_most_m is None:
            yield f"{target.target}: {found}."
            continue
        apart = f"median {target.differs_median_m * 1000:.1f} mm, at most {target.differs_most_m * 1000:.1f} mm"
        yield f"{target.target}: {found}; difference of the distances: {apart}."


def _diff_lines(diff: TrialDiff) -> Iterator[str]:
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
    return f"{change.change:<5} {by:<14} {_event_line(change.event)}"


def _rule_lines(change: RuleChange) -> Iterator[str]:
    yield ""
    yield f"{change.rule:<28} {'old':>10} {'new':>10}"
    for name, shown in _FIGURES:
        old, new = ("-" if figures is None else shown(figures) for figures in (change.old, change.new))
        if {old, new} != {"-"}:
            yield f"  {name:<26} {old:>10} {new:>10}"


def _count(count: int | None) -> str:
    return "-" if count is None else str(count)
