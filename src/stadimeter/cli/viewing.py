"""Views of a run while it goes on: the live view, lines, or troubles alone."""

from __future__ import annotations

import math
import os
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Literal

import typer
from msgspec import Struct

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.live.snapshot import looked_at
from stadimeter.app.loop import Loop
from stadimeter.cli.formatting import (
    LENGTH_UNITS,
    format_best,
    format_distance,
    format_level,
    format_speed,
    format_time,
    format_turn,
    in_unit,
)
from stadimeter.cli.keyboard import RunKeys
from stadimeter.core.command import Command, LevelCommand
from stadimeter.core.decision import Event, RuleStatus, RuleTrace, SafetyMode
from stadimeter.core.detection import RejectedCandidate
from stadimeter.core.measurement import Track
from stadimeter.core.words import one_line

# Rules that do nothing are not named in each line.
SILENT = frozenset({RuleStatus.IDLE, RuleStatus.UNKNOWN})


class PlainView:
    """Writes a line about the run every second, and each event at once.

    Args:
        write: Takes one line without its line break, such as `print`.
        trouble: Says what is wrong outside the loop; said again only when it changes.
        narration: Says what happens in a simulated world; likewise.
    """

    def __init__(
        self,
        write: Callable[[str], None],
        every_s: float = 1.0,
        *,
        unit: str = "m",
        trouble: Callable[[], str] = str,
        narration: Callable[[], str] = str,
    ) -> None:
        self._write = write
        self._every_s = every_s
        self._unit = LENGTH_UNITS[unit]
        self._trouble = trouble
        self._started_s: float | None = None
        self._due_s = 0.0
        self._narration = narration
        self._said = self._narrated = ""
        self._looked_at: Mapping[str, Sequence[RejectedCandidate]] = {}

    def update(self, record: CycleRecord) -> None:
        """Write what there is to say about a cycle."""
        now_s = record.observation.now_s
        if record.observation.frame is not None:
            self._looked_at = looked_at(record)
        if self._started_s is None:
            self._started_s = self._due_s = now_s
        for event in record.decision.events:
            self._line(event.at_s, _event_words(event))
        self._tell_changes(now_s)
        if now_s < self._due_s - 1e-9:
            return
        self._line(now_s, "  ".join(self._words(record)))
        missed = int((now_s - self._due_s) / self._every_s + 1e-9) if self._every_s > 0 else 0
        self._due_s += (missed + 1) * self._every_s

    def _tell_changes(self, now_s: float) -> None:
        """Write what happens in a simulated world, and what is wrong outside the loop, where that has changed."""
        narrated, trouble = self._narration(), self._trouble()
        if narrated and narrated != self._narrated:
            self._line(now_s, f"> {narrated}")
        if trouble != self._said:
            self._line(now_s, trouble or f"resolved: {self._said}")
        self._narrated, self._said = narrated, trouble

    def _line(self, at_s: float, words: str) -> None:
        shown = in_unit(words, self._unit)
        self._write(one_line(f"{format_time(at_s - (self._started_s or 0.0)):>8}  {shown}"))

    def _words(self, record: CycleRecord) -> Iterator[str]:
        decision, observation = record.decision, record.observation
        if decision.safety is not SafetyMode.ACTIVE:
            yield f"{decision.safety.value.upper()}: {decision.safety_reason}"
            if observation.camera_fault:
                yield f"camera: {observation.camera_fault}"
        yield from (self._target(track) for track in decision.tracks)
        yield from (self._output(command) for command in record.applied)
        yield from (f"{fault.output} OUT OF ORDER: {fault.reason}" for fault in observation.faults)
        shown = (trace for trace in decision.rules if trace.status not in SILENT)
        yield from (_rule(trace, decision.reasons.get(trace.rule, "")) for trace in shown)

    def _target(self, track: Track) -> str:
        if track.is_valid:
            distance = format_distance(track.distance_m, track.sigma_m, self._unit)
            return f"{track.target} {distance} {track.status.value}"
        best = format_best(track.reason, self._looked_at.get(track.target, ()))
        why = "; ".join(words for words in (track.reason, best) if words)
        return f"{track.target} {track.status.value}" + (f" ({why})" if why else "")

    def _output(self, command: Command) -> str:
        if isinstance(command, LevelCommand):
            return f"{command.output} {format_level(command.level)}"
        speed = format_speed(command.linear_mps, None, self._unit)
        return f"{command.output} {speed} {format_turn(command.angular_radps, command.tilt_radps)}"


def _rule(trace: RuleTrace, reason: str) -> str:
    marks = ", ".join([*([] if trace.acknowledged else ["unacknowledged"]), *trace.inhibits])
    return f"{trace.status.value.upper()} {trace.rule}{f' ({marks})' if marks else ''}: {reason}"


def _event_words(event: Event) -> str:
    what = f"* {event.severity.value}: {event.source} {event.kind.value.replace('_', ' ')}"
    return f"{what}: {event.reason}" if event.reason else what


View = Literal["live", "plain", "json"]
_NO_SCREEN = nullcontext()

# Cycles that may wait to be shown: about ten seconds of a camera.
WAITING_MAX = 300

STOP_WAIT_S = 1.0


class Showing(Struct, frozen=True):
    """The way a run is shown.

    Attributes:
        unit: That of distances.
        keys: Those of the live view.
        last: Words for the end of the run.
    """

    view: View
    title: str
    unit: str
    keys: RunKeys
    last: str = ""


def live_or_plain() -> View:
    """Return the live view if there is a terminal to draw it on that knows Unicode, else lines."""
    is_able = os.environ.get("TERM") not in {"dumb", "unknown"} and "utf" in (sys.stdout.encoding or "").lower()
    return "live" if sys.stdout.isatty() and is_able else "plain"


@contextmanager
def show(loop: Loop, showing: Showing) -> Iterator[None]:
    """Show a run until the context ends."""
    if showing.view == "live":
        from stadimeter.app.watching import live_feed  # noqa: PLC0415 - it takes long, and few runs show it
        from stadimeter.cli.live_view import LiveView  # noqa: PLC0415

        live = LiveView(showing.title, live_feed(loop), unit=showing.unit, keys=showing.keys)
        with showing.keys.keyboard, _feed(loop, live.update, live):
            yield
        return
    if showing.view == "plain":
        plain = PlainView(
            typer.echo,
            every_s=math.inf if loop.services.service is not None else 1.0,  # a service's output may go to a disk
            unit=showing.unit,
            trouble=loop.trouble,
            narration=loop.parts.world.narration if loop.parts.world is not None else str,
        )
        with _feed(loop, plain.update):
            yield
        return
    loop.listeners.append(_tell_trouble(loop))
    yield


@contextmanager
def _feed(
    loop: Loop, update: Callable[[CycleRecord], None], screen: AbstractContextManager[object] = _NO_SCREEN
) -> Iterator[None]:
    """Feed a view with every cycle: from a thread if the loop must not wait, directly if it runs on a stepped clock."""
    if not loop.parts.is_live:
        loop.listeners.append(lambda record, _frame: update(record))
        with screen:
            yield
        return
    thread = ViewThread(update, screen)
    thread.start()
    loop.listeners.append(lambda record, _frame: thread.submit(record))
    try:
        yield
    finally:
        thread.stop(loop.deadline.left_s(STOP_WAIT_S))
        if thread.dropped:
            typer.echo(f"warning: {thread.dropped} cycles were not shown: the terminal did not keep up", err=True)


def _tell_trouble(loop: Loop) -> Callable[..., None]:
    """Return a listener that writes to standard error what is wrong outside the loop, once for each change."""
    said = [""]

    def tell(*_: object) -> None:
        trouble = loop.trouble()
        if trouble and trouble != said[0]:
            typer.echo(f"warning: {trouble}", err=True)
        said[0] = trouble

    return tell


class ViewThread:
    """Hands cycles to a view in another thread.

    Args:
        update: Shows one cycle; it may block for as long as it likes.
        screen: Is entered before the first cycle and left after the last, in the same thread: giving a terminal back
            may block as well.

    Attributes:
        dropped: How many cycles were not shown, because the view did not keep up.
        failure: The error that ended the view, such as a pipe whose reader is gone.
    """

    def __init__(
        self, update: Callable[[CycleRecord], None], screen: AbstractContextManager[object] = _NO_SCREEN
    ) -> None:
        self.dropped = 0
        self.failure: BaseException | None = None
        self._update = update
        self._screen = screen
        self._waiting: queue.Queue[CycleRecord | None] = queue.Queue(WAITING_MAX)
        self._thread = threading.Thread(target=self._run, name="view", daemon=True)

    def start(self) -> None:
        """Begin to show."""
        self._thread.start()

    def submit(self, record: CycleRecord) -> None:
        """Hand a cycle over, and return at once. Raises what ended the view."""
        if self.failure is not None:
            raise self.failure
        try:
            self._waiting.put_nowait(record)
        except queue.Full:
            self.dropped += 1

    def stop(self, wait_s: float = STOP_WAIT_S) -> None:
        """Show what waits, and end. A view that blocks is left behind: its thread is a daemon."""
        until_s = time.monotonic() + wait_s
        try:
            self._waiting.put(None, timeout=wait_s)
        except queue.Full:
            return
        self._thread.join(max(0.0, until_s - time.monotonic()))

    def _run(self) -> None:
        try:
            with self._screen:
                while (record := self._waiting.get()) is not None:
                    self._update(record)
        except BaseException as error:  # noqa: BLE001 - the loop raises it, in its own thread
            self.failure = error
