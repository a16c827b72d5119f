"""Measures detectors on rendered and on real pictures, and writes a report. Run it: ``make bench``.

``python tests/benchmarks/run.py --only ball --frames 60`` runs a part of it and prints that to the terminal. With
``--tuning`` the scenes are those that thresholds may be chosen by; the report is made of others.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import ball_accuracy
import cv2
import false_alarms
import flat_accuracy
import hard_balls
import hard_flats
import machinery
import numpy as np
import real_pictures
import speed
import start_up
import tag_accuracy
from goals import goals_table
from part import Part, commit

from support.scenes import draw

OUT = Path(__file__).resolve().parents[2] / "docs" / "benchmarks"
Job = Callable[[argparse.Namespace, int], Part]


def _accuracy(run: Callable[[int, int, int], Part], frames: int) -> Job:
    return lambda asked, seed: run(asked.frames or frames, asked.workers, seed)


JOBS: dict[str, Job] = {
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
    if asked.only and asked.out is None:
        print("\n\n".join(f"## {part.title}\n\n{part.text}" for part in parts))
        print(goals_table(_facts(parts)))
    else:
        write_report(parts, asked.out or OUT, took_s, plots=asked.plots)
    return 0


def write_report(parts: Sequence[Part], folder: Path, took_s: float, *, plots: bool) -> Path:
    """Write the report and its charts.

    Args:
        parts: What it consists of.
        folder: Where it goes.
        took_s: How long the measurements took.
        plots: Whether charts are drawn too.

    Returns:
        The path of the report.
    """
    folder.mkdir(parents=True, exist_ok=True)
    text = [_head(_facts(parts), took_s), "## Goals\n", goals_table(_facts(parts))]
    for part in parts:
        text += [f"## {part.title}\n", part.text]
        if plots:
            from plots import draw_chart  # without charts, matplotlib is not needed

            text += [f"![{chart.title}]({draw_chart(chart, folder).name})\n" for chart in part.charts]
    path = folder / "report.md"
    path.write_text("\n".join(text), encoding="utf-8")
    return path


def _real_pictures(facts: dict[str, float]) -> str:
    """Say on which real pictures the figures are how good, and where they are not."""
    if "real ball median" not in facts:
        return "No real pictures were on the machine that made this report.\n\n"
    told = {name: f"{100 * value:.2f} %" for name, value in facts.items() if name.startswith("real")}
    return (
        "**On real pictures:** a tennis ball on a plain mat, taped at 32 places, is measured with a median error of "
        f"{told['real ball median']} (90 % of them within {told['real ball p90']}), though the stated interval holds "
        f"only {told['real ball held']} of them; a sheet of letter paper on a door within {told['real sheet worst']}, "
        f"as well as its tape is known; twelve AprilTags within {told['real visp median']} of computed poses. "
        "Not so good: a striped ball that a hand waves about, on video: "
        f"{facts['real video tracked']:.0f} of 1004 frames are tracked (the ball is in sight in about 856), "
        f"{told['real video wrong']} of its measurements are wrong by more than 8 %, and errors are "
        f"{facts['real video quantile']:.1f} times the stated noise. Balls on carpets and tape cut by hand are "
        "measured on rendered pictures only, below: there are no real ones here.\n\n"
    )


def _head(facts: dict[str, float], took_s: float) -> str:
    return (
        "# Benchmarks\n\n"
        f"{_real_pictures(facts)}"
        "Made by `make bench`; do not edit. The pictures are rendered with exact truth by "
        "`support.scenes`: ray-cast, anti-aliased, mixed in linear light, point spread 0.7 px, sRGB, "
        f"noise 2 unless a row says otherwise. Their seeds start at {draw.REPORT_SEEDS.start}; nothing was tuned on "
        f"them: thresholds and constants were chosen on seeds below {draw.TUNING_SEEDS.stop}.\n\n"
        "Bias is the median of the signed error in pixels of apparent size: above zero the target was measured too "
        "large, so too near. The 95 % interval is ± 1.96 of the standard deviation that came with the measurement.\n\n"
        f"This run: commit {commit()}, {took_s / 60:.0f} min on {os.cpu_count()} cores of {platform.machine()}, "
        f"Python {platform.python_version()}, OpenCV {cv2.__version__}, numpy {np.__version__}.\n"
    )


def _facts(parts: Sequence[Part]) -> dict[str, float]:
    return {name: value for part in parts for name, value in part.facts.items()}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(JOBS), help="parts to run; all without it")
    parser.add_argument("--frames", type=int, help="how many scenes; for each part its own number without it")
    parser.add_argument("--rounds", type=int, default=speed.ROUNDS, help="how often each scene is timed")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes; 1 for no others")
    parser.add_argument("--tuning", action="store_true", help="take the scenes that thresholds may be chosen by")
    parser.add_argument("--out", type=Path, help=f"where the report goes; {OUT} for a full run without it")
    parser.add_argument("--no-plots", dest="plots", action="store_false", help="draw no charts")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
