"""The control loop: runs cycle after cycle, and stops everything on every way out."""

from __future__ import annotations

import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from stadimeter.app.bootstrap import Parts
from stadimeter.app.cycle_record import CycleRecord
from stadimeter.app.deliveries import Deliveries
from stadimeter.app.ending import Deadline, Steps, close_side_by_side
from stadimeter.app.guard import Guard, make_all_safe, retire_all
from stadimeter.app.health import Health
from stadimeter.app.notifying import Notifying
from stadimeter.app.open_parts import EndedWhileOpening, OpenParts
from stadimeter.app.reporting import Reporter
from stadimeter.app.restarts import RESTARTING
from stadimeter.app.services import Recording, Services
from stadimeter.core.decide import State
from stadimeter.core.frame import Frame
from stadimeter.core.message import Message
from stadimeter.errors import EndOfFramesError
from stadimeter.messaging.protocol import Retaining

if TYPE_CHECKING:  # few runs are reloaded, and what that needs takes long to load
    from stadimeter.app.control.reloading import Change


Listener = Callable[[CycleRecord, Frame | None], None]


PUBLISHED_MAX = 50
"""This many messages are kept for whoever watches the run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """When a run ends by itself: after a number of frames, or after a time on the run's clock; None for never."""

    frames: int | None = None
    seconds: float | None = None


@dataclass(slots=True)
class Loop:
    """A run: its parts, run until it ends.

    Attributes:
        listeners: Called after each cycle with its record and the frame that was new in it: views, journals and
            recordings. None of them may wait for anything on a live camera.
        health: Figures on the run so far.
        ending: Why the run ended, in words; empty while it runs.
        troubles: What went wrong on the way out.
        reporter: Composes messages for other programs.
        notifying: Fills in what rules send.
        deadline: Until when the run must have ended.
        published: The newest messages with the time of each on the run's clock, newest first.
        services: What the run has beside its cycles.
        deliveries: What other programs and people have not got yet, and what was given up.
        configured_at_s: Since when the run goes by its configuration, for people: on this computer's monotonic clock.
    """

    parts: Parts
    listeners: list[Listener] = field(default_factory=list)
    health: Health = field(default_factory=Health)
    ending: str = ""
    troubles: list[str] = field(default_factory=list)
    reporter: Reporter = field(default_factory=lambda: Reporter(boot_id=uuid.uuid4().hex))
    published: deque[tuple[float, Message]] = field(default_factory=lambda: deque(maxlen=PUBLISHED_MAX))
    services: Services = field(default_factory=Services)
    deadline: Deadline = field(default_factory=Deadline)
    configured_at_s: float = field(default_factory=time.monotonic)
    _state: State | None = None
    _recordings: list[Recording] = field(default_factory=list)
    _open_parts: OpenParts = field(init=False)
    notifying: Notifying = field(init=False)
    deliveries: Deliveries = field(init=False)

    def __post_init__(self) -> None:
        """Send what the rules of the configuration send."""
        self._open_parts = OpenParts(self.parts, lambda: bool(self.ending), self._report_opening)
        self.deliveries = Deliveries(self.parts)
        self.notifying = Notifying(self.parts.configuration.plan.rules)

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
                self.services.stopping()
                if self._state is not None:
                    self.services.keep(self._state)
                self.deliveries.closing()
            self._publish(self.parts.clock.now_s(), self.reporter.last_messages(_wall_clock()))

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
        """What is remembered of the newest cycle; None before the run begins."""
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
        messenger = self.parts.messenger
        capture = self.parts.capture
        notifiers = [notifier.trouble() for notifier in self.parts.notifiers.values()]
        recordings = [recording.trouble() for recording in self._recordings]
        panel = [button.trouble() for button in self.parts.buttons.values()]
        if (light := self.parts.status_led) is not None and light.fault:
            panel.append(f"{light.name}: {light.fault}")
        others = (messenger.trouble() if messenger else "", *notifiers, *recordings, self.services.trouble())
        troubles = (capture.trouble(), *capture.remarks(), *others, *panel)
        return "; ".join(trouble for trouble in troubles if trouble)

    def _run_cycles(self, limits: Limits, guard: Guard) -> None:
        parts = self.parts
        began_s = parts.clock.now_s()
        everybody: list[object] = [*self.listeners]
        self._recordings = [each for each in everybody if isinstance(each, Recording)]
        self._state = self.services.begin(parts.configuration.plan, began_s, self._recordings)
        while not self.ending:
            self._state, record, frame = self._cycle(self._state)
            self.health.add(record)
            for listener in self.listeners:
                listener(record, frame)
            if guard.failure is not None:
                raise guard.failure
            self.ending = self.ending or self._limit_reached(limits, record.observation.now_s - began_s)

    def _cycle(self, state: State) -> tuple[State, CycleRecord, Frame | None]:
        """Attend to what people ask, run one cycle, report it, and remember."""
        pressed = [command for button in self.parts.buttons.values() for command in button.commands()]
        commands = (*self.services.operator_commands(), *pressed)
        if self.services.is_restart_due and not self.ending:
            self.stop(RESTARTING)
        change = self.services.change()
        before = self._reloaded(state, change) if change is not None else state
        after, record, frame = self.parts.cycle.run(before, commands, self.services.wall(self.parts.clock.now_s()))
        self._report(record)
        self.services.cycle(before, after, record)  # what has just been sent is kept with what it is about
        if self.parts.status_led is not None:
            self.parts.status_led.show(record)
        return after, record, frame

    def _reloaded(self, state: State, change: Change) -> State:
        """Let every part that goes by the configuration go by another one."""
        parts, configuration = self.parts, change.configuration
        taken = self.services.reloaded(state, change)
        parts.configuration = configuration
        self.configured_at_s = time.monotonic()
        parts.cycle.max_frame_age_s = configuration.plan.safety.max_frame_age_s
        self.notifying.take(configuration.plan.rules)
        now_s = parts.clock.now_s()
        for recording in self._recordings:
            recording.reloaded(now_s, change.recorded)
        self._publish(now_s, self.reporter.reloaded(configuration.plan.rules))
        self._retain_only(self.reporter.retained)
        self.services.answer_reload(change, taken)
        return taken.state

    def _limit_reached(self, limits: Limits, seconds: float) -> str:
        if limits.frames is not None and self.health.frames >= limits.frames:
            return f"{limits.frames} frames, as asked for"
        if limits.seconds is not None and seconds >= limits.seconds:
            return f"{limits.seconds:g} s, as asked for"
        return ""

    def _report_opening(self) -> None:
        """Report that no rule is judged yet, and have the broker forget those of earlier runs that are no more."""
        self._publish(self.parts.clock.now_s(), self.reporter.opening(self.parts.configuration.plan.rules))
        self._retain_only(self.reporter.retained)

    def _retain_only(self, topics: frozenset[str]) -> None:
        messenger: object = self.parts.messenger
        if isinstance(messenger, Retaining):
            messenger.retain_only(topics)

    def _report(self, record: CycleRecord) -> None:
        now_s = record.observation.now_s
        self._publish(now_s, self.reporter.messages(now_s, _wall_clock, record.decision))
        outgoing = self.notifying.outgoing(record.decision, _local_time)
        self._publish(now_s, outgoing.messages)
        for name, notification in outgoing.notifications:
            self.parts.notifiers[name].notify(notification)
        if self.parts.messenger is not None and not self.parts.messenger.trouble():
            self._publish(now_s, self.reporter.given_up(_wall_clock, self.deliveries.given_up()))

    def _publish(self, now_s: float, messages: Iterable[Message]) -> None:
        if self.parts.messenger is None:
            return
        for message in messages:
            self.parts.messenger.publish(message)
            self.published.appendleft((now_s, message))

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
        """Keep what is remembered and what could not be delivered, and say what is lost."""
        if self._state is None:
            return
        trouble = self.services.end(self._state)
        self.troubles += [trouble] if trouble else []
        self.troubles += self.deliveries.last_words(self.services.kept())


def _wall_clock() -> str:
    """Return the time of day for people to read, RFC 3339 in UTC. Nothing is decided by it."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def _local_time() -> str:
    """Return the local time of day for people to read, RFC 3339. Nothing is decided by it."""
    return datetime.now(UTC).astimezone().isoformat(timespec="seconds")
