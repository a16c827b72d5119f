"""The two clocks of a run, one that runs and one that is stepped, and the local time of day for rules that go by it.

A Raspberry Pi has no clock that runs while it is off. Until a time server has answered, it shows some time of the past,
so a schedule must not go by it. Sources that know whether the clock is right:

=====================================  =================================================================================
``/run/systemd/timesync/synchronized``  systemd-timesyncd makes this file when it has set the clock
``adjtimex``                            the kernel's own estimate of the clock's error, which chrony, ntpd and timesyncd
                                        keep small; below 16 s counts as right, as for ``timedatectl``
=====================================  =================================================================================

Where neither can say, the clock does not count as right; ``--trust-clock`` is for machines whose clock is known to be.
"""

from __future__ import annotations

import ctypes
import math
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.config.sun import sun_times_s
from stadimeter.core.clock import TaskEndedError
from stadimeter.core.observation import MonthDay, WallTime

if TYPE_CHECKING:
    from stadimeter.config.loader import Configuration


# A paced clock that is this far behind real time no longer tries to catch up.
LATE_S = 0.2


# What a thread that runs beside others goes by: its ``end_flag`` on a real clock, its ``task`` on a stepped one.
_THREAD = threading.local()

# A task in its own thread looks this often whether it is still wanted.
NOTICED_WITHIN_S = 0.05


class _EndFlag(Struct):
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


class _Periodic(Struct, eq=False):
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


# The kernel sets its estimate to this when nothing has corrected the clock for long, or ever.
TIMESYNC_FILE = Path("/run/systemd/timesync/synchronized")
ERROR_MAX_US = 16_000_000

ASKED_EVERY_S = 1.0


class _Timex(ctypes.Structure):
    """The beginning of the kernel's ``struct timex``, and room for the rest of it."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_byte * 512),
    )


def is_synchronised(timesync_file: Path = TIMESYNC_FILE) -> bool:
    """Check whether the computer's clock shows the right time."""
    return timesync_file.exists() or _kernel_error_us() < ERROR_MAX_US


def _kernel_error_us() -> float:
    """Return the possible error of the clock, in microseconds; infinite if the kernel does not say. Changes nothing."""
    try:
        adjtimex = ctypes.CDLL(None).adjtimex
    except (OSError, AttributeError):  # a system without it
        return math.inf
    timex = _Timex()
    return float(timex.maxerror) if adjtimex(ctypes.byref(timex)) >= 0 else math.inf


def local_now() -> datetime:
    """Return the local time."""
    return datetime.now().astimezone()


def time_of_day(local: datetime) -> WallTime:
    """Return the time that a clock on the wall shows, and the dates around it."""
    second = 3600 * local.hour + 60 * local.minute + local.second + local.microsecond * 1e-6
    days = [local.date() + timedelta(days=later) for later in (-1, 0, 1)]
    dates = tuple([MonthDay(day.month, day.day) for day in days])
    return WallTime(second_of_day=second, weekday=local.weekday(), dates=dates)


class TimeOfDay:
    """The time of day in each cycle. Asks the computer for it once a second at most.

    On a stepped clock the day goes on with the run: from the time at which it began. A simulated hour is an hour of
    the day, however fast it is simulated.
    """

    def __init__(
        self,
        *,
        is_live: bool,
        now: Callable[[], datetime] = local_now,
        is_right: Callable[[], bool] = is_synchronised,
        shown: Callable[[datetime], WallTime] = time_of_day,
    ) -> None:
        self._is_live = is_live
        self._show = shown
        self._now = now
        self._is_right = is_right
        self._asked_s = -math.inf
        self._shown: WallTime | None = None
        self._began: tuple[datetime, float] | None = None

    def at(self, now_s: float) -> WallTime | None:
        """Return the local time; None while nothing vouches for it."""
        if now_s - self._asked_s >= ASKED_EVERY_S:
            self._asked_s = now_s
            self._shown = self._show(self._local(now_s)) if self._is_right() else None
        return self._shown

    def _local(self, now_s: float) -> datetime:
        if self._is_live:
            return self._now()
        if self._began is None:
            self._began = (self._now(), now_s)
        began, began_s = self._began
        return began + timedelta(seconds=now_s - began_s)


# The local time, the date and the sun's times at a place, as schedules see them -------------------


def wall_time(now: datetime, configuration: Configuration) -> WallTime:
    """Return the time of day, the date and, where a rule asks for it, when the sun rises and sets on that date.

    Args:
        now: In any time zone; without one it is the time of the place.
    """
    place = configuration.place
    zone = place.zone if place is not None else None
    local = now if now.tzinfo is None else now.astimezone(zone)
    shown = time_of_day(local)
    if not configuration.plan.needs_sun or place is None or place.latitude is None or place.longitude is None:
        return shown
    sunrise_s, sunset_s = sun_times_s(place.latitude, place.longitude, zone, local.date())
    return replace(shown, sunrise_s=sunrise_s, sunset_s=sunset_s)
