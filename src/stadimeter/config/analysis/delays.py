"""How long a rule waits before it acts."""

from __future__ import annotations

from stadimeter.config.draft import Draft
from stadimeter.core.rule import AlarmRule

ASSUMED_RATE_HZ = 15.0
"""Frames in a second where the camera does not say: what a small computer manages."""


def delay_s(alarm: AlarmRule, rate_hz: float) -> float:
    """Return how long a condition must hold before an alarm is raised.

    Returns:
        Seconds, at the longest if every frame agrees.
    """
    return alarm.on_delay.frames / rate_hz if alarm.on_delay.frames else alarm.on_delay.hold_s


def frame_rate_hz(draft: Draft) -> float:
    """Return how many frames the camera gives in a second.

    Returns:
        The rate that the camera was asked for, or else `ASSUMED_RATE_HZ`.
    """
    rate_hz = getattr(draft.camera.options, "rate", None) if draft.camera else None
    return rate_hz if isinstance(rate_hz, float) and rate_hz > 0 else ASSUMED_RATE_HZ
