"""How long an hour of a run takes to be replayed. Run ``python tests/benchmarks/replay_speed.py``.

A simulated run, whose camera draws nothing and whose detector is told where the ball is, is recorded to a journal and
to an MCAP file; then each is replayed with the configuration inside it, as ``stadimeter replay FILE`` does. Without
``--hour`` a tenth of an hour is recorded and the times are multiplied by ten.

Machines differ, and this one may be busy. Each row is the quietest of some rounds, in time of the processor, and stands
as a multiple of a yardstick too that was measured in the same run: 100,000 times `json.dumps` of a fixed object.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from time import perf_counter, process_time

from machinery import configuration, yardstick_times_s
from msgspec import Struct

from stadimeter.app.bootstrap import build
from stadimeter.app.loop import Limits, Loop
from stadimeter.cli.run import open_recordings
from stadimeter.cli.run_services import RunOptions
from stadimeter.config.loader import load_configuration
from stadimeter.workbench.replay.comparison import Comparison
from stadimeter.workbench.replay.replay import read_recording, replay_run, without_collector

RULES = (3, 10)
HOUR_FRAMES = 30 * 3600
TENTH_FRAMES = HOUR_FRAMES // 10
ROUNDS = 3
GOAL_S = 10.0
YARDSTICKS = 100_000


class Row(Struct, frozen=True, kw_only=True):
    """One line of the report: what was replayed, and what an hour of it takes."""

    what: str
    rules: int
    megabytes: float
    hour_cpu_s: float
    hour_s: float
    yardsticks: float


def record(config: Path, keeping: RunOptions, frames: int) -> None:
    """Record a simulated run, as fast as the computer can."""
    loop = Loop(build(load_configuration(config), speed=None))
    with ExitStack() as closing:
        closing.enter_context(open_recordings(loop, keeping))
        loop.run(Limits(frames=frames))


def replay_times_s(path: Path) -> tuple[float, float]:
    """Replay a recording with its own configuration; return the time of the processor and of the clock."""
    began_s, began_cpu_s = perf_counter(), process_time()
    comparison = Comparison()
    with without_collector():
        for cycle, observation, decision in replay_run(read_recording(path), None):
            comparison.add(cycle, observation, decision)
    if comparison.result.identical != comparison.result.cycles:
        raise RuntimeError(f"{path}: only {comparison.result.identical} of {comparison.result.cycles} are identical")
    return process_time() - began_cpu_s, perf_counter() - began_s


def measure_all(
    counts: Sequence[int] = RULES, frames: int = TENTH_FRAMES, rounds: int = ROUNDS, tell: Callable[[str], None] = print
) -> list[Row]:
    """Return every row of the report.

    Args:
        counts: With how many rules.
        frames: How many frames to record.
        rounds: How often each row is measured.
        tell: Told what is going on.

    Returns:
        The rows.
    """
    hours = frames / HOUR_FRAMES
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for count in counts:
            tell(f"recording {frames} frames with {count} rules")
            journal, mcap = folder / f"{count}.jsonl", folder / f"{count}.mcap"
            config = configuration(count, folder)
            record(config, RunOptions(journal=journal, record=mcap, images="none"), frames)
            for what, path in (("journal", journal), ("MCAP without pictures", mcap)):
                cpu_s, wall_s = min(replay_times_s(path) for _ in range(rounds))
                yardstick_s = sum(sorted(yardstick_times_s())[:1000]) / 1000
                rows.append(
                    Row(
                        what=what,
                        rules=count,
                        megabytes=path.stat().st_size / 1e6 / hours,
                        hour_cpu_s=cpu_s / hours,
                        hour_s=wall_s / hours,
                        yardsticks=cpu_s / hours / yardstick_s / YARDSTICKS,
                    )
                )
    return rows


def markdown(rows: Sequence[Row]) -> str:
    """Return the rows as a Markdown table."""
    lines = [
        "| an hour at 30 frames a second | rules | MB | CPU s | s | × 100,000 json.dumps |",
        "| --- | ---: | ---: | ---: | ---: | ---: |",
    ]
    lines += [
        f"| {r.what} | {r.rules} | {r.megabytes:.0f} | {r.hour_cpu_s:.1f} | {r.hour_s:.1f} | {r.yardsticks:.1f} |"
        for r in rows
    ]
    return "\n".join([*lines, "", f"Goal: {GOAL_S:g} s without pictures."])


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hour", action="store_true", help="record a whole hour")
    frames = HOUR_FRAMES if parser.parse_args().hour else TENTH_FRAMES
    print(markdown(measure_all(frames=frames)))


if __name__ == "__main__":
    main()
