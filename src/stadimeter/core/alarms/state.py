"""What an alarm remembers beside its phase: timers, inhibits, steps. Times are on the run's clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

from stadimeter.core.decision import Event


class Sample(NamedTuple):
    """What is judged in a cycle."""

    at_s: float
    """The capture time of the frame that is new; for what is judged in every cycle, the time of the cycle."""
    since_s: float
    """How long after the frame before, or the cycle before, that is; 0 for the first."""


@dataclass(slots=True)
class Timers:
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
        """Whether anything has been counted."""
        return bool(self.held_s or self.ended_s or self.recent or self.held_last)


@dataclass(frozen=True, slots=True, kw_only=True)
class Inhibits:
    """What keeps an alarm quiet."""

    shelved_until_s: float | None = None
    """On the run's clock; None if it is not shelved."""
    is_one_shot: bool = False
    """Shelving ends as soon as the alarm has returned to normal."""
    shelved_by: str = ""
    is_out_of_service: bool = False
    is_suppressed: bool = False
    """Suppressed by design: the condition `suppress_when` holds."""
    leaves: tuple[bool, ...] = ()
    """Whether each part of that condition held in the newest sample."""

    def words(self) -> tuple[str, ...]:
        """Return what keeps the alarm quiet, such as ``("shelved",)``; empty for nothing."""
        found = (
            ("shelved", self.shelved_until_s is not None),
            ("suppressed", self.is_suppressed),
            ("out of service", self.is_out_of_service),
        )
        return tuple([word for word, applies in found if applies])


@dataclass(frozen=True, slots=True, kw_only=True)
class Acknowledgement:
    """Who has acknowledged an alarm, when on the run's clock, and why."""

    at_s: float
    by: str = ""
    why: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Leg:
    """The steps that an alarm goes through since it was raised, reported again or cleared."""

    on: Literal["raised", "cleared"]
    began_s: float
    event: Event
    """What began it."""
    sent: tuple[int, ...] = ()
    """The positions of the steps that were sent."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Resumed:
    """An alarm that goes on from an earlier run, and was not judged yet in this one."""

    from_s: float
    """As of when its timers are right, on this run's clock."""
    at_s: float
    """When this run restored it."""


NO_INHIBITS = Inhibits()
