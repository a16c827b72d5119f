"""Chattering: too many raises within a minute.

An alarm that was raised as often as it may within the last minute does not clear: it stays active, so it cannot be
raised again. While it chatters, each time that it would have come again counts too. It has calmed down when these and
the raises are fewer within a minute than the limit; then it clears like any other.
"""

from __future__ import annotations

from stadimeter.core.rule import ROUNDING_S

MINUTE_S = 60.0


def with_raise(raises_at_s: tuple[float, ...], most: int, now_s: float) -> tuple[float, ...]:
    """Return the times of the newest raises, as many as may be within a minute: ``most``, 0 for any number."""
    return (*raises_at_s, now_s)[-most:] if most else ()


def is_too_frequent(raises_at_s: tuple[float, ...], most: int, now_s: float) -> bool:
    """Return whether it came within the last minute as often as it may."""
    return 0 < most <= len(raises_at_s) and raises_at_s[-most] + MINUTE_S > now_s + ROUNDING_S
