"""Delays: what an on-delay or an off-delay waits for must last throughout (ISA-18.2), apart from noise.

A delay runs from the first sample in which it is so. Samples to the contrary are forgiven as noise while they are no
more in a row, or last no longer, than the rule says; more of them start the delay over. The time of forgiven ones
counts, since they are taken for wrong. No delay ends on one.

A timer that is set back by contrary time, a leaky counter, would be no delay: 8 s near, 5 s away and 8 s near would
fulfil 10 s near. One that starts over at each contrary frame would hardly ever end under noise.

Chattering: too many raises within a minute.

An alarm that was raised as often as it may within the last minute does not clear: it stays active, so it cannot be
raised again. While it chatters, each time that it would have come again counts too. It has calmed down when these and
the raises are fewer within a minute than the limit; then it clears like any other.
"""

from __future__ import annotations

from stadimeter.core.alarms.state import Timers
from stadimeter.core.rule import ROUNDING_S, AlarmRule

MINUTE_S = 60.0


def count_sample(
    rule: AlarmRule, before: Timers, since_s: float, holds: bool, leaves: tuple[bool, ...], *, is_active: bool
) -> Timers:
    """Return the timers after a sample: for how long the condition has held, or has ended while the alarm is active.

    Args:
        since_s: How long before it the last sample was; 0 if the time between them was not observed.
    """
    for_s = before.ended_s if is_active else before.held_s
    is_so, was_so = holds is not is_active, before.held_last is not is_active
    samples, contrary_s = (0, 0.0) if is_so else (before.contrary_samples + 1, before.contrary_s + since_s)
    if (was_so or for_s) and (is_so or rule.delay_tolerance.forgives(samples, contrary_s)):
        for_s += since_s
    else:
        for_s, samples, contrary_s = 0.0, 0, 0.0
    frames = 0 if is_active else rule.on_delay.of_frames
    recent = (*before.recent, holds)[-frames:] if frames else ()
    held_s, ended_s = (0.0, for_s) if is_active else (for_s, 0.0)
    return Timers(held_s, ended_s, samples, contrary_s, recent, holds, True, leaves)  # by position: half the time


def with_raise(raises_at_s: tuple[float, ...], most: int, now_s: float) -> tuple[float, ...]:
    """Return the times of the newest raises, as many as may be within a minute: ``most``, 0 for any number."""
    return (*raises_at_s, now_s)[-most:] if most else ()


def is_too_frequent(raises_at_s: tuple[float, ...], most: int, now_s: float) -> bool:
    """Return whether it came within the last minute as often as it may."""
    return 0 < most <= len(raises_at_s) and raises_at_s[-most] + MINUTE_S > now_s + ROUNDING_S
