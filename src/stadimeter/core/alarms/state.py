"""The memory of an alarm beside its state: timers, inhibits, steps, settings. Times are on the run's clock.

What an on-delay or an off-delay waits for must last throughout (ISA-18.2), apart from noise. A delay runs from the
first sample in which it is so. Samples to the contrary are forgiven as noise while they are no more in a row, or last
no longer, than the rule says; more of them start the delay over. The time of forgiven ones counts, since they are taken
for wrong. No delay ends on one.

A timer that is set back by contrary time, a leaky counter, would be no delay: 8 s near, 5 s away and 8 s near would
fulfil 10 s near. One that starts over at each contrary frame would hardly ever end under noise.

Chattering: an alarm that was raised as often as it may within the last minute does not clear: it stays active, so it
cannot be raised again. While it chatters, each time that it would have come again counts too. It has calmed down when
these and the raises are fewer within a minute than the limit; then it clears like any other.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

from msgspec import Struct

from stadimeter.core.decision import Event
from stadimeter.core.rule import ROUNDING_S, AlarmRule

MINUTE_S = 60.0


class Sample(NamedTuple):
    """A sample that is judged in a cycle."""

    at_s: float
    """The capture time of the frame that is new; for what is judged in every cycle, the time of the cycle."""
    since_s: float
    """How long after the frame before, or the cycle before, that is; 0 for the first."""


class Timers(Struct):
    """For how long the condition has held, or has not.

    A value: made anew for each sample, and never changed. It is not frozen, since that makes it three times as dear.
    """

    held_s: float = 0.0
    """For how long it has held, while the alarm is not active; noise to the contrary that was forgiven included."""
    ended_s: float = 0.0
    """For how long it has not held, while the alarm is active; noise to the contrary that was forgiven included."""
    contrary_samples: int = 0
    """How many of the newest samples, in a row, were to the contrary of what is counted, and are forgiven so far."""
    contrary_s: float = 0.0
    """How long before the newest of them the last sample was that was not to the contrary."""
    recent: tuple[bool, ...] = ()
    """Whether it held in each of the newest frames, oldest first."""
    held_last: bool = False
    """Whether it held in the newest sample; only the time between two samples that both held counts."""
    was_judged: bool = False
    """Whether the newest sample was judged; only the time between two samples that both were counts."""
    leaves: tuple[bool, ...] = ()
    """Whether each part of a condition that has parts held in the newest sample."""

    @property
    def is_running(self) -> bool:
        """True if anything has been counted."""
        return bool(self.held_s or self.ended_s or self.recent or self.held_last)


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
    """Check whether it came within the last minute as often as it may."""
    return 0 < most <= len(raises_at_s) and raises_at_s[-most] + MINUTE_S > now_s + ROUNDING_S


class Inhibits(Struct, frozen=True, kw_only=True):
    """The things that keep an alarm quiet."""

    shelved_until_s: float | None = None
    """On the run's clock; None if it is not shelved."""
    is_one_shot: bool = False
    """Shelving ends as soon as the alarm has returned to normal."""
    shelved_by: str = ""
    is_out_of_service: bool = False
    is_observed: bool = False
    """An operator has let it be observed only; what its rule is judged with says so too."""
    is_suppressed: bool = False
    """Suppressed by design: the condition `suppress_when` holds."""
    leaves: tuple[bool, ...] = ()
    """Whether each part of that condition held in the newest sample."""

    def words(self) -> tuple[str, ...]:
        """Name what keeps the alarm quiet, such as ``("shelved",)``; empty for nothing."""
        found = (
            ("shelved", self.shelved_until_s is not None),
            ("suppressed", self.is_suppressed),
            ("out of service", self.is_out_of_service),
        )
        return tuple([word for word, applies in found if applies])


class Acknowledgement(Struct, frozen=True, kw_only=True):
    """The person who has acknowledged an alarm, when on the run's clock, and why."""

    at_s: float
    by: str = ""
    why: str = ""


class SetThreshold(Struct, frozen=True, kw_only=True):
    """A threshold that an operator has set, in the SI unit.

    Attributes:
        key: What it is called among those of the rule; see `stadimeter.core.alarms.machine.thresholds_of`.
        configured: What the configuration says in place of it.
        at_s: When it was set, on the run's clock.
    """

    key: str
    value: float
    configured: float
    unit: str
    at_s: float
    by: str = ""


class Leg(Struct, frozen=True, kw_only=True):
    """The steps that an alarm goes through since it was raised, reported again or cleared."""

    on: Literal["raised", "cleared"]
    began_s: float
    event: Event
    """What began it."""
    sent: tuple[int, ...] = ()
    """The positions of the steps that were sent, or whose condition was judged."""
    left_out: tuple[int, ...] = ()
    """The positions of the steps on outputs whose condition did not hold when they were due."""


class Resumed(Struct, frozen=True, kw_only=True):
    """An alarm that goes on from an earlier run, and was not judged yet in this one."""

    from_s: float
    """As of when its timers are right, on this run's clock."""
    at_s: float
    """When this run restored it."""


NO_INHIBITS = Inhibits()
