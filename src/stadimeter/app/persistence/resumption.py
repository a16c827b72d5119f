"""The things a run restores from an earlier one, and how long ago that was.

Timers run on a monotonic clock, which begins anew with the computer. What was remembered in the same boot is as old as
that clock says. After another boot only the wall clock can tell, if it was right both times; if it cannot, no time has
passed: a timer may then end late, and never early. A wall clock that is set while the computer runs moves no timer.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.app.clock import is_synchronised
from stadimeter.app.deliveries import Undelivered
from stadimeter.app.exact_json import decode, encode
from stadimeter.core.alarms.alarm import AlarmStep
from stadimeter.core.conditions.remembered import Summary
from stadimeter.core.decide import State
from stadimeter.core.decision import Event
from stadimeter.core.holding import Hold
from stadimeter.core.liveness import LivenessState
from stadimeter.core.observation import OutputFault
from stadimeter.core.outputs import OutputStep
from stadimeter.core.persistence import Absence, AlarmSnapshot, meaning_of, restore_alarms
from stadimeter.core.rule import AnyRule, Step
from stadimeter.core.rules.follow import FollowStep
from stadimeter.core.rules.ramp import RampStep, ReportStep
from stadimeter.core.rules.scheduler import with_steps
from stadimeter.core.safety import SafetyState
from stadimeter.core.tracking.life_cycle import TrackState
from stadimeter.core.tracking.transverse import TransverseMotion, motions_for
from stadimeter.errors import StateError

# The name of the clock of simulations and recordings: it begins at the same time in each run.
STEPPED = "stepped"

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


class ClockReading(Struct, frozen=True, kw_only=True):
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
    clock: str, at_s: float, *, unix_s: Callable[[], float] = time.time, is_right: Callable[[], bool] = is_synchronised
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


def shift_s(before: ClockReading, now: ClockReading) -> float:
    """Return the time to be added to a time of an earlier run, so that it is one of this run."""
    return now.at_s - elapsed_s(before, now) - before.at_s


class Memory(Struct, frozen=True, kw_only=True):
    """The memory of a run, and the moment it is of.

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


def resume(state: State, memory: Memory, now: ClockReading) -> State:
    """Return the state with which a run begins, as if the alarms had gone on since they were remembered.

    Args:
        state: That of a run that has not begun.
    """
    begun = replace(state, stopped=memory.stopped)
    moved_s = shift_s(memory.moment, now)
    from_s = memory.moment.at_s + moved_s
    return restore_alarms(begun, memory.alarms, memory.absent, shift_s=moved_s, from_s=from_s, now_s=now.at_s)


class _RuleMemory(Struct, frozen=True, kw_only=True):
    """The memory of a rule. By `meaning` it is known whether a rule of that name is still the same."""

    rule: str
    meaning: str
    alarm: AlarmStep | None = None
    ramp: RampStep | None = None
    follow: FollowStep | None = None
    report: ReportStep | None = None

    @classmethod
    def of(cls, rule: AnyRule, step: Step) -> _RuleMemory:
        """Return the memory of a rule."""
        kinds = {AlarmStep: "alarm", RampStep: "ramp", FollowStep: "follow", ReportStep: "report"}
        remembered: Any = {kinds[type(step)]: step}
        return cls(rule=rule.name, meaning=meaning_of(rule), **remembered)

    def step(self, rule: AnyRule) -> Step | None:
        """Return it for a rule that means the same; None for any other."""
        return (self.alarm or self.ramp or self.follow or self.report) if self.meaning == meaning_of(rule) else None


class _RunState(Struct, frozen=True, kw_only=True):
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
    disagreeing: frozenset[str] = frozenset()
    disarmed: str = ""
    liveness: LivenessState = field(default_factory=LivenessState)
    motions: tuple[TransverseMotion, ...] = ()
    raised_at_s: Mapping[str, float] = field(default_factory=dict)
    figures: Mapping[str, Summary] = field(default_factory=dict)
    is_mounting_unconfirmed: bool = False


# What is written as it is in a state: all but the plan and what goes by its rules and figures.
_AS_IT_IS = tuple(
    name for name in _RunState.__struct_fields__ if hasattr(State, name) and name not in {"rules", "figures"}
)


def state_text(state: State) -> str:
    """Return the state of a run as text, for a recording that begins with it."""
    run = _RunState(
        **{name: getattr(state, name) for name in _AS_IT_IS},
        rules=tuple(_RuleMemory.of(rule, step) for rule, step in zip(state.plan.rules, state.rules.steps, strict=True)),
        first_out=state.rules.first_out,
        raised_at_s=state.rules.raised_at_s,
        figures={meaning_of(each): kept for each, kept in zip(state.plan.figures, state.figures, strict=True)},
    )
    return encode(run).decode()


def read_state(text: str, state: State) -> State:
    """Return the state with which a recording begins. What the plan has otherwise by now begins anew.

    Args:
        text: From `state_text`.
        state: That of a run that has not begun.

    Raises:
        StateError: The text is something else.
    """
    try:
        was = decode(text, _RunState)
    except ValueError as error:
        raise StateError(f"not the state of a run: {error}") from error
    plan = state.plan
    known = {memory.rule: memory for memory in was.rules}
    steps = tuple(
        (known[rule.name].step(rule) or new) if rule.name in known else new
        for rule, new in zip(plan.rules, state.rules.steps, strict=True)
    )
    tracks = {tracked.track.target: tracked for tracked in was.tracks}
    outputs = {step.command.output: step for step in was.outputs}
    names = {rule.name for rule in plan.rules}
    first_out = {group: name for group, name in was.first_out.items() if name in names}
    rules = with_steps(plan, steps, first_out, was.raised_at_s)
    by_plan: dict[str, Any] = {
        "tracks": tuple(tracks.get(new.track.target, new) for new in state.tracks),
        "rules": rules,
        "outputs": tuple(_like(outputs.get(new.command.output), new) for new in state.outputs),
        "motions": motions_for(rules.layout.motions, was.motions),
        "figures": tuple(was.figures.get(meaning_of(figure), Summary()) for figure in plan.figures),
    }
    return replace(state, **{name: getattr(was, name) for name in _AS_IT_IS} | by_plan)


def _like(was: OutputStep | None, new: OutputStep) -> OutputStep:
    return was if was is not None and type(was.command) is type(new.command) else new
