"""What a run came to, for a program and for a person."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from stadimeter.app.health import Health, percentile


def summarise(health: Health, ending: str) -> dict[str, Any]:
    """Return the figures of a run.

    Args:
        health: The figures.
        ending: Why it ended.

    Returns:
        What ``run --json`` prints: counts, and times in milliseconds.
    """
    return {
        "ended": ending,
        "cycles": health.cycles,
        "frames": health.frames,
        "tracks": {target: dict(counts) for target, counts in health.track_statuses.items()},
        "events": dict(health.events),
        "data_age_ms": _milliseconds(health.data_ages_s),
        "cycle_ms": _milliseconds(health.cycle_times_s),
    }


def in_words(summary: dict[str, Any]) -> str:
    """Return the figures of a run as a few lines.

    Args:
        summary: What `summarise` returned.

    Returns:
        The lines.
    """
    lines = [f"Ended: {summary['ended'] or 'unknown'}. {summary['frames']} frames in {summary['cycles']} cycles."]
    for target, counts in summary["tracks"].items():
        lines.append(f"{target}: {_listed(counts)}.")
    if summary["events"]:
        lines.append(f"Events: {_listed(summary['events'])}.")
    if summary["cycle_ms"]["p50"] is not None:
        lines.append(
            f"Work in a cycle: {summary['cycle_ms']['p50']:.1f} ms in the middle, 95 in 100 below "
            f"{summary['cycle_ms']['p95']:.1f} ms."
        )
    return "\n".join(lines)


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in counts.items())


def _milliseconds(seconds: Iterable[float]) -> dict[str, float | None]:
    ordered = sorted(seconds)
    return {name: _rounded_ms(percentile(ordered, share)) for name, share in (("p50", 0.5), ("p95", 0.95))}


def _rounded_ms(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds * 1000, 3)
