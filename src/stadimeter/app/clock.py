"""The two clocks: one that runs, and one that is stepped."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from stadimeter.core.clock import TaskEndedError

# A paced clock that is this far behind real time no longer tries to catch up.
LATE_S = 0.2


# What a thread that runs beside others goes by: its ``end_flag`` on a real clock, its ``task`` on a stepped one.
_THREAD = threading.local()

# A task in its own thread looks this often whether it is still wanted.
NOTICED_WITHIN_S = 0.05


@dataclass(slots=True)
class _EndFlag:
    """Tells a task to end. Unlike an event it has no lock, so that a signal handler may set it at any time."""

    is_set: bool = False

    def set(self) -> None:
        self.is_set = True


class MonotonicClock:
    """The computer's clock since boot, for live cameras. Nothing sets it, and it goes on while the computer sleeps.

    `time.monotonic` stands still during a suspend: a frame from before it would look fresh after it.
    """

    def now_s(self) -> float:
        """Return the time in seconds since boot."""
        return time.clock_gettime(time.CLOCK_BOOTTIME)

    def sleep_until_s(self, time_s: float) -> None:
        """Return when the clock shows ``time_s`` or later."""
        flag: _EndFlag | None = getattr(_THREAD, "end_flag", None)
        while (left_s := time_s - self.now_s()) > 0:
            if flag is not None and flag.is_set:
                raise TaskEndedError
            time.sleep(left_s if flag is None else min(left_s, NOTICED_WITHIN_S))

    def call_every(self, period_s: float, callback: Callable[[float], None]) -> Callable[[], None]:
        """Call ``callback(now_s)`` every ``period_s`` seconds from a thread, until the returned function is called."""
        ended = threading.Event()

        def run() -> None:
            while not ended.wait(period_s):
                callback(self.now_s())

        thread = threading.Thread(target=run, name=f"every {period_s} s", daemon=True)
        thread.start()

        def cancel() -> None:
            ended.set()
            if thread is not threading.current_thread():
                thread.join()

        return cancel

    def run_beside(self, task: Callable[[], None]) -> Callable[[], None]:
        """Run ``task`` in a thread of its own; the returned function has it end at its next sleep."""
        flag = _EndFlag()

        def run() -> None:
            _THREAD.end_flag = flag
            with suppress(TaskEndedError):
                task()

        threading.Thread(target=run, name="beside", daemon=True).start()
        return flag.set


@dataclass(slots=True, eq=False)
class _Periodic:
    """A callback that is due again and again."""

    due_s: float
    period_s: float
    callback: Callable[[float], None]


class _Task:
    """A task on a stepped clock: a thread that runs only while the one which steps the clock waits for it."""

    def __init__(self, task: Callable[[], None]) -> None:
        self._task = task
        self._is_ended = False
        self._its_turn, self._others_turn = threading.Semaphore(0), threading.Semaphore(0)
        threading.Thread(target=self._run, name="beside", daemon=True).start()

    def end(self) -> None:
        """Have it end at its next sleep, or at the end of the present one."""
        self._is_ended = True

    def go_on(self) -> None:
        """Let it run until it sleeps or is done."""
        self._its_turn.release()
        self._others_turn.acquire()

    def sleep(self) -> None:
        """Let the others run until the next `go_on`. Called by the task."""
        self._others_turn.release()
        self._its_turn.acquire()
        if self._is_ended:
            raise TaskEndedError

    def _run(self) -> None:
        _THREAD.task = self
        self._its_turn.acquire()
        try:
            if not self._is_ended:
                with suppress(TaskEndedError):
                    self._task()
        finally:
            self._others_turn.release()


class SteppedClock:
    """A clock that moves only when it is slept on: for recordings, simulations and tests.

    All time passes inside `sleep_until_s`, in the thread of the caller, so a run is the same each time. An hour takes
    as long as what is computed in it.

    Attributes:
        speed: How fast time shall pass: 1 is real time, None as fast as the computer can.
    """

    def __init__(self, start_s: float = 0.0, speed: float | None = None) -> None:
        self.speed = speed
        self._now_s = start_s
        self._start_s = start_s
        self._started_real_s = time.monotonic()
        self._periodic: list[_Periodic] = []

    def now_s(self) -> float:
        """Return the time in seconds."""
        return self._now_s

    def sleep_until_s(self, time_s: float) -> None:
        """Move the clock to ``time_s``, calling on the way whatever is due, in the order of time."""
        task: _Task | None = getattr(_THREAD, "task", None)
        if task is not None:
            self._wake(task, time_s)
            task.sleep()
            return
        while due := self._next_due(time_s):
            self._move_to(due.due_s)
            due.due_s += due.period_s
            due.callback(self._now_s)
        self._move_to(time_s)

    def call_every(self, period_s: float, callback: Callable[[float], None]) -> Callable[[], None]:
        """Call ``callback(now_s)`` every ``period_s`` seconds, until the returned function is called."""
        entry = _Periodic(self._now_s + period_s, period_s, callback)
        self._periodic.append(entry)

        def cancel() -> None:
            if entry in self._periodic:
                self._periodic.remove(entry)

        return cancel

    def run_beside(self, task: Callable[[], None]) -> Callable[[], None]:
        """Run ``task`` within `sleep_until_s`; the returned function has it end at its next sleep."""
        beside = _Task(task)
        self._wake(beside, self._now_s)
        return beside.end

    def _wake(self, task: _Task, time_s: float) -> None:
        """Let a task go on at that time."""

        def go_on(_now_s: float) -> None:
            self._periodic.remove(entry)
            task.go_on()

        entry = _Periodic(max(time_s, self._now_s), math.inf, go_on)
        self._periodic.append(entry)

    def _next_due(self, until_s: float) -> _Periodic | None:
        due = min(self._periodic, key=lambda entry: entry.due_s, default=None)
        return due if due and due.due_s <= until_s else None

    def _move_to(self, time_s: float) -> None:
        self._now_s = max(self._now_s, time_s)
        if self.speed:
            ahead_s = (self._now_s - self._start_s) / self.speed - (time.monotonic() - self._started_real_s)
            if ahead_s > 0:
                time.sleep(ahead_s)
            elif ahead_s < -LATE_S:
                self._started_real_s -= ahead_s  # it goes on from here; catching up would be a burst of commands
