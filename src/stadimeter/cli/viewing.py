"""Views of a run while it goes on (the live view, lines, or troubles alone), and its summary at the end."""

from __future__ import annotations

import queue
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TYPE_CHECKING, Any, Literal, TextIO

import typer

from stadimeter.app.cycle_record import CycleRecord
from stadimeter.app.health import Health, percentile
from stadimeter.app.loop import Loop
from stadimeter.cli.plain_view import PlainView
from stadimeter.core.condition import DistanceCondition
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule, AnyRule, FollowRule, RampRule

if TYPE_CHECKING:
    from stadimeter.cli.live_view import LiveView

View = Literal["live", "plain", "json"]
_NO_SCREEN = nullcontext()

WAITING_MAX = 300
"""Cycles that may wait to be shown: about ten seconds of a camera."""

STOP_WAIT_S = 1.0


@contextmanager
def show(loop: Loop, view: View, title: str, unit: str) -> Iterator[None]:
    """Show a run until the context ends; `unit` is that of distances."""
    if view == "live":
        live = live_view_of(loop, title, unit)
        with _fed(loop, live.update, live):
            yield
        return
    if view == "plain":
        plain = PlainView(typer.echo, unit=unit, trouble=loop.trouble, ascii_only=not _is_unicode(sys.stdout))
        with _fed(loop, plain.update):
            yield
        return
    loop.listeners.append(_TroubleLines(loop))
    yield


@contextmanager
def _fed(
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


def live_view_of(loop: Loop, title: str, unit: str) -> LiveView:
    """Return the live view of a run, not shown yet; `unit` is that of distances."""
    from stadimeter.cli.live_view import LiveView  # noqa: PLC0415 - it takes long, and few runs show it

    return LiveView(
        title,
        unit=unit,
        trouble=loop.trouble,
        messages=lambda: tuple(loop.published),
        limits_m=chart_limits_m(loop.parts.configuration.plan),
    )


def _is_unicode(stream: TextIO) -> bool:
    return "utf" in (stream.encoding or "").lower()


class _TroubleLines:
    """Writes to standard error what is wrong outside the loop, once for each change."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._said = ""

    def __call__(self, *_: object) -> None:
        trouble = self._loop.trouble()
        if trouble and trouble != self._said:
            typer.echo(f"warning: {trouble}", err=True)
        self._said = trouble


def chart_limits_m(plan: Plan) -> dict[str, list[float]]:
    """Return, by target, the distances at which rules begin, nearest first, to mark them in a chart."""
    limits_m: dict[str, set[float]] = {target: set() for target in plan.targets}
    for rule in plan.rules:
        limits_m[rule.target].update(_limits_m(rule))
    return {target: sorted(values) for target, values in limits_m.items()}


def _limits_m(rule: AnyRule) -> tuple[float, ...]:
    match rule:
        case AlarmRule(condition=DistanceCondition(above_m=above_m, below_m=below_m)):
            return tuple(limit_m for limit_m in (above_m, below_m) if limit_m is not None)
        case RampRule():
            return (rule.start_m,)
        case FollowRule():
            return (rule.distance_m,)
        case _:
            return ()


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
        self, update: Callable[[CycleRecord], None], screen: AbstractContextManager[object] | None = None
    ) -> None:
        self.dropped = 0
        self.failure: Exception | None = None
        self._update = update
        self._screen = screen or nullcontext()
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
        except Exception as error:  # noqa: BLE001 - the loop raises it, in its own thread
            self.failure = error


def summarise(health: Health, ending: str) -> dict[str, Any]:
    """Return the figures of a run, as ``run --json`` prints them: counts, and times in milliseconds."""
    return {
        "ended": ending,
        "cycles": health.cycles,
        "frames": health.frames,
        "tracks": {target: dict(counts) for target, counts in health.track_statuses.items()},
        "events": dict(health.events),
        "data_age_ms": _milliseconds(health.data_ages_s),
        "cycle_ms": _milliseconds(health.cycle_times_s),
    }


def in_words(summary: dict[str, Any]) -> str:
    """Return the figures of a run as a few lines."""
    lines = [f"Ended: {summary['ended'] or 'unknown'}. {summary['frames']} frames in {summary['cycles']} cycles."]
    for target, counts in summary["tracks"].items():
        lines.append(f"{target}: {_listed(counts)}.")
    if summary["events"]:
        lines.append(f"Events: {_listed(summary['events'])}.")
    if summary["cycle_ms"]["p50"] is not None:
        lines.append(
            f"Cycle time: median {summary['cycle_ms']['p50']:.1f} ms, p95 {summary['cycle_ms']['p95']:.1f} ms."
        )
    return "\n".join(lines)


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in counts.items())


def _milliseconds(seconds: Iterable[float]) -> dict[str, float | None]:
    ordered = sorted(seconds)
    return {name: _rounded_ms(percentile(ordered, share)) for name, share in (("p50", 0.5), ("p95", 0.95))}


def _rounded_ms(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds * 1000, 3)
