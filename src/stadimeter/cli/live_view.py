"""The live view: a run in a terminal, while it runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Self

from rich.console import Console, RenderableType
from rich.live import Live

from stadimeter.app.cycle_record import CycleRecord
from stadimeter.cli.candidates import LookedAt
from stadimeter.cli.formatting import length_unit
from stadimeter.cli.live_screen import LiveScreen
from stadimeter.cli.run_history import RunHistory
from stadimeter.cli.snapshot import Snapshot
from stadimeter.core.message import Message

REFRESH_S = 0.1
"""The screen is drawn anew this often at most."""

SHARE_MAX = 0.2
"""Drawing takes at most this share of the time: on a slow computer the screen is drawn less often, and the loop goes
on as before."""


class LiveView:
    """Shows a run in a terminal, drawn from the loop's own thread: there is no other.

    Used as a context manager it takes the whole terminal and gives it back at the end. `update` then draws, about ten
    times a second. Without that, `render` may be printed at any time.

    Args:
        title: What runs.
        unit: The unit of distances: ``m``, ``cm``, ``ft`` or ``in``.
        trouble: Says what is wrong outside the loop, such as with the broker; an empty string if nothing.
        messages: Returns what was sent to other programs and when, newest first.
        limits_m: Distances to mark in the chart of each target, such as those of its rules.
        console: Where to draw; standard output by default.
        real_time_s: A monotonic clock of real time, in seconds. Simulated time would draw too often, or too seldom.

    Raises:
        ConfigError: Distances are not shown in that unit.
    """

    def __init__(
        self,
        title: str,
        *,
        unit: str = "m",
        trouble: Callable[[], str] = str,
        messages: Callable[[], Sequence[tuple[float, Message]]] = tuple,
        limits_m: Mapping[str, Sequence[float]] | None = None,
        console: Console | None = None,
        real_time_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._title = title
        self._unit = length_unit(unit)
        self._trouble = trouble
        self._messages = messages
        self._limits_m = dict(limits_m or {})
        self._console = console or Console()
        self._real_time_s = real_time_s
        self._history = RunHistory()
        self._looked_at = LookedAt()
        self._record: CycleRecord | None = None
        self._live: Live | None = None
        self._draw_at_s = 0.0

    def __enter__(self) -> Self:
        """Take the terminal."""
        self._live = Live(self.render(), console=self._console, screen=True, auto_refresh=False)
        self._live.start(refresh=True)
        self._draw_at_s = self._real_time_s()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give the terminal back as it was."""
        if self._live is not None:
            self._live.stop()
        self._live = None

    def update(self, record: CycleRecord) -> None:
        """Take note of a cycle; draw if it is time to.

        Args:
            record: The cycle.
        """
        self._record = record
        self._history.add(record)
        self._looked_at.add(record)
        started_s = self._real_time_s()
        if self._live is None or started_s < self._draw_at_s:
            return
        self._live.update(self.render(), refresh=True)
        ended_s = self._real_time_s()
        self._draw_at_s = max(started_s + REFRESH_S, ended_s + (ended_s - started_s) * (1 / SHARE_MAX - 1))

    def render(self) -> RenderableType:
        """Return the view as it is now; it fits itself to the console that it is printed on."""
        history = self._history
        return LiveScreen(
            snapshot=Snapshot(
                title=self._title,
                unit=self._unit,
                record=self._record,
                started_s=history.started_s,
                frame_rate_hz=history.frame_rate_hz,
                frame_age_s=history.frame_age_s,
                tilts_rad=history.tilts_rad,
                looked_at=self._looked_at.by_target,
                samples={target: tuple(samples) for target, samples in history.samples.items()},
                events=tuple(history.events),
                messages=self._messages(),
                limits_m=self._limits_m,
                trouble=self._trouble(),
            )
        )
