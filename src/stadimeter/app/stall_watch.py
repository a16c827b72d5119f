"""A watch on real time for recordings that drive real outputs.

The clock of a recording stands still while the loop hangs, and with it the guard and every lease. So where a recording
drives anything real, a thread looks at the computer's own clock, and puts the outputs at their safe values when the
recording's clock has not moved for too long.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from stadimeter.app.clock import MonotonicClock
from stadimeter.app.leased_output import LeasedOutput
from stadimeter.core.clock import Clock

PERIOD_S = 0.05
STALLED_AFTER_S = 0.5


class StallWatch:
    """Puts outputs at their safe values while a stepped clock stands still."""

    def __init__(self, outputs: Sequence[LeasedOutput], clock: Clock, real_clock: Clock | None = None) -> None:
        self._outputs = outputs
        self._clock = clock
        self._real_clock = real_clock or MonotonicClock()
        self._seen_s = clock.now_s()
        self._moved_at_s = self._real_clock.now_s()
        self._cancel: Callable[[], None] | None = None

    def start(self) -> None:
        """Begin to watch."""
        self._cancel = self._real_clock.call_every(PERIOD_S, self.step)

    def step(self, real_s: float) -> None:
        """Look once."""
        now_s = self._clock.now_s()
        if now_s != self._seen_s:
            self._seen_s, self._moved_at_s = now_s, real_s
        elif real_s - self._moved_at_s > STALLED_AFTER_S:
            for output in self._outputs:
                output.make_safe()

    def stop(self) -> None:
        """Cease to watch. May be called any number of times."""
        if self._cancel is not None:
            self._cancel()
            self._cancel = None
