"""The local time of day, for rules that go by it, and whether it can be believed.

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
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

from stadimeter.core.condition import ScheduleCondition, leaves
from stadimeter.core.observation import WallTime
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule

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
    """Return whether the computer's clock shows the right time."""
    return timesync_file.exists() or _kernel_error_us() < ERROR_MAX_US


def _kernel_error_us() -> float:
    """Return how wrong the clock may be, in microseconds; infinite if the kernel does not say. Changes nothing."""
    try:
        adjtimex = ctypes.CDLL(None).adjtimex
    except (OSError, AttributeError):  # a system without it
        return math.inf
    timex = _Timex()
    return float(timex.maxerror) if adjtimex(ctypes.byref(timex)) >= 0 else math.inf


def local_now() -> datetime:
    """Return the local time."""
    return datetime.now().astimezone()


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
    ) -> None:
        self._is_live = is_live
        self._now = now
        self._is_right = is_right
        self._asked_s = -math.inf
        self._shown: WallTime | None = None
        self._began: tuple[datetime, float] | None = None

    def at(self, now_s: float) -> WallTime | None:
        """Return the local time; None while nothing vouches for it."""
        if now_s - self._asked_s >= ASKED_EVERY_S:
            self._asked_s = now_s
            self._shown = _time_of_day(self._local(now_s)) if self._is_right() else None
        return self._shown

    def _local(self, now_s: float) -> datetime:
        if self._is_live:
            return self._now()
        if self._began is None:
            self._began = (self._now(), now_s)
        began, began_s = self._began
        return began + timedelta(seconds=now_s - began_s)


def _time_of_day(local: datetime) -> WallTime:
    second = 3600 * local.hour + 60 * local.minute + local.second + local.microsecond * 1e-6
    return WallTime(second_of_day=second, weekday=local.weekday())


def goes_by_the_clock(plan: Plan) -> bool:
    """Return whether any rule asks for the time of day."""
    alarms = (rule for rule in plan.rules if isinstance(rule, AlarmRule))
    conditions = (condition for rule in alarms for condition in (rule.condition, rule.suppress_when) if condition)
    return any(isinstance(leaf, ScheduleCondition) for condition in conditions for leaf in leaves(condition))
