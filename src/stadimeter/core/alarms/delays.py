"""Delays: what an on-delay or an off-delay waits for must last throughout (ISA-18.2), apart from noise.

A delay runs from the first sample in which it is so. Samples to the contrary are forgiven as noise while they are no
more in a row, or last no longer, than the rule says; more of them start the delay over. The time of forgiven ones
counts, since they are taken for wrong. No delay ends on one.

A timer that is set back by contrary time, a leaky counter, would be no delay: 8 s near, 5 s away and 8 s near would
fulfil 10 s near. One that starts over at each contrary frame would hardly ever end under noise.
"""

from __future__ import annotations

from stadimeter.core.alarms.state import Timers
from stadimeter.core.rule import AlarmRule


def counted(
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
