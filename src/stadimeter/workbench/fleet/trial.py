"""Trying a configuration on the device that shall run it: its check, its tests, and the device's own last hour.

It runs in a process of its own, which may take long, run out of memory or be ended; what asks for it goes on.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path

import msgspec
from msgspec import Struct, field

from stadimeter.app.control.last_recording import last_folder
from stadimeter.app.control.recording import recordings_folder
from stadimeter.app.control.reloading import needs_restart
from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.untrusted_file import sha256_of
from stadimeter.errors import ConfigError, JournalError, StadimeterError
from stadimeter.messaging.protocol import ReachesItsPeer
from stadimeter.workbench.fleet.policy import FleetPolicy, changed_motion, changed_settings, load_policy
from stadimeter.workbench.fleet.reports import Differences, Trial
from stadimeter.workbench.replay.comparison import compare
from stadimeter.workbench.replay.replay import decisions, read_recording, without_collector
from stadimeter.workbench.replay.replay_figures import Tally
from stadimeter.workbench.rule_tests.running import run_rule_test

LAST_S = 3600.0
SHOWN = 12

# Below what the centre waits for by default. To replay an hour at 30 Hz with one rule takes a minute of a core of a
# desktop computer, as measured over ten minutes; a small Pi is expected to take some ten times that.
TRIAL_S = 900.0


def try_apart(configuration: Path, policy: Path, text: str) -> Trial:
    """Try a text in place of a configuration, in a process of its own that is nice to the run."""
    command = [sys.executable, "-P", "-m", __name__, str(configuration), str(policy)]
    try:
        done = subprocess.run(command, input=text.encode(), capture_output=True, timeout=TRIAL_S, check=False)  # noqa: S603 - our own module
    except subprocess.TimeoutExpired:
        return Trial(refusal=f"to try it took longer than {TRIAL_S:g} s")
    with suppress(ValueError):
        return msgspec.json.decode(done.stdout, type=Trial)
    last = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
    return Trial(refusal=f"to try it ended with code {done.returncode}: {last}")


def try_out(configuration: Path, policy: FleetPolicy, text: str) -> Trial:
    """Try a text in place of a configuration; every error is a refusal."""
    try:
        old = load_configuration(configuration, with_tests=False)
        new = load_configuration(configuration, texts={configuration: text})
        failed = [test.name for test in new.tests if not run_rule_test(new, test).passed]
        if failed:
            return Trial(refusal=f"{len(failed)} of its {len(new.tests)} tests failed: {', '.join(failed[:SHOWN])}")
        _check_broker(old, new)
        differences, why_not = _replay(configuration, policy, old, new)
        known, found = ([*each.warnings, *feasibility_warnings(each)] for each in (old, new))
    except StadimeterError as error:
        problems = getattr(error, "problems", ()) or (error,)
        more = f"; and {len(problems) - 1} more" if len(problems) > 1 else ""
        return Trial(refusal=f"{problems[0]}{more}")
    known_words = {each.message for each in known}
    return Trial(
        settings=changed_settings(old, new),
        motion=changed_motion(old, new),
        needs_restart=bool(needs_restart(old, new)),
        running_sha256=sha256_of(new.text),
        warnings=tuple(str(each)[:200] for each in found if each.message not in known_words)[:SHOWN],
        tests=len(new.tests),
        differences=differences,
        not_replayed=why_not,
    )


def _check_broker(old: Configuration, new: Configuration) -> None:
    """See that a device that is sent other settings for its broker can still be reached; else raise ConfigError."""
    before, after = (each.drivers.get(("messenger",)) for each in (old, new))
    if before == after:
        return
    trouble = after.options.reach() if after is not None and isinstance(after.options, ReachesItsPeer) else "none"
    if trouble:
        raise ConfigError(f"by its [messenger] this device would not be reached any more: {trouble}")


def _replay(
    configuration: Path, policy: FleetPolicy, old: Configuration, new: Configuration
) -> tuple[Differences | None, str]:
    """Return what differs over the device's last hour, or why nothing can be said of that."""
    kept = [] if policy.recording else _recordings(last_folder(configuration))
    paths = kept or _recordings(policy.recording or recordings_folder(configuration))[:1]
    if not paths:
        why_not = "this device has no recording of its own"
    else:
        try:
            return _differences(paths, old, new), ""
        except StadimeterError as error:  # damaged, cut off in its first line, or of a library that is not installed
            why_not = f"its recording cannot be replayed: {error}"
    if policy.replay == "required":
        raise ConfigError(f"{why_not}, and its policy requires a replay")
    return None, why_not


def _recordings(place: Path) -> list[Path]:
    """Return a recording, or those in a folder, the newest first."""
    if not place.is_dir():
        return [place] if place.is_file() else []
    found = [each for each in place.iterdir() if each.suffix in {".mcap", ".jsonl"} and each.is_file()]
    return sorted(found, key=lambda file: file.stat().st_mtime_ns, reverse=True)


def _differences(paths: Sequence[Path], old: Configuration, new: Configuration) -> Differences:
    """Replay the last hour of what recordings hold, the newest first; of older ones what the newer ones lack of it."""
    found = _Found()
    for path in paths:
        if found.seconds >= LAST_S:
            break
        _compare_over(path, old, new, found)
    if not found.cycles:
        raise JournalError(f"{paths[0]} holds no whole cycle")
    return Differences(
        recording=paths[0].name,
        ago_s=round(max(0.0, time.time() - paths[0].stat().st_mtime), 1),
        minutes=round(found.seconds / 60, 2),
        cycles=found.cycles,
        differing=found.differing,
        events=dict(islice(found.events.items(), SHOWN)),
        outputs=dict(found.outputs.most_common(SHOWN)),
    )


class _Found(Struct):
    """What differs, over the recordings that were replayed so far."""

    seconds: float = 0.0
    cycles: int = 0
    differing: int = 0
    events: defaultdict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    outputs: Counter[str] = field(default_factory=Counter)


def _compare_over(path: Path, old: Configuration, new: Configuration, found: _Found) -> None:
    """Decide on a recording by both configurations, and add what differs."""
    recording, tallies = read_recording(path), (Tally(old.plan), Tally(new.plan))
    from_s = max((cycle.now_s() for cycle in recording.cycles()), default=0.0) - (LAST_S - found.seconds)
    with without_collector():
        # A recording that is still written may be longer when it is read the second time.
        for pair in zip(*(decisions(recording, each.plan, from_s=from_s) for each in (old, new)), strict=False):
            for tally, (_, observation, decision) in zip(tallies, pair, strict=True):
                tally.add(observation, decision)
            before, after = (decision for _, _, decision in pair)
            others = {command.output for command in {*before.commands} ^ {*after.commands}}
            found.outputs.update(others)
            events = [[(event.kind, event.source) for event in each.events] for each in (before, after)]
            found.differing += bool(others) or events[0] != events[1]
            found.cycles += 1
    found.seconds += 60 * tallies[1].minutes
    for each in compare(*tallies).changes:
        found.events[each.event.source][f"{each.event.kind.value} {each.change}"] += 1


if __name__ == "__main__":
    with suppress(OSError):  # a service has its own priority, and may not change it
        os.nice(10)
    tried = try_out(Path(sys.argv[1]), load_policy(Path(sys.argv[2])), sys.stdin.buffer.read().decode())
    sys.stdout.buffer.write(msgspec.json.encode(tried))
