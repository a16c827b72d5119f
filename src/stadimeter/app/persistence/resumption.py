"""What a run takes over from an earlier one, and how long ago that was.

Timers run on a monotonic clock, which begins anew with the computer. What was remembered in the same boot is as old as
that clock says. After another boot only the wall clock can tell, if it was right both times; if it cannot, no time has
passed: a timer may then end late, and never early. A wall clock that is set while the computer runs moves no timer.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pydantic import ConfigDict, TypeAdapter, ValidationError

from stadimeter.app.deliveries import Undelivered
from stadimeter.app.wall_time import is_synchronised
from stadimeter.core.decide import State
from stadimeter.core.persistence import Absence, AlarmSnapshot, restored
from stadimeter.errors import StateError

STEPPED = "stepped"
"""The name of the clock of simulations and recordings: it begins at the same time in each run."""

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """A moment on the run's clock and on the wall clock.

    Attributes:
        clock: Which monotonic clock it is: that of one boot of the computer, or a stepped one.
        unix_s: On the wall clock, in seconds since 1970.
        is_synchronised: Whether the wall clock was right.
    """

    clock: str
    at_s: float
    unix_s: float
    is_synchronised: bool


def clock_name(*, is_live: bool, boot_id: Path = BOOT_ID) -> str:
    """Return the name of a run's clock.

    Args:
        is_live: Whether the run is on the computer's clock.
        boot_id: The file in which the kernel tells one boot from another.

    Returns:
        A name that no other boot has; if the kernel gives none, one that no other run has.
    """
    if not is_live:
        return STEPPED
    try:
        return boot_id.read_text(encoding="ascii").strip()
    except OSError:
        return f"unknown boot at {time.time_ns()}"


def moment(
    clock: str,
    at_s: float,
    *,
    unix_s: Callable[[], float] = time.time,
    is_right: Callable[[], bool] = is_synchronised,
) -> Moment:
    """Return this moment.

    Args:
        clock: The name of the run's clock.
        unix_s: Tells the time of the wall clock.
        is_right: Tells whether that can be believed.
    """
    return Moment(clock=clock, at_s=at_s, unix_s=unix_s(), is_synchronised=is_right())


def elapsed_s(before: Moment, now: Moment) -> float:
    """Return how much time has passed between two moments.

    Returns:
        In seconds, never below 0; 0 if nobody can tell.
    """
    if before.clock == now.clock:
        return max(0.0, now.at_s - before.at_s)
    if before.is_synchronised and now.is_synchronised:
        return max(0.0, now.unix_s - before.unix_s)
    return 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Memory:
    """What alarms remembered, and when.

    Attributes:
        absent: Which targets were out of sight.
        undelivered: What other programs and people had not got yet, oldest first.
    """

    moment: Moment
    alarms: tuple[AlarmSnapshot, ...]
    absent: tuple[Absence, ...] = ()
    undelivered: tuple[Undelivered, ...] = ()


def upgraded(memory: str) -> str:
    """Return what an alarm remembered, as JSON, with the keys of this version. `Phase` knows its old values itself."""
    return memory.replace('"gates":', '"inhibits":')


@dataclass(frozen=True, slots=True, kw_only=True)
class Resumption:
    """What a run takes over from an earlier one.

    Attributes:
        alarms: What each alarm remembered, its times on the earlier run's clock.
        shift_s: What to add to these times.
        from_s: As of when the alarms remembered it, on the new run's clock.
        now_s: The beginning of the new run, on its clock.
        absent: Which targets were out of sight.
    """

    alarms: tuple[AlarmSnapshot, ...]
    shift_s: float
    from_s: float
    now_s: float
    absent: tuple[Absence, ...] = ()

    def of(self, state: State) -> State:
        """Return the state with which to begin.

        Args:
            state: The state of a run that has not begun.

        Returns:
            The same, with alarms that remember.
        """
        return restored(state, self.alarms, self.absent, shift_s=self.shift_s, from_s=self.from_s, now_s=self.now_s)

    def text(self) -> str:
        """Return it as text, for a recording."""
        return _ONE.dump_json((self,)).decode()


_ONE: TypeAdapter[tuple[Resumption]] = TypeAdapter(tuple[Resumption], config=ConfigDict(ser_json_inf_nan="constants"))
"""A configuration can be given for a tuple, and not for a dataclass."""


def resumption_at(now: Moment, memory: Memory) -> Resumption:
    """Return what a run takes over that begins now.

    Returns:
        It, as if the alarms had gone on in between.
    """
    from_s = now.at_s - elapsed_s(memory.moment, now)
    shift_s = from_s - memory.moment.at_s
    return Resumption(alarms=memory.alarms, absent=memory.absent, shift_s=shift_s, from_s=from_s, now_s=now.at_s)


def read_resumption(text: str) -> Resumption:
    """Read what was taken over.

    Raises:
        StateError: The text is something else.
    """
    try:
        return _ONE.validate_json(upgraded(text))[0]
    except ValidationError as error:
        raise StateError(f"not what a run restores from another: {error.errors()[0]['msg']}") from error
