"""Signals that end a run: the outputs stop at once, inside the handler. And the one that has it read its file again."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def stopping_on_signals(stop: Callable[[str], None], reload: Callable[[], None] | None = None) -> Iterator[None]:
    """Call ``stop`` with the signal's name when the process is asked to end.

    Without handlers, SIGTERM and SIGHUP would end the process with every pin left as it was. A second signal ends the
    process at once, after one more stop: the loop may be stuck, in a terminal that nobody reads for example.

    SIGHUP means that the terminal is gone. A service has none: to it, SIGHUP says that its configuration has changed.

    Args:
        stop: Stops the outputs and asks the loop to end; called in the main thread.
        reload: Asks the loop to read its configuration again, on SIGHUP; None to end then.

    Yields:
        Nothing; the handlers that were there before are put back afterwards.
    """
    asked: list[int] = []

    def handle(number: int, _frame: FrameType | None) -> None:
        if reload is not None and number == signal.SIGHUP:
            reload()
            return
        asked.append(number)
        try:
            stop(signal.Signals(number).name)
        finally:
            if len(asked) > 1:
                os._exit(128 + number)

    before = {number: signal.signal(number, handle) for number in ENDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
