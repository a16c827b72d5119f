"""Measures rules on noise: false raises, lateness, following. Writes a report: ``make bench-rules``.

``python tests/benchmarks/rules_report.py --only raises`` runs a part and prints it.
"""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import closing_speeds
import false_raises
import following
import numpy as np
import rule_policies
from goal import Facts, goals_of
from part import Part, commit, table

from support.scenes import draw

OUT = Path(__file__).resolve().parents[2] / "docs" / "benchmarks" / "rules.md"

GOALS = goals_of("goals_of_rules.toml")["rules"]

JOBS: dict[str, Callable[[int], Part]] = {
    "policies": partial(rule_policies.run, rule_policies.RUNS),
    "speeds": partial(closing_speeds.run, closing_speeds.RUNS),
    "raises": partial(false_raises.run, false_raises.MINUTES),
    "following": partial(following.run, following.RUNS),
}
"""The parts by name, in the order of the report; each takes the seed that its random numbers begin with."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what was asked for.

    Args:
        arguments: What stands on the command line.

    Returns:
        0.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(JOBS), help="parts to run and print")
    parser.add_argument("--tuning", action="store_true", help="other random numbers: those to choose defaults by")
    asked = parser.parse_args(arguments)
    if asked.tuning and not asked.only:
        parser.error("--tuning: the report is made of its own random numbers; name parts to print with --only")
    seed = (draw.TUNING_SEEDS if asked.tuning else draw.REPORT_SEEDS).start
    parts = [job(seed) for name, job in JOBS.items() if not asked.only or name in asked.only]
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
