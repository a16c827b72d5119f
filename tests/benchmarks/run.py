"""Measures detectors on rendered and on real pictures, and writes a report. Run it: ``make bench``.

``python tests/benchmarks/run.py --only ball --frames 60`` runs a part of it and prints that to the terminal;
``--only ball --into-report`` puts it into the report in place of what was there. With ``--tuning`` the scenes are those
that thresholds may be chosen by; the report is made of others.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import ball_accuracy
import false_alarms
import flat_accuracy
import hard_balls
import hard_flats
import machinery
import real_pictures
import recall
import speed
import start_up
import tag_accuracy
from goals import goals_table
from part import Part
from report import facts_of, replace_parts, write_report

from support.scenes import draw

OUT = Path(__file__).resolve().parents[2] / "docs" / "benchmarks"
Job = Callable[[argparse.Namespace, int], Part]


def _accuracy(run: Callable[[int, int, int], Part], frames: int) -> Job:
    return lambda asked, seed: run(asked.frames or frames, asked.workers, seed)


JOBS: dict[str, Job] = {
    "recall": lambda asked, _seed: recall.run(asked.workers),
    "ball": _accuracy(ball_accuracy.run, 150),
    "hard balls": _accuracy(hard_balls.run, 1600),
    "hard flats": _accuracy(hard_flats.run, 200),
    "sheet": _accuracy(flat_accuracy.run_sheet, 60),
    "disc": _accuracy(flat_accuracy.run_disc, 60),
    "tag": _accuracy(tag_accuracy.run, 48),
    "empty": _accuracy(false_alarms.run, 600),
    "real": lambda _asked, _seed: real_pictures.run(),
    "machinery": lambda _asked, _seed: machinery_part(),
    "speed": lambda asked, seed: speed.run(asked.rounds, asked.frames or speed.SCENES, seed),
}
"""The parts by name, in the order of the report, with how many frames a full run takes."""


def machinery_part() -> Part:
    """Time everything but vision, and the start."""
    rows = machinery.measure_all()
    most = max((row for row in rows if row.what == machinery.WHOLE), key=lambda row: row.rules)
    starts = start_up.measure_all()
    return Part(
        title="Everything but vision",
        text=f"{machinery.markdown(rows)}\n\n{start_up.markdown(starts)}\n",
        facts={"machinery us": most.median_us} | start_up.facts(starts),
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what was asked for.

    Args:
        arguments: What stands on the command line.

    Returns:
        0.
    """
    asked = _parser().parse_args(arguments)
    seed = (draw.TUNING_SEEDS if asked.tuning else draw.REPORT_SEEDS).start
    parts = []
    began_s = time.perf_counter()
    for name in asked.only or JOBS:
        part_began_s = time.perf_counter()
        parts.append(JOBS[name](asked, seed))
        print(f"{name}: {time.perf_counter() - part_began_s:.0f} s", file=sys.stderr)
    took_s = time.perf_counter() - began_s
    if asked.into_report:
        replace_parts(parts, asked.out or OUT, plots=asked.plots)
    elif asked.only and asked.out is None:
        print("\n\n".join(f"## {part.title}\n\n{part.text}" for part in parts))
        print(goals_table(facts_of(parts)))
    else:
        write_report(parts, asked.out or OUT, took_s, plots=asked.plots)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(JOBS), help="parts to run; all without it")
    parser.add_argument("--frames", type=int, help="how many scenes; for each part its own number without it")
    parser.add_argument("--rounds", type=int, default=speed.ROUNDS, help="how often each scene is timed")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes; 1 for no others")
    parser.add_argument("--tuning", action="store_true", help="take the scenes that thresholds may be chosen by")
    parser.add_argument("--into-report", action="store_true", help="put these parts into the report, in their place")
    parser.add_argument("--out", type=Path, help=f"where the report goes; {OUT} for a full run without it")
    parser.add_argument("--no-plots", dest="plots", action="store_false", help="draw no charts")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
