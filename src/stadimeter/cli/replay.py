"""The command ``replay``."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import typer
from msgspec import Struct, field

from stadimeter.app.exact_json import plain
from stadimeter.app.recordings.journal import RecordedCycle
from stadimeter.cli.exits import NOT_FOUND, plain_errors, working
from stadimeter.config.files import sha256_of
from stadimeter.core.decision import Decision, Event
from stadimeter.core.observation import Observation
from stadimeter.errors import JournalError
from stadimeter.workbench.replay import AnyRecording, ReplayRun, read_recording, replay_run
from stadimeter.workbench.trial import Trial, TrialDiff, compare


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
            found = replay_beside(new, old)
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


class Replay(Struct, kw_only=True):
    """A replay beside its recording.

    Attributes:
        trial: What is decided now.
        identical: Cycles in which the decision was the recorded one, to the last bit.
        frames: Cycles with a frame; of a replay from pictures, with one whose picture was recorded.
        pairs_m: Of each target that was measured again, its distances when it was recorded and now.
        diff: What other rules change; None if that was not asked for.
    """

    trial: Trial
    identical: int = 0
    frames: int = 0
    recorded_frames: int = 0
    targets: set[str] = field(default_factory=set)
    pairs_m: dict[str, list[tuple[float | None, float | None]]] = field(default_factory=dict)
    diff: TrialDiff | None = None

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
            self.pairs_m.setdefault(measured.target, []).append(pair)

    def measured_again(self) -> list[dict[str, Any]]:
        """Return in how many pictures each target was measured, and by how much the two distances differ."""
        found = []
        for target, pairs in self.pairs_m.items():
            apart_m = [abs(again - before) for before, again in pairs if before is not None and again is not None]
            told = {
                "target": target,
                "frames": len(pairs),
                "found_before": sum(before is not None for before, _ in pairs),
                "found_again": sum(again is not None for _, again in pairs),
                "differs_median_m": median(apart_m) if apart_m else None,
                "differs_most_m": max(apart_m, default=None),
            }
            found.append(told)
        return found


def replay_beside(new: ReplayRun, old: ReplayRun | None = None) -> Replay:
    """Replay a recording; with other rules, compare the two."""
    found = Replay(trial=Trial(plan=new.configuration.plan))
    for cycle, observation, decision in new:
        found.add(cycle, observation, decision)
        if new.from_images:
            found.add_again(cycle.observation(), observation)
    if old is not None:
        before = Trial(plan=old.configuration.plan)
        for _, observation, decision in old:
            before.add(observation, decision)
        found.diff = compare(before, found.trial)
    return found


def _warnings(source: AnyRecording, run: ReplayRun, found: Replay) -> Iterator[str]:
    if source.is_cut_off():
        yield f"{source.path}: its end is missing; the {found.trial.cycles} whole cycles are used"
    missing = sorted(set(run.configuration.plan.measured_targets) - found.targets)
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
    if again := found.measured_again():
        figures["measured_again"] = again
    return figures


def _lines(found: Replay, *, same_rules: bool) -> Iterator[str]:
    yield from map(_event_line, found.trial.events) if found.diff is None else _diff_lines(found.diff)
    for told in found.measured_again():
        seen = f"found in {told['found_again']} of {told['frames']} pictures, {told['found_before']} when recorded"
        apart = ""
        if told["differs_median_m"] is not None:
            median_mm, most_mm = (told[key] * 1000 for key in ("differs_median_m", "differs_most_m"))
            apart = f"; difference of the distances: median {median_mm:.1f} mm, at most {most_mm:.1f} mm"
        yield f"{told['target']}: {seen}{apart}."
    if found.diff is None and not found.pairs_m:
        rules = "the configuration of the recording" if same_rules else "another configuration than the recording's"
        yield f"{found.trial.cycles} cycles, {found.identical} decisions identical, with {rules}."


# At most this many events that changed are listed; ``--json`` has all of them.
SHOWN_CHANGES = 40

# What is shown of each rule, with its name in `RuleFigures`, and its unit.
_FIGURES = (
    ("raised", "raised", ""),
    ("latency, worst", "late_worst_s", "s"),
    ("crossings missed", "missed", ""),
    ("false alarms", "unfounded", ""),
)


def _event_line(event: Event) -> str:
    """Return an event in a line."""
    return f"{event.at_s:9.3f} s  {event.kind.value:<16} {event.source:<16} {event.reason}"


def _diff_lines(diff: TrialDiff) -> Iterator[str]:
    """Describe what other rules change, in lines."""
    for change in diff.changes[:SHOWN_CHANGES]:
        by = f"by {change.by_s:+.3f} s" if change.change == "moved" else ""
        yield f"{change.change:<5} {by:<14} {_event_line(change.event)}"
    if len(diff.changes) > SHOWN_CHANGES:
        yield f"… and {len(diff.changes) - SHOWN_CHANGES} more; --json has all of them"
    yield diff.summary()
    for rule in diff.rules:
        yield ""
        yield f"{rule.rule:<28} {'old':>10} {'new':>10}"
        for name, key, unit in _FIGURES:
            found = [getattr(each, key, None) for each in (rule.old, rule.new)]
            old, new = ("-" if each is None else f"{each:.2f} s" if unit else str(each) for each in found)
            if {old, new} != {"-"}:
                yield f"  {name:<26} {old:>10} {new:>10}"
