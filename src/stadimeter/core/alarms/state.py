"""What an alarm remembers from one cycle to the next."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from stadimeter.core.alarms.table import STANDING, UNACKNOWLEDGED, Phase
from stadimeter.core.decision import Event


@dataclass(frozen=True, slots=True, kw_only=True)
class Timers:
    """How long the condition has held, or not.

    Attributes:
        held_s: For how long it has held, on the alarm's way to being raised.
        ended_s: For how long it has not held, on the alarm's way to being cleared.
        recent: Whether it held in each of the newest frames, oldest first.
        held_last: Whether it held in the newest sample; only the time between two samples that both held counts.
        was_judged: Whether the newest sample was judged; only the time between two samples that both were counts.
        leaves: Whether each part of a condition that has parts held in the newest sample.
    """

    held_s: float = 0.0
    ended_s: float = 0.0
    recent: tuple[bool, ...] = ()
    held_last: bool = False
    was_judged: bool = False
    leaves: tuple[bool, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Gates:
    """What keeps an alarm quiet.

    Attributes:
        shelved_until_s: Until when it is shelved, on the run's clock; None if it is not.
        is_one_shot: Whether shelving ends as soon as the alarm has returned to normal.
        shelved_by: Who shelved it.
        is_out_of_service: Whether somebody took it out of service.
        is_suppressed: Whether the condition that suppresses it holds.
        leaves: Whether each part of that condition held in the newest sample.
    """

    shelved_until_s: float | None = None
    is_one_shot: bool = False
    shelved_by: str = ""
    is_out_of_service: bool = False
    is_suppressed: bool = False
    leaves: tuple[bool, ...] = ()

    def words(self) -> tuple[str, ...]:
        """Return what keeps the alarm quiet, in words; empty for nothing.

        Returns:
            Such as ``("shelved",)``.
        """
        found = (
            ("shelved", self.shelved_until_s is not None),
            ("suppressed", self.is_suppressed),
            ("out of service", self.is_out_of_service),
        )
        return tuple([word for word, applies in found if applies])


NO_GATES = Gates()
NO_TIMERS = Timers()


@dataclass(frozen=True, slots=True, kw_only=True)
class Leg:
    """What an alarm does one thing after another, since it was raised, reported again or cleared.

    Attributes:
        on: Which steps of its sequence belong here.
        began_s: When it began, on the run's clock.
        event: What began it.
        sent: The positions of the steps that were sent.
    """

    on: Literal["raised", "cleared"]
    began_s: float
    event: Event
    sent: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Resumed:
    """An alarm that goes on from an earlier run, and was not judged yet in this one.

    Attributes:
        from_s: As of when its timers are right, on this run's clock.
        at_s: When this run took it over.
    """

    from_s: float
    at_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmState:
    """What an alarm remembers.

    Attributes:
        phase: Where it is.
        timers: How long its condition has held, or not.
        unknown_since_s: Since when there is nothing to judge by; None while there is.
        is_given_up: Whether the target has been away for so long that the output went to its safe value.
        held_from_start: Whether the condition has held in every sample of the run so far.
        is_announced_only: Whether it was raised by the first sight of the target, and shall not move its output.
        raised_at_s: When it was raised, on the run's clock; None while it is not active.
        reported_at_s: When it was raised or last reported again.
        notified_at_s: When people were last told of it; None for never.
        owes_notice: Whether it was raised, and people could not be told yet.
        leg: What it does one thing after another; None before it was ever raised.
        gates: What keeps it quiet.
        resumed: That it goes on from an earlier run, until it is judged first in this one.
    """

    phase: Phase = Phase.INACTIVE
    timers: Timers = NO_TIMERS
    unknown_since_s: float | None = None
    is_given_up: bool = False
    held_from_start: bool = True
    is_announced_only: bool = False
    raised_at_s: float | None = None
    reported_at_s: float | None = None
    notified_at_s: float | None = None
    owes_notice: bool = False
    leg: Leg | None = None
    gates: Gates = field(default=NO_GATES)
    resumed: Resumed | None = None

    @property
    def is_active(self) -> bool:
        """Whether it drives its output."""
        return self.phase in STANDING

    @property
    def is_acknowledged(self) -> bool:
        """Whether nobody needs to acknowledge it, or somebody has."""
        return self.phase not in UNACKNOWLEDGED
