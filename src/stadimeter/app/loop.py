"""The control loop: runs cycle after cycle, and stops everything on every way out."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

from msgspec import Struct

from stadimeter.app.bootstrap import EndedWhileOpening, OpenParts, Parts
from stadimeter.app.clock import TimeOfDay
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.deliveries import Deliveries
from stadimeter.app.ending import Deadline, Steps, close_side_by_side
from stadimeter.app.guard import Guard, make_all_safe, retire_all
from stadimeter.app.live.health import Board, live_health
from stadimeter.app.live.history import RunHistory
from stadimeter.app.messages import Reporter, health_figures, outgoing
from stadimeter.config.files import sha256_of
from stadimeter.core.decide import State, initial_state
from stadimeter.core.frame import Frame
from stadimeter.core.message import Message
from stadimeter.core.plan import Plan
from stadimeter.errors import EndOfFramesError
from stadimeter.messaging.protocol import Discoverable, TakesRequests

if TYPE_CHECKING:  # few runs have these, and what they need takes long to load
    from stadimeter.app.control.black_box import BlackBox
    from stadimeter.app.control.recording import RecordingOnRequest
    from stadimeter.app.control.reloading import CheckedConfiguration, Restarter
    from stadimeter.app.control.requests import Control
    from stadimeter.app.persistence.state_writer import StateWriter
    from stadimeter.app.recordings.journal import RecordedConfiguration
    from stadimeter.app.service import Service
    from stadimeter.app.watchdog import WatchdogLink


Listener = Callable[[CycleRecord, Frame | None], None]


class Limits(NamedTuple):
    """The end of a run by itself: after a number of frames, or after a time on the run's clock; None for never."""

    frames: int | None = None
    seconds: float | None = None


@runtime_checkable
class RecordingSink(Protocol):
    """A listener that records a run for replay, and so needs more than its cycles."""

    def note_state(self, state: State) -> None:
        """Take in the state with which the run, or the recording of it, begins, before the first cycle."""
        ...

    def note_reload(self, now_s: float, configuration: RecordedConfiguration) -> None:
        """Take in a configuration that was reloaded, before its first cycle."""
        ...

    def trouble(self) -> str:
        """Return in words what is wrong with it; empty if nothing is."""
        ...


class Services(Struct):
    """Optional services of a run: operator commands, alarm store, wall clock, systemd and so on.

    `tell` takes a line for people, such as what became of a damaged state file.
    """

    control: Control | None = None
    memory: StateWriter | None = None
    time_of_day: TimeOfDay | None = None
    service: Service | None = None
    recording: RecordingOnRequest | None = None
    black_box: BlackBox | None = None
    restarter: Restarter | None = None
    watchdog: WatchdogLink | None = None
    tell: Callable[[str], None] = lambda _words: None

    def begin(self, plan: Plan, now_s: float, recordings: Iterable[RecordingSink]) -> State:
        """Return the state in which a run begins: alarms restore theirs from the alarm store."""
        state = initial_state(plan)
        if self.memory is None:
            return state
        resumed = self.memory.begin(now_s, state)
        if self.memory.warning:
            self.tell(f"warning: {self.memory.warning}")
        if resumed is None:
            return state
        for recording in recordings:
            recording.note_state(resumed)
        return resumed

    def reload(self) -> bool:
        """Read the configuration again before the next cycle; return whether this run can. Never waits."""
        if self.control is None:
            return False
        self.control.reload(self.tell)
        return True

    def cycle(self, before: State, after: State, record: CycleRecord) -> None:
        """Take in a cycle after its messages were sent. Waits 10 ms at most, and only for an alarm to be stored."""
        if self.watchdog is not None:
            self.watchdog.note_cycle()
        if self.memory is not None:
            self.memory.cycle(before, after, record.decision.events)
        if self.control is not None:
            self.control.answer_requests(record)

    @property
    def is_restart_due(self) -> bool:
        """True if a restart of the program was requested and is possible."""
        return self.restarter is not None and self.restarter.is_due

    def cancel_restart(self) -> None:
        """Let the run end for good, although a restart was requested."""
        if self.restarter is not None:
            self.restarter.cancel()

    def announce_end(self) -> None:
        """Tell systemd that the run ends or restarts, after its outputs were stopped."""
        if self.service is not None:
            (self.service.restarting if self.is_restart_due else self.service.stopping)()


@dataclass(slots=True)
class Loop:
    """A run: its parts, run until it ends.

    Attributes:
        listeners: Called after each cycle with its record and the frame that was new in it: views, journals and
            recordings. None of them may wait for anything on a live camera.
        history: Figures and the recent past of the run.
        ending: Why the run ended, in words; empty while it runs.
        troubles: What went wrong on the way out.
        reporter: Composes messages for other programs.
        deadline: Until when the run must have ended.
        services: The optional services of the run.
        deliveries: What other programs and people have not got yet, and what was given up.
        configured_at_s: Since when the run goes by its configuration, for people: on this computer's monotonic clock.
    """

    parts: Parts
    listeners: list[Listener] = field(default_factory=list)
    history: RunHistory = field(default_factory=RunHistory)
    ending: str = ""
    troubles: list[str] = field(default_factory=list)
    reporter: Reporter = field(default_factory=lambda: Reporter(boot_id=uuid.uuid4().hex))
    services: Services = field(default_factory=Services)
    deadline: Deadline = field(default_factory=Deadline)
    configured_at_s: float = field(default_factory=time.monotonic)
    _state: State | None = None
    _recordings: list[RecordingSink] = field(default_factory=list)
    _needs_wall_time: bool = False
    _open_parts: OpenParts = field(init=False)
    deliveries: Deliveries = field(init=False)
    _board: Board = field(init=False)

    def __post_init__(self) -> None:
        """Prepare the opening of the parts, and the account of what they deliver."""
        self._open_parts = OpenParts(self.parts, lambda: bool(self.ending), self._report_opening)
        self.deliveries = Deliveries(self.parts)
        self._board = Board(self.parts.configuration.path.parent)

    def run(self, limits: Limits | None = None) -> None:
        """Run until a limit is reached, the frames end, or the end is asked for.

        Whatever happens, every output is stopped first, and then everything is closed, side by side and before the
        deadline that `stop` sets.

        Raises:
            DriverError: A device could not be opened; the message names every one that could not.
            StadimeterError: The run cannot go on; the outputs are stopped.
        """
        with ExitStack() as closing:
            closing.callback(self._close_all)
            try:
                guard = self._open_parts.open(in_service=self.services.service is not None)
            except EndedWhileOpening:
                return
            try:
                self._run_cycles(limits or Limits(), guard)
            except EndOfFramesError as end:
                self.ending = self.ending or str(end)
            finally:
                self.troubles += retire_all(self.parts.driven)
                self.services.announce_end()
                if self._state is not None and self.services.memory is not None:
                    self.services.memory.keep(self._state)
                self.deliveries.closing()
            self.deliveries.publish(self.parts.clock.now_s(), self.reporter.last_messages(_wall_clock()))

    def stop(self, why: str) -> None:
        """Stop every output at once, and end the run after this cycle, soon. May be called from a signal handler.

        While devices are being opened, which may take seconds, this breaks off what is under way. What is open by then
        is closed as at any other end.
        """
        self.ending = self.ending or why
        self.deadline.set()
        self.troubles += retire_all(self.parts.driven)
        self._open_parts.break_off()

    def make_safe(self) -> list[str]:
        """Put every output at its safe value until the next cycle; return which are not. For a signal handler."""
        return make_all_safe(self.parts.driven)

    def end(self, why: str) -> None:
        """End the run after this cycle. May be called from any thread."""
        self.ending = self.ending or why

    @property
    def state(self) -> State | None:
        """The remembered state of the newest cycle; None before the run begins."""
        return self._state

    def give_up(self) -> list[str]:
        """Stop every output once more and keep what alarms remember, since the process is ended while the run hangs.

        Called from another thread.

        Returns:
            What went wrong until now, in words.
        """
        self.troubles += retire_all(self.parts.driven)
        self._remember()
        return list(dict.fromkeys(self.troubles))

    def trouble(self) -> str:
        """Return in words what is wrong outside the loop: with the camera, a messenger, a button or the disk."""
        messenger, capture, cycle = self.parts.messenger, self.parts.capture, self.parts.cycle
        notifiers = [notifier.trouble() for notifier in self.parts.notifiers.values()]
        panel = [button.trouble() for button in self.parts.buttons.values()]
        if (light := self.parts.status_led) is not None and light.fault:
            panel.append(f"{light.name}: {light.fault}")
        memory = self.services.memory
        deaf = messenger.deafness() if isinstance(messenger, TakesRequests) else ""
        sent = (messenger.trouble() if messenger else "", deaf)
        panel += [each.trouble() for each in (cycle.locator, cycle.mounting_watch) if each is not None]
        if (second := cycle.second) is not None:
            panel += [f"second camera: {words}" for words in (second.trouble(), *second.remarks()) if words]
        kept = [each.trouble() for each in (*self._recordings, memory) if each is not None]
        others = (*sent, *notifiers, *kept)
        troubles = (capture.trouble(), *capture.remarks(), *others, *panel)
        return "; ".join(trouble for trouble in troubles if trouble)

    def _run_cycles(self, limits: Limits, guard: Guard) -> None:
        parts = self.parts
        began_s = parts.clock.now_s()
        everybody: list[object] = [*self.listeners]
        self._recordings = [each for each in everybody if isinstance(each, RecordingSink)]
        self._needs_wall_time = parts.configuration.plan.needs_wall_time
        self._state = self.services.begin(parts.configuration.plan, began_s, self._recordings)
        while not self.ending:
            self._state, record, frame = self._cycle(self._state)
            self.history.add(record, frame)
            for listener in self.listeners:
                listener(record, frame)
            if guard.failure is not None:
                raise guard.failure
            self.ending = self.ending or self._limit_reached(limits, record.observation.now_s - began_s)

    def _cycle(self, state: State) -> tuple[State, CycleRecord, Frame | None]:
        """Take in operator commands and a changed configuration, run one cycle, report it, and store the state."""
        services, parts = self.services, self.parts
        control, time_of_day = services.control, services.time_of_day
        asked = control.operator_commands() if control is not None else ()
        pressed = [command for button in parts.buttons.values() for command in button.commands()]
        if services.is_restart_due and not self.ending:
            self.stop("restart, as asked")
        change = control.change() if control is not None else None
        before = self._reload(state, change) if change is not None else state
        wall = time_of_day.at(parts.clock.now_s()) if time_of_day is not None and self._needs_wall_time else None
        commands = (*asked, *pressed)
        if services.watchdog is not None:
            commands = services.watchdog.with_stop(commands)
        undelivered_since_s = self.deliveries.alarm_waits_since_s(parts.clock.now_s())
        after, record, frame = parts.cycle.run(before, commands, wall, undelivered_since_s)
        if services.black_box is not None:
            services.black_box.look(record)
        self._report(record)
        services.cycle(before, after, record)  # what has just been sent is kept with what it is about
        if parts.status_led is not None:
            parts.status_led.show(record)
        return after, record, frame

    def _reload(self, state: State, change: CheckedConfiguration) -> State:
        """Apply another configuration to every part; return the state with which the run goes on."""
        from stadimeter.core.persistence import reload  # noqa: PLC0415 - few runs are reloaded

        parts, services, plan = self.parts, self.services, change.configuration.plan
        if services.service is not None:
            services.service.reloading()
        taken = reload(state, plan)
        if services.memory is not None:
            services.memory.keep(taken.state)
        self._needs_wall_time = plan.needs_wall_time
        parts.configuration = change.configuration
        self.configured_at_s = time.monotonic()
        parts.cycle.max_frame_age_s = plan.safety.max_frame_age_s
        now_s = parts.clock.now_s()
        for recording in self._recordings:
            recording.note_reload(now_s, change.recorded)
        self.deliveries.publish(now_s, (*self.reporter.reload(plan.rules, plan.named_figures), self._info()))
        self.deliveries.retain_only(self.reporter.retained)
        if services.watchdog is not None:
            services.watchdog.reloaded(change.configuration)
        if services.service is not None:
            services.service.reloaded()
        if services.control is not None:
            services.control.changed(change, taken)
        return taken.state

    def _limit_reached(self, limits: Limits, seconds: float) -> str:
        if limits.frames is not None and self.history.frames >= limits.frames:
            return f"{limits.frames} frames, as asked for"
        if limits.seconds is not None and seconds >= limits.seconds:
            return f"{limits.seconds:g} s, as asked for"
        return ""

    def _report_opening(self) -> None:
        """Report that no rule is judged yet, and have the broker forget those of earlier runs that are no more."""
        now_s = self.parts.clock.now_s()
        plan = self.parts.configuration.plan
        self.deliveries.publish(now_s, (self._info(), *self.reporter.opening(plan.rules, plan.named_figures)))
        self._report_health(now_s)
        self.deliveries.retain_only(self.reporter.retained)

    def _info(self) -> Message:
        return self.reporter.info(sha256_of(self.parts.configuration.text))

    def _report(self, record: CycleRecord) -> None:
        now_s = record.observation.now_s
        messenger: object = self.parts.messenger
        self.deliveries.publish(now_s, self.reporter.messages(now_s, _wall_clock, record.decision, record.mark))
        self.deliveries.publish(now_s, self.reporter.pose(now_s, _wall_clock, record.observation.camera_pose))
        if isinstance(messenger, Discoverable):
            is_forgotten = messenger.take_forgotten()
            if messenger.take_states_due() or is_forgotten:
                self.deliveries.publish(now_s, self.deliveries.kept(is_everything=is_forgotten))
                self.deliveries.publish(now_s, self.reporter.repeat(_wall_clock()))
        self._report_health(now_s)
        plan = self.parts.configuration.plan
        sent = outgoing(record.decision, plan.rules, _local_time, plan.named_figures, self.reporter.clips)
        for name, item in sent:
            self.deliveries.send(now_s, name, item)
        given_up = self.deliveries.given_up()
        if (
            self.parts.messenger is not None
            and given_up != self.reporter.reported_losses
            and not self.parts.messenger.trouble()
        ):
            self.deliveries.publish(now_s, self.reporter.given_up(now_s, _wall_clock, given_up))

    def _report_health(self, now_s: float) -> None:
        if self.parts.messenger is None:
            return
        figures = self._health_figures if self.history.record is not None else None
        age_s = self.history.frame_age_s
        self.deliveries.publish(now_s, self.reporter.health(now_s, _wall_clock, age_s, figures))

    def _health_figures(self) -> dict[str, object]:
        health = live_health(self.history, self._board, "", self.trouble())
        return health_figures(health, len(self.deliveries.undelivered()), sum(self.deliveries.given_up().values()))

    def _close_all(self) -> None:
        """Close what was opened, then keep the state, and last close what the parts share.

        What could not be delivered is known, and kept, when messenger and notifiers are closed. What is recorded and
        shown needs time after that.
        """
        self.troubles += self._open_parts.close(self.deadline)
        state: Steps = [("the state of the alarms", self._remember)]
        self.troubles += close_side_by_side({"state": state}, self.deadline, keep_s=0.3)
        self.troubles += self._open_parts.close_shared(self.deadline)

    def _remember(self) -> None:
        """Store the state of the alarms and what was not delivered, and note what is lost."""
        if self._state is None:
            return
        memory = self.services.memory
        if memory is not None and (trouble := memory.end(self._state)):
            self.troubles.append(trouble)
        self.troubles += self.deliveries.last_words(memory.kept if memory is not None else ())


def _wall_clock() -> str:
    """Return the time of day for people to read, RFC 3339 in UTC. Nothing is decided by it."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def _local_time() -> str:
    """Return the local time of day for people to read, RFC 3339. Nothing is decided by it."""
    return datetime.now(UTC).astimezone().isoformat(timespec="seconds")
