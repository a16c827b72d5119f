"""The guard: watches over the outputs apart from the control loop.

It calls every output every 20 ms, so that a command whose frame has grown too old ends, even while the control loop
hangs in a camera or a detector. On a real clock each output has a thread of its own: one driver that hangs keeps no
other from stopping.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial

from stadimeter.app.clock import MonotonicClock
from stadimeter.app.leased_output import BUSY_WAIT_S, LeasedOutput
from stadimeter.core.clock import Clock
from stadimeter.errors import DriverError

PERIOD_S = 0.02


class Guard:
    """Checks the outputs of a run again and again.

    Attributes:
        failure: A defect in a driver that came up here, a ``SystemExit`` too: it would end the thread of the guard
            without a word. The loop raises it. None if all is well.
    """

    def __init__(self, outputs: Sequence[LeasedOutput], clock: Clock) -> None:
        self.failure: BaseException | None = None
        self._outputs = outputs
        self._clock = clock
        self._cancels: list[Callable[[], None]] = []

    def start(self) -> None:
        """Begin to watch."""
        self._cancels = [self._clock.call_every(PERIOD_S, partial(self._check, output)) for output in self._outputs]

    def _check(self, output: LeasedOutput, now_s: float) -> None:
        try:
            output.check(now_s)
        except BaseException as error:  # noqa: BLE001 - whatever it is, the outputs must stop; the loop reports it
            self.fail(error)

    def fail(self, error: BaseException) -> None:
        """Stop every output for good, for a defect that the loop raises."""
        self.failure = self.failure or error
        retire_all(self._outputs)

    def stop(self) -> None:
        """Cease to watch. May be called any number of times."""
        for cancel in self._cancels:
            cancel()
        self._cancels = []


def make_all_safe(outputs: Sequence[LeasedOutput]) -> list[str]:
    """Put every output at its safe value, busy ones last; return which of them are not, in words."""
    busy = [output for output in outputs if not output.make_safe()]
    until_s = time.monotonic() + BUSY_WAIT_S
    left = [output for output in busy if not output.make_safe(max(0.0, until_s - time.monotonic()))]
    return [f"{output.name}: its driver is busy and does not come back" for output in left]


def retire_all(outputs: Sequence[LeasedOutput]) -> list[str]:
    """Stop every output for good, each one whatever becomes of the others, busy ones last; return what went wrong."""
    for output in outputs:
        output.forbid()
    busy = [output for output in outputs if _retired(output, 0.0)]
    until_s = time.monotonic() + BUSY_WAIT_S  # for all of them: one after the other, many would take long
    tried = [(output.name, _retired(output, max(0.0, until_s - time.monotonic()))) for output in busy]
    return [f"{name}: {trouble}" for name, trouble in tried if trouble]


def _retired(output: LeasedOutput, wait_s: float) -> str:
    """Stop one output for good; return what went wrong."""
    try:
        output.retire(wait_s)
    except DriverError as error:
        return str(error)
    except BaseException as error:  # noqa: BLE001 - a defect in one driver must not keep the next from stopping
        return f"{type(error).__name__}: {error}"
    return ""


LOOK_EVERY_S = 0.05
STALLED_AFTER_S = 0.5


class StallWatch:
    """Puts outputs at their safe values while a stepped clock stands still.

    Args:
        guard: Stops every output for a defect that comes up here.
    """

    def __init__(
        self,
        outputs: Sequence[LeasedOutput],
        clock: Clock,
        real_clock: Clock | None = None,
        guard: Guard | None = None,
    ) -> None:
        self._outputs = outputs
        self._guard = guard or Guard(outputs, clock)
        self._clock = clock
        self._real_clock = real_clock or MonotonicClock()
        self._seen_s = clock.now_s()
        self._moved_at_s = self._real_clock.now_s()
        self._cancel: Callable[[], None] | None = None

    def start(self) -> None:
        """Begin to watch."""
        self._cancel = self._real_clock.call_every(LOOK_EVERY_S, self.step)

    def step(self, real_s: float) -> None:
        """Look once."""
        now_s = self._clock.now_s()
        if now_s != self._seen_s:
            self._seen_s, self._moved_at_s = now_s, real_s
        elif real_s - self._moved_at_s > STALLED_AFTER_S:
            for output in self._outputs:
                self._make_safe(output)

    def _make_safe(self, output: LeasedOutput) -> None:
        try:
            output.make_safe()
        except BaseException as error:  # noqa: BLE001 - as in the guard
            self._guard.fail(error)

    def stop(self) -> None:
        """Cease to watch. May be called any number of times."""
        if self._cancel is not None:
            self._cancel()
            self._cancel = None
