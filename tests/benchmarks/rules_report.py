"""Measures rules on noise: false raises, lateness, following. Writes a report: ``make bench-rules``.

``python tests/benchmarks/rules_report.py --only raises`` runs a part and prints it.
"""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Callable, Sequence
from pathlib import Path

import closing_speeds
import false_raises
import following
import numpy as np
import rule_policies
from goal import Facts, Goal, at_most, percent, plain
from part import Part, commit, table

from support.scenes import draw

OUT = Path(__file__).resolve().parents[2] / "docs" / "benchmarks" / "rules.md"


HELD = {"68 %": (0.63, 0.74), "90 %": (0.86, 0.94)}
"""Of the true distances, these intervals are to hold such a share."""

GOALS = (
    at_most(
        "hovering at the limit, 2 m / 8 m: raised or cleared a minute",
        "≤ 1.0 both",
        plain(2),
        {"rules hover 2 m": 1.0, "rules hover 8 m": 1.0},
    ),
    at_most(
        "standing 3 σ behind it: raised for nothing, a minute",
        "≤ 0.05 both",
        plain(3),
        {"rules false 2 m": 0.05, "rules false 8 m": 0.05},
    ),
    at_most(
        "the same over 200 minutes at 8 m: white / correlated / heavy tails / outliers",
        "≤ 0.05 each",
        plain(3),
        {f"rules raises {kind}": 0.05 for kind in false_raises.JUDGED},
    ),
    at_most(
        "upper end of the 95 % interval of that",
        "≤ 0.1 each",
        plain(3),
        {f"rules raises at most {kind}": 0.1 for kind in false_raises.JUDGED},
    ),
    *(
        Goal(
            f"resting, walking, coming, swaying at {at_m:g} m: {of} interval holds",
            f"{100 * least:.0f}–{100 * most:.0f} % each",
            percent,
            {f"follow {way} {at_m:g} m {of}": (least, most) for way in following.WAYS},
        )
        for at_m in following.AT_M
        for of, (least, most) in HELD.items()
    ),
    at_most(
        "a leap, 10 / 15 frames a second: how late",
        "≤ 0.2 s",
        plain(3, "s"),
        {"leap late 10 Hz": 0.2, "leap late 15 Hz": 0.2},
    ),
    at_most(
        "coming at 2 m/s: how late, on average",
        "≤ 0.1 s both",
        plain(3, "s"),
        {"rules late 2 m": 0.1, "rules late 8 m": 0.1},
    ),
)


JOBS: dict[str, Callable[[], Part]] = {
    "policies": lambda: rule_policies.run(rule_policies.RUNS, draw.REPORT_SEEDS.start),
    "speeds": lambda: closing_speeds.run(closing_speeds.RUNS, draw.REPORT_SEEDS.start),
    "raises": lambda: false_raises.run(false_raises.MINUTES, draw.REPORT_SEEDS.start),
    "following": lambda: following.run(following.RUNS, draw.REPORT_SEEDS.start),
}
"""The parts by name, in the order of the report."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what was asked for.

    Args:
        arguments: What stands on the command line.

    Returns:
        0.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(JOBS), help="parts to run and print")
    asked = parser.parse_args(arguments)
    parts = [job() for name, job in JOBS.items() if not asked.only or name in asked.only]
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
