"""Showing a run from a thread of its own, so that a terminal that nobody reads does not hold up the loop."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

from stadimeter.app.cycle_record import CycleRecord

WAITING_MAX = 300
"""So many cycles wait to be shown; about ten seconds of a camera."""

STOP_WAIT_S = 1.0


class ViewThread:
    """Hands cycles to a view in another thread.

    Args:
        update: Shows one cycle; it may block for as long as it likes.
        screen: Is entered before the first cycle and left after the last, in the same thread: giving a terminal back
            may block as well.

    Attributes:
        dropped: How many cycles were not shown, because the view did not keep up.
        failure: What ended the view, such as a pipe that nobody reads any more.
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
        """Hand a cycle over, and return at once.

        Args:
            record: The cycle.

        Raises:
            Exception: What ended the view.
        """
        if self.failure is not None:
            raise self.failure
        try:
            self._waiting.put_nowait(record)
        except queue.Full:
            self.dropped += 1

    def stop(self, wait_s: float = STOP_WAIT_S) -> None:
        """Show what waits, and end. A view that blocks is left behind: its thread is a daemon.

        Args:
            wait_s: How long to wait for it.
        """
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
