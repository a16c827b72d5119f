"""Durations in words: the one place that chooses between seconds, minutes and hours."""

from __future__ import annotations

import math

_LONG_UNITS = (("h", 3600.0), ("min", 60.0))


def duration(seconds: float) -> str:
    """Return a duration in the largest unit that leaves it whole, such as ``0.2 s``, ``90 s`` or ``8 h``."""
    for unit, unit_s in _LONG_UNITS:
        if seconds >= unit_s and seconds % unit_s == 0:
            return f"{seconds / unit_s:g} {unit}"
    return f"{seconds:g} s"


def rounded_duration(seconds: float) -> str:
    """Return a measured duration, rounded as people read it: ``0.2 s``, ``12.5 min``, ``8 h``; ``ever`` for infinity.

    Less than nothing counts as nothing: a timer that is due may be looked at a moment later.
    """
    if not math.isfinite(seconds):
        return "ever"
    for unit, unit_s in _LONG_UNITS:
        if seconds >= 2 * unit_s:
            figure = seconds / unit_s
            return f"{figure:.3g} {unit}" if figure < 999.5 else f"{figure:.0f} {unit}"
    return f"{max(0.0, seconds):.1f} s"
