"""Measures rules: on noise, by the thousand, and over an hour that is replayed. Writes a report: ``make bench-rules``.

``python tests/benchmarks/rules_report.py --only scale`` runs a part and prints it.
"""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Callable, Sequence
from pathlib import Path

import false_raises
import following
import numpy as np
import replay_speed
import rule_policies
import rule_scale
from goals import Facts, Goal
from part import Part, commit, table

from support.scenes import draw

OUT = Path(__file__).resolve().parents[2] / "docs" / "benchmarks" / "rules.md"


def _per_minute(value: float) -> str:
    return f"{value:.2f}"


def _seconds(value: float) -> str:
    return f"{value:.3f} s"


GOALS = (
    Goal(
        what="hovering at the limit, 2 m / 8 m: raised or cleared a minute",
        reach="≤ 1.0 both",
        facts=["rules hover 2 m", "rules hover 8 m"],
        limits=(1.0, 1.0),
        most=True,
        show=_per_minute,
    ),
    Goal(
        what="standing 3 σ behind it: raised for nothing, a minute",
        reach="≤ 0.05 both",
        facts=["rules false 2 m", "rules false 8 m"],
        limits=(0.05, 0.05),
        most=True,
        show=lambda value: f"{value:.3f}",
    ),
    Goal(
        what="the same over 200 minutes at 8 m: white / correlated / heavy tails / outliers",
        reach="≤ 0.05 each",
        facts=[f"rules raises {kind}" for kind in false_raises.JUDGED],
        limits=(0.05,) * len(false_raises.JUDGED),
        most=True,
        show=lambda value: f"{value:.3f}",
    ),
    Goal(
        what="upper end of the 95 % interval of that",
        reach="≤ 0.1 each",
        facts=[f"rules raises at most {kind}" for kind in false_raises.JUDGED],
        limits=(0.1,) * len(false_raises.JUDGED),
        most=True,
        show=lambda value: f"{value:.3f}",
    ),
    Goal(
        what="a leap, 10 / 15 frames a second: how late",
        reach="≤ 0.2 s",
        facts=["leap late 10 Hz", "leap late 15 Hz"],
        limits=(0.2, 0.2),
        most=True,
        show=_seconds,
    ),
    Goal(
        what="coming at 2 m/s: how late, on average",
        reach="≤ 0.1 s both",
        facts=["rules late 2 m", "rules late 8 m"],
        limits=(0.1, 0.1),
        most=True,
        show=_seconds,
    ),
    Goal(
        what="10,000 thresholds on one distance, none crosses, a cycle",
        reach="≤ 10 µs",
        facts=["10,000 thresholds us"],
        limits=(10.0,),
        most=True,
        show=lambda value: f"{value:.1f} µs",
    ),
    Goal(
        what="100 rules of all kinds, amid their limits, a cycle",
        reach="≤ 50 µs",
        facts=["100 mixed us"],
        limits=(50.0,),
        most=True,
        show=lambda value: f"{value:.1f} µs",
    ),
    Goal(
        what="replay of an hour at 30 frames a second, no pictures: 3 / 10 rules",
        reach="≤ 10 s",
        facts=["replay 3 s", "replay 10 s"],
        limits=(10.0, 10.0),
        most=True,
        show=lambda value: f"{value:.1f} s",
    ),
)


def replays(*, is_whole_hour: bool) -> Part:
    """Return the part of the report on replays."""
    frames = replay_speed.HOUR_FRAMES if is_whole_hour else replay_speed.TENTH_FRAMES
    rows = replay_speed.measure_all(frames=frames)
    facts = {f"replay {row.rules} s": row.hour_s for row in rows if row.what == "journal"}
    return Part(title="An hour replayed", text=replay_speed.markdown(rows) + "\n", facts=facts)


def jobs(*, is_whole_hour: bool) -> dict[str, Callable[[], Part]]:
    """Return the parts by name, in the order of the report."""
    return {
        "policies": lambda: rule_policies.run(rule_policies.RUNS, draw.REPORT_SEEDS.start),
        "raises": lambda: false_raises.run(false_raises.MINUTES, draw.REPORT_SEEDS.start),
        "following": lambda: following.run(following.RUNS, draw.REPORT_SEEDS.start),
        "scale": rule_scale.part,
        "replay": lambda: replays(is_whole_hour=is_whole_hour),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what was asked for.

    Args:
        arguments: What stands on the command line.

    Returns:
        0.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(jobs(is_whole_hour=False)), help="parts to run and print")
    parser.add_argument("--hour", action="store_true", help="record and replay a whole hour, not a tenth")
    asked = parser.parse_args(arguments)
    parts = [job() for name, job in jobs(is_whole_hour=asked.hour).items() if not asked.only or name in asked.only]
    text = report(parts)
    if asked.only:
        print(text)
    else:
        OUT.write_text(text, encoding="utf-8")
    return 0


def report(parts: Sequence[Part]) -> str:
    """Return the report of some parts."""
    facts: Facts = {name: value for part in parts for name, value in part.facts.items()}
    goals = table(("what", "to reach", "reached", "met"), [goal.line(facts) for goal in GOALS])
    head = (
        "# Benchmarks of rules\n\nMade by `make bench-rules`; do not edit. Random numbers are apart from those that "
        "limits and defaults were chosen by.\n\n"
        f"This run: commit {commit()}, {os.cpu_count()} cores of {platform.machine()}, Python "
        f"{platform.python_version()}, numpy {np.__version__}. Machines differ: compare times within one run only.\n"
    )
    return "\n".join([head, "## Goals\n", goals, *(f"## {part.title}\n\n{part.text}" for part in parts)])


if __name__ == "__main__":
    raise SystemExit(main())
