"""What a run has beside its cycles: a memory beyond its end, an ear for people, and a clock on the wall."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from stadimeter.app.cycle_record import CycleRecord
from stadimeter.app.wall_time import TimeOfDay, goes_by_the_clock
from stadimeter.core.decide import State, initial_state
from stadimeter.core.observation import WallTime
from stadimeter.core.operator import AnyCommand
from stadimeter.core.plan import Plan

if TYPE_CHECKING:  # few runs have these, and what they need takes long to load
    from stadimeter.app.control.alarm_list import AlarmList
    from stadimeter.app.control.recording import RecordingOnRequest
    from stadimeter.app.control.reloading import Change
    from stadimeter.app.control.requests import Control
    from stadimeter.app.control.restarting import Restarter
    from stadimeter.app.deliveries import Undelivered
    from stadimeter.app.persistence.state_writer import StateWriter
    from stadimeter.app.recordings.recorded_configuration import RecordedConfiguration
    from stadimeter.app.service import Service
    from stadimeter.core.reload import ReloadedState


@runtime_checkable
class Recording(Protocol):
    """What a journal or a recording must learn, besides the cycles, to be replayed."""

    def resumed(self, text: str) -> None:
        """Take in what the run restores from an earlier one, before the first cycle."""
        ...

    def reloaded(self, now_s: float, configuration: RecordedConfiguration) -> None:
        """Take in a configuration that was reloaded, before its first cycle."""
        ...

    def trouble(self) -> str:
        """Return in words what is wrong with it; empty if nothing is."""
        ...


@dataclass(slots=True)
class Services:
    """What a run has beside its cycles. Each of them may be missing.

    `tell` takes a line that a person should read, such as what became of a damaged state file.
    """

    control: Control | None = None
    memory: StateWriter | None = None
    time_of_day: TimeOfDay | None = None
    service: Service | None = None
    alarms: AlarmList | None = None
    recording: RecordingOnRequest | None = None
    restarter: Restarter | None = None
    tell: Callable[[str], None] = lambda _words: None
    _goes_by_the_clock: bool = False

    def begin(self, plan: Plan, now_s: float, recordings: Iterable[Recording]) -> State:
        """Return the state with which a run begins: alarms remember what they did in an earlier one."""
        self._goes_by_the_clock = goes_by_the_clock(plan)
        state = initial_state(plan)
        if self.memory is None:
            return state
        resumption = self.memory.begin(now_s)
        if self.memory.warning:
            self.tell(f"warning: {self.memory.warning}")
        if resumption is None:
            return state
        for recording in recordings:
            recording.resumed(resumption.text())
        return resumption.of(state)

    def operator_commands(self) -> tuple[AnyCommand, ...]:
        """Attend to what was asked since the last cycle; return what operators want of rules. Never waits."""
        return self.control.operator_commands() if self.control is not None else ()

    def change(self) -> Change | None:
        """Return the configuration to apply before the next cycle, if there is one."""
        return self.control.change() if self.control is not None else None

    def reloaded(self, state: State, change: Change) -> ReloadedState:
        """Let a run go on with a changed configuration."""
        from stadimeter.core.reload import reload  # noqa: PLC0415 - few runs are reloaded

        if self.service is not None:
            self.service.reloading()
        plan = change.configuration.plan
        taken = reload(state, plan)
        self._goes_by_the_clock = goes_by_the_clock(plan)
        if self.memory is not None:
            self.memory.keep(taken.state)
        return taken

    def answer_reload(self, change: Change, taken: ReloadedState) -> None:
        """Answer whoever asked that a configuration was reloaded, by all parts."""
        if self.service is not None:
            self.service.reloaded()
        if self.control is not None:
            self.control.changed(change, taken)

    def reload(self) -> bool:
        """Have the configuration read again before the next cycle; return whether this run can. Never waits."""
        if self.control is None:
            return False
        self.control.reload(self.tell)
        return True

    def wall(self, now_s: float) -> WallTime | None:
        """Return the local time of day, if a rule goes by it and it is known to be right."""
        return self.time_of_day.at(now_s) if self.time_of_day is not None and self._goes_by_the_clock else None

    def cycle(self, before: State, after: State, record: CycleRecord) -> None:
        """Take in a cycle, after its messages are on their way. Waits a hundredth of a second at most, for an alarm."""
        if self.memory is not None:
            self.memory.cycle(before, after, record.decision.events)
        if self.alarms is not None:
            self.alarms.cycle(after, record)
        if self.control is not None:
            self.control.heard(record)

    def is_kept(self) -> bool | None:
        """Return whether what is remembered is in the file already; None if nothing outlives the run."""
        return None if self.memory is None else self.memory.is_kept()

    def trouble(self) -> str:
        """Return what is wrong with them, in words; empty if nothing is."""
        return self.memory.trouble() if self.memory is not None else ""

    @property
    def is_restart_due(self) -> bool:
        """Whether somebody wants the program to begin anew, and it can."""
        return self.restarter is not None and self.restarter.is_due

    def cancel_restart(self) -> None:
        """Let the run end for good: that was asked for, too."""
        if self.restarter is not None:
            self.restarter.cancel()

    def stopping(self) -> None:
        """Take in that the run ends, or begins anew, and its outputs were stopped."""
        if self.service is None:
            return
        if self.is_restart_due:
            self.service.restarting()
        else:
            self.service.stopping()

    def keep(self, state: State) -> None:
        """Keep what is remembered, as soon as the disk can. Never waits for it."""
        if self.memory is not None:
            self.memory.keep(state)

    def kept(self) -> tuple[Undelivered, ...]:
        """Return what is kept, for the next run, of what nobody got."""
        return self.memory.kept if self.memory is not None else ()

    def end(self, state: State) -> str:
        """Keep what is remembered at the end of the run, and what was not delivered; return what went wrong."""
        return self.memory.end(state) if self.memory is not None else ""
