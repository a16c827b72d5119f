"""What a run restores from an earlier one, and how long ago that was.

Timers run on a monotonic clock, which begins anew with the computer. What was remembered in the same boot is as old as
that clock says. After another boot only the wall clock can tell, if it was right both times; if it cannot, no time has
passed: a timer may then end late, and never early. A wall clock that is set while the computer runs moves no timer.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from pydantic import ConfigDict, TypeAdapter, ValidationError

from stadimeter.app.deliveries import Undelivered
from stadimeter.app.wall_time import is_synchronised
from stadimeter.core.alarms.alarm import AlarmStep
from stadimeter.core.decide import State
from stadimeter.core.decision import Event
from stadimeter.core.holding import Hold
from stadimeter.core.observation import OutputFault
from stadimeter.core.outputs import OutputStep
from stadimeter.core.persistence import Absence, AlarmSnapshot, meaning_of, restore_alarms
from stadimeter.core.rule import AnyRule
from stadimeter.core.rules.follow import FollowStep
from stadimeter.core.rules.ramp import RampStep
from stadimeter.core.rules.scheduler import RuleStep, with_steps
from stadimeter.core.safety import SafetyState
from stadimeter.core.tracking.life_cycle import TrackState
from stadimeter.errors import StateError

# The name of the clock of simulations and recordings: it begins at the same time in each run.
STEPPED = "stepped"

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockReading:
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
) -> ClockReading:
    """Return this moment, by the name of the run's clock."""
    return ClockReading(clock=clock, at_s=at_s, unix_s=unix_s(), is_synchronised=is_right())


def elapsed_s(before: ClockReading, now: ClockReading) -> float:
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
        stopped: Who had stopped every output, and why, in words; empty if they were not stopped.
    """

    moment: ClockReading
    alarms: tuple[AlarmSnapshot, ...]
    absent: tuple[Absence, ...] = ()
    undelivered: tuple[Undelivered, ...] = ()
    stopped: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Resumption:
    """What a run restores from an earlier one.

    Attributes:
        alarms: What each alarm remembered, its times on the earlier run's clock.
        shift_s: What to add to these times.
        from_s: As of when the alarms remembered it, on the new run's clock.
        now_s: The beginning of the new run, on its clock.
        absent: Which targets were out of sight.
        stopped: Who had stopped every output, and why, in words; empty if they were not stopped.
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
        return restore_alarms(
            begun, self.alarms, self.absent, shift_s=self.shift_s, from_s=self.from_s, now_s=self.now_s
        )

    def text(self) -> str:
        """Return it as text, for a recording."""
        return _RESUMPTION.dump_json((self,)).decode()


# pydantic takes a configuration for a tuple, and not for a dataclass: each adapter is of a tuple with one element.
_CONFIG = ConfigDict(ser_json_inf_nan="constants", defer_build=True)

_RESUMPTION: TypeAdapter[tuple[Resumption]] = TypeAdapter(tuple[Resumption], config=_CONFIG)


def resumption_at(now: ClockReading, memory: Memory) -> Resumption:
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


# How the JSON of a `Continuation` begins, and that of a `Resumption` does not.
CONTINUATION_BEGINS = '[{"continued":'


@dataclass(frozen=True, slots=True, kw_only=True)
class _RuleMemory:
    """What a rule remembers. By `meaning` it is known whether a rule of that name is still the same."""

    rule: str
    meaning: str
    alarm: AlarmStep | None = None
    ramp: RampStep | None = None
    follow: FollowStep | None = None

    @classmethod
    def of(cls, rule: AnyRule, step: RuleStep) -> _RuleMemory:
        """Return what a rule remembers."""
        memory = cls(rule=rule.name, meaning=meaning_of(rule))
        match step:
            case AlarmStep():
                return replace(memory, alarm=step)
            case RampStep():
                return replace(memory, ramp=step)
            case _:
                return replace(memory, follow=step)

    def step(self, rule: AnyRule) -> RuleStep | None:
        """Return it for a rule that means the same; None for any other."""
        return (self.alarm or self.ramp or self.follow) if self.meaning == meaning_of(rule) else None


@dataclass(frozen=True, slots=True, kw_only=True)
class _RunState:
    """All that is remembered from one cycle to the next, without the plan."""

    now_s: float | None
    usual_step_s: float
    tracks: tuple[TrackState, ...]
    rules: tuple[_RuleMemory, ...]
    first_out: Mapping[str, str]
    safety: SafetyState
    outputs: tuple[OutputStep, ...]
    faults: tuple[OutputFault, ...]
    events: int
    due: tuple[Event, ...]
    holds: tuple[Hold, ...]
    stopped: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Continuation:
    """What a recording restores that was begun in mid-course."""

    continued: _RunState

    def of(self, state: State) -> State:
        """Return the state with which to go on. What the plan has otherwise by now begins anew."""
        was, plan = self.continued, state.plan
        known = {memory.rule: memory for memory in was.rules}
        steps = tuple(
            (known[rule.name].step(rule) or new) if rule.name in known else new
            for rule, new in zip(plan.rules, state.rules.steps, strict=True)
        )
        tracks = {tracked.track.target: tracked for tracked in was.tracks}
        outputs = {step.command.output: step for step in was.outputs}
        names = {rule.name for rule in plan.rules}
        return replace(
            state,
            now_s=was.now_s,
            usual_step_s=was.usual_step_s,
            tracks=tuple(tracks.get(new.track.target, new) for new in state.tracks),
            rules=with_steps(plan, steps, {group: name for group, name in was.first_out.items() if name in names}),
            safety=was.safety,
            outputs=tuple(_like(outputs.get(new.command.output), new) for new in state.outputs),
            faults=was.faults,
            events=was.events,
            due=was.due,
            holds=was.holds,
            stopped=was.stopped,
        )


def _like(was: OutputStep | None, new: OutputStep) -> OutputStep:
    return was if was is not None and type(was.command) is type(new.command) else new


_CONTINUATION: TypeAdapter[tuple[Continuation]] = TypeAdapter(tuple[Continuation], config=_CONFIG)


def continuation_text(state: State) -> str:
    """Return the state of a run as text, for a recording."""
    run = _RunState(
        now_s=state.now_s,
        usual_step_s=state.usual_step_s,
        tracks=state.tracks,
        rules=tuple(_RuleMemory.of(rule, step) for rule, step in zip(state.plan.rules, state.rules.steps, strict=True)),
        first_out=state.rules.first_out,
        safety=state.safety,
        outputs=state.outputs,
        faults=state.faults,
        events=state.events,
        due=state.due,
        holds=state.holds,
        stopped=state.stopped,
    )
    return _CONTINUATION.dump_json((Continuation(continued=run),)).decode()


def read_resumption(text: str) -> Restored:
    """Read what a recording restores; `StateError` if the text is something else."""
    try:
        return (_CONTINUATION if text.startswith(CONTINUATION_BEGINS) else _RESUMPTION).validate_json(text)[0]
    except ValidationError as error:
        raise StateError(f"not the state of a run: {error.errors()[0]['msg']}") from error
