"""What a run takes over from an earlier one, and how long ago that was.

Timers run on a monotonic clock, which begins anew with the computer. What was remembered in the same boot is as old as
that clock says. After another boot only the wall clock can tell, if it was right both times; if it cannot, no time has
passed: a timer may then end late, and never early. A wall clock that is set while the computer runs moves no timer.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

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
    """

    clock: str
    at_s: float
    unix_s: float
    is_synchronised: bool


def clock_name(*, is_live: bool, boot_id: Path = BOOT_ID) -> str:
    """Return a name for a run's clock that no other boot has; if the kernel gives none, that no other run has."""
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
    """Return this moment, by the name of the run's clock."""
    return Moment(clock=clock, at_s=at_s, unix_s=unix_s(), is_synchronised=is_right())


def elapsed_s(before: Moment, now: Moment) -> float:
    """Return the time between two moments, never below 0; 0 if it cannot be known."""
    if before.clock == now.clock:
        return max(0.0, now.at_s - before.at_s)
    if before.is_synchronised and now.is_synchronised:
        return max(0.0, now.unix_s - before.unix_s)
    return 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Memory:
    """What a run remembered, and when.

    Attributes:
        absent: Which targets were out of sight.
        undelivered: What was not delivered, oldest first.
        stopped: Who had stopped every output, and why, in words; empty if nobody had.
    """

    moment: Moment
    alarms: tuple[AlarmSnapshot, ...]
    absent: tuple[Absence, ...] = ()
    undelivered: tuple[Undelivered, ...] = ()
    stopped: str = ""


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
        stopped: Who had stopped every output, and why, in words; empty if nobody had.
    """

    alarms: tuple[AlarmSnapshot, ...]
    shift_s: float
    from_s: float
    now_s: float
    absent: tuple[Absence, ...] = ()
    stopped: str = ""

    def of(self, state: State) -> State:
        """Return the state with which to begin: that of a run that has not begun, with alarms that remember."""
        begun = replace(state, stopped=self.stopped)
        return restored(begun, self.alarms, self.absent, shift_s=self.shift_s, from_s=self.from_s, now_s=self.now_s)

    def text(self) -> str:
        """Return it as text, for a recording."""
        return _ONE.dump_json((self,)).decode()


_ONE: TypeAdapter[tuple[Resumption]] = TypeAdapter(tuple[Resumption], config=ConfigDict(ser_json_inf_nan="constants"))
"""A configuration can be given for a tuple, and not for a dataclass."""


def resumption_at(now: Moment, memory: Memory) -> Resumption:
    """Return what a run restores that begins now, as if the alarms had gone on in between."""
    from_s = now.at_s - elapsed_s(memory.moment, now)
    shift_s = from_s - memory.moment.at_s
    return Resumption(
        alarms=memory.alarms,
        absent=memory.absent,
        stopped=memory.stopped,
        shift_s=shift_s,
        from_s=from_s,
        now_s=now.at_s,
    )


class Restored(Protocol):
    """What a recording restores before its first cycle."""

    def of(self, state: State) -> State:
        """Return the state with which it begins, given that of a run that has not begun."""
        ...


def read_resumption(text: str) -> Restored:
    """Read what was restored; `StateError` if the text is something else."""
    from stadimeter.app.persistence.continuation import BEGINS, read_continuation  # noqa: PLC0415 - no run needs it

    if text.startswith(BEGINS):
        return read_continuation(text)
    try:
        return _ONE.validate_json(upgraded(text))[0]
    except ValidationError as error:
        raise StateError(f"not what a run restores from another: {error.errors()[0]['msg']}") from error
