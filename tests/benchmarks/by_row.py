"""The table that methods of measuring share: what was found of each row, how far off, and how often ± holds."""

from __future__ import annotations

from collections.abc import Sequence

from part import table
from samples import Sample, grouped, rate, summarise

GROSS = 0.05
HEAD = ("frames", "median / p95 %", "bias %", "bias px", "found %", "95 % interval holds %")


def table_by_row(what: str, samples: Sequence[Sample]) -> str:
    """Return a table with a line for each row.

    Args:
        what: The heading of the first column.
        samples: What was measured.
    """
    lines = []
    for name, of_row in grouped(samples, lambda sample: sample.row).items():
        each = summarise(of_row, GROSS)
        answered = round(each.found * each.count)
        bias = (f"{100 * each.bias:+.2f}", f"{each.bias_px:+.3f}") if answered else ("–", "–")
        shares = (rate(each.found, each.count), rate(each.coverage, answered))
        lines.append((name, str(each.count), each.percents, *bias, *shares))
    return table((what, *HEAD), lines)


def facts_by_row(part: str, samples: Sequence[Sample]) -> dict[str, float]:
    """Return the figures that goals are judged by, each named by its part and row."""
    facts = {}
    for name, of_row in grouped(samples, lambda sample: sample.row).items():
        each = summarise(of_row, GROSS)
        facts |= {f"{part} {name} {what}": getattr(each, what) for what in ("median", "bias", "found")}
        facts[f"{part} {name} held"] = each.coverage
    return facts
