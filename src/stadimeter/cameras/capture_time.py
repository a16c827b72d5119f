"""Capture times of frames, from the driver's or the sender's time stamps and from arrivals.

`DriverStamp` serves devices: the kernel stamps their frames on a clock that we can read. `StreamTime` serves streams,
whose pictures have at most stamps of another clock. An arrival hides how long a picture was on its way. What can be
known: the usual way takes ``latency``, which the user states; and a picture that took longer gives itself away, by a
time stamp that lags, or by coming at a pace that no camera has. Without that, a stream that was held up for a second
looks fresh while it delivers the pictures of that second.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

# Time that a pace must last to be believed.
SETTLE_S = 0.3

# A stream whose lag still falls by this within `SETTLE_S` is delivering what waited.
FALL_S = 0.05

# After a pause longer than this many usual periods, and longer than one by this much, pictures may have waited.
GAP_PERIODS = 3.0
GAP_S = 0.1

# A pace that lasts for this long is believed, whatever it is: the camera has become faster.
MAX_CATCH_UP_S = 10.0

# Pictures that come after less than this part of the usual period, on the average, come faster than captured.
FAST = 0.85

# Stamps are trusted after this many sane ones in a row.
PICTURES_NEEDED = 3
GOOD_STAMPS_NEEDED = 3

# Greatest rise of the smallest lag, in seconds a second: two clocks without a common time run apart by this at most.
#
# A quartz is off by 0.05 in a thousand, a clock that is being corrected by 0.5 for some minutes.
DRIFT = 2e-4


class StreamTime:
    """Works out when pictures were captured.

    With time stamps of the sender that are sound, the lag beyond the smallest one seen counts into the age. Stamps are
    sound after three in a row that do not go back; when one does, the judgement begins anew. Without them, pictures
    are passed over after a gap, until they come at the usual pace again; see `ArrivalPace`.

    A stream that was just opened may deliver what waited, too: FFmpeg looks at it for up to five seconds before it
    gives the first picture, and keeps what came meanwhile. Then the smallest lag falls from picture to picture, and
    nothing is believed until it stays. Without time stamps the first pictures are passed over for a fixed time.

    Args:
        latency_s: How old a picture is on arrival when nothing holds it up.
    """

    def __init__(self, latency_s: float = 0.0) -> None:
        self._latency_s = latency_s
        self._last_captured_s = -math.inf
        self.restart()

    def restart(self, settle_s: float = SETTLE_S) -> None:
        """Judge anew, for a stream that was opened again, which without stamps starts with pictures to pass over.

        Capture times still never go back.
        """
        self._lag = _Lag()
        self._pace = ArrivalPace()
        self._settle_s = settle_s
        self._opened_at_s = math.nan

    def captured_at_s(self, arrived_at_s: float, stamp_s: float = 0.0, pictures: int = 1) -> float | None:
        """Return when a picture was captured, on the run's clock, never before the last one; None if it waited.

        Args:
            stamp_s: The sender's time stamp, on any clock; 0 if it has none.
            pictures: How many have come since the one before, this one included.
        """
        if math.isnan(self._opened_at_s):
            self._opened_at_s = arrived_at_s
        waited = self._pace.waited(arrived_at_s, pictures)
        lag_s = self._lag.lag_s(arrived_at_s, stamp_s)
        if lag_s is None:
            waited = waited or arrived_at_s - self._opened_at_s < self._settle_s
            lag_s = 0.0
        else:
            waited = arrived_at_s - self._lag.fell_at_s < SETTLE_S
        if waited:
            return None
        self._last_captured_s = max(self._last_captured_s, arrived_at_s - self._latency_s - lag_s)
        return self._last_captured_s


class _Lag:
    """Lag of pictures behind the quickest one, by the sender's time stamps."""

    def __init__(self) -> None:
        self.fell_at_s = -math.inf  # when the smallest lag last fell by `FALL_S`
        self._fell_to_s = math.inf
        self._good_in_a_row = 0
        self._last_stamp_s = math.inf
        self._smallest_s = math.inf
        self._judged_at_s = -math.inf

    def lag_s(self, arrived_at_s: float, stamp_s: float) -> float | None:
        """Return the lag in seconds, or None while the stamps are not believed.

        Stamps that stay the same are not: they may be in whole seconds. A picture that stands still is noticed by its
        bytes.
        """
        last_s, self._last_stamp_s = self._last_stamp_s, stamp_s
        if not 0 < last_s < stamp_s < math.inf:
            self._good_in_a_row, self._smallest_s, self._fell_to_s = 0, math.inf, math.inf
            return None
        self._good_in_a_row += 1
        way_s = arrived_at_s - stamp_s
        self._smallest_s = min(self._smallest_s + DRIFT * (arrived_at_s - self._judged_at_s), way_s)
        self._judged_at_s = arrived_at_s
        if self._smallest_s < self._fell_to_s - FALL_S:
            self._fell_to_s, self.fell_at_s = self._smallest_s, arrived_at_s
        return way_s - self._smallest_s if self._good_in_a_row >= GOOD_STAMPS_NEEDED else None


@dataclass(slots=True)
class _CatchUp:
    """Pictures that came since a gap."""

    since_s: float  # when the last picture before the gap came
    # When pictures came since, and how many had come by then.
    came: list[tuple[float, int]] = field(default_factory=list)

    def recent(self) -> tuple[float, int] | None:
        """Return a time up to now, `SETTLE_S` or longer, and the pictures in it; None if that is too soon to say."""
        now_s, pictures = self.came[-1]
        times = ((now_s - at_s, pictures - before) for at_s, before in reversed(self.came))
        return next((found for found in times if found[0] >= SETTLE_S and found[1] >= PICTURES_NEEDED), None)


class ArrivalPace:
    """Tells pictures that waited somewhere from those that come as they are captured, by their arrivals alone.

    After a gap it takes pictures for ones that waited until one of these holds:

    * As many have come as the usual period gives for the whole time, and no longer in a burst.
    * They have come no faster than usual for `SETTLE_S`, on the average: the pictures of the gap were dropped
      elsewhere, or the camera has become slower.
    * More have come than the usual period gives, or `MAX_CATCH_UP_S` have passed: the camera has become faster.

    The usual period is the mean of the last intervals; the median would be 0 where a radio link delivers pictures in
    threes.
    """

    def __init__(self) -> None:
        self._last_at_s = math.nan
        self._usual: deque[tuple[float, int]] = deque(maxlen=32)
        self._catch_up: _CatchUp | None = None

    def waited(self, arrived_at_s: float, pictures: int = 1) -> bool:
        """Return whether a picture may have waited; `pictures` came since the one before, this one included."""
        last_s, self._last_at_s = self._last_at_s, arrived_at_s
        if math.isnan(last_s):
            return False
        interval_s = arrived_at_s - last_s
        if self._catch_up is None:
            if not self._is_gap(interval_s):
                self._usual.append((interval_s, pictures))
                return False
            self._catch_up = _CatchUp(last_s, [(arrived_at_s, pictures)])
            return True
        self._catch_up.came.append((arrived_at_s, self._catch_up.came[-1][1] + pictures))
        if self._still_waited(self._catch_up, interval_s):
            return True
        self._catch_up = None
        return False

    def _is_gap(self, interval_s: float) -> bool:
        if sum(pictures for _, pictures in self._usual) < PICTURES_NEEDED:
            return False
        return interval_s > max(GAP_PERIODS * self._period_s(), self._period_s() + GAP_S)

    def _period_s(self) -> float:
        return sum(interval_s for interval_s, _ in self._usual) / sum(pictures for _, pictures in self._usual)

    def _still_waited(self, catch_up: _CatchUp, interval_s: float) -> bool:
        now_s, pictures = catch_up.came[-1]
        period_s = self._period_s()
        behind_s = now_s - catch_up.since_s - pictures * period_s
        if behind_s < 1.5 * period_s and interval_s > 0.5 * period_s:
            return False
        recent = catch_up.recent()
        is_steady = recent is not None and recent[0] >= FAST * period_s * recent[1]
        is_faster = behind_s < -3 * period_s or now_s - catch_up.came[0][0] > MAX_CATCH_UP_S
        if recent is not None and (is_steady or is_faster):
            self._usual = deque([recent], maxlen=self._usual.maxlen)
        return not (is_steady or is_faster)


# A stamp that is older than this before any was trusted belongs to another clock.
MAX_FIRST_AGE_S = 1.0

# The run's clock and the kernel's stand apart by this much more than before when the computer was suspended.
SUSPENDED_S = 0.05


class KernelTime:
    """Brings the stamps of the kernel, which are on ``CLOCK_MONOTONIC``, to the run's clock.

    That clock stands still while the computer is suspended, and the run's goes on. A picture that was captured before a
    suspend and is read after it is as old as the suspend was long; the offset of now would make it fresh.
    """

    def __init__(self, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._monotonic = monotonic
        self._offset_s = math.inf
        self._offset_before_s = -math.inf
        self._changed_at_s = -math.inf

    def on_run_clock(self, stamp_s: float, now_s: float) -> float:
        """Return a stamp in seconds on the run's clock, which was read just before; 0 if there is none."""
        if stamp_s <= 0:
            return 0.0
        kernel_now_s = self._monotonic()
        last_s, self._offset_s = self._offset_s, now_s - kernel_now_s
        if self._offset_s > last_s + SUSPENDED_S:
            self._offset_before_s, self._changed_at_s = last_s, kernel_now_s
        return stamp_s + (self._offset_before_s if stamp_s <= self._changed_at_s else self._offset_s)


class DriverStamp:
    """Judges each frame's stamp, and returns capture times that never go back.

    A stamp is sane if it lies on the run's clock: not after the frame's arrival, at most a second before it, and after
    the stamp before. Stamps are used after three sane ones in a row, and until one is not. A driver that has no stamps
    (it returns 0), or has them on another clock, is never trusted. The first two sane ones after opening say nothing
    yet, and the frame's arrival would make it look fresher than it is: these frames are to be passed over.

    Two cases keep to the stamp on purpose, since arrival would make old data look fresh. A trusted stamp that is older
    than a second belongs to a frame that waited unread in the driver's queue. A trusted stamp that stays
    the same belongs to a picture that stands still: the capture time then does not advance, which shows that the camera
    is frozen.

    Args:
        latency_s: How old a frame is on arrival; it counts where the stamp is not trusted.
    """

    def __init__(self, latency_s: float = 0.0) -> None:
        self._latency_s = latency_s
        self._last_captured_s = -math.inf
        self.restart()

    @property
    def is_trusted(self) -> bool:
        """Whether capture times are the driver's stamps at present."""
        return self._good_in_a_row >= GOOD_STAMPS_NEEDED

    def restart(self) -> None:
        """Judge anew, for a device that was opened again. Capture times still never go back."""
        self._good_in_a_row = 0
        self._last_stamp_s = -math.inf
        self._is_settling = True

    def captured_at_s(self, stamp_s: float, arrived_at_s: float) -> float | None:
        """Return when a frame was captured, on the run's clock, never before the last one; None if it is too soon.

        No stamp is 0.
        """
        self._judge(stamp_s, arrived_at_s)
        self._is_settling = self._is_settling and 0 < self._good_in_a_row < GOOD_STAMPS_NEEDED
        if self._is_settling:
            return None
        chosen_s = stamp_s if self.is_trusted else arrived_at_s - self._latency_s
        self._last_captured_s = max(self._last_captured_s, chosen_s)
        return self._last_captured_s

    def _judge(self, stamp_s: float, arrived_at_s: float) -> None:
        if self.is_trusted and stamp_s == self._last_stamp_s:
            return
        age_s = arrived_at_s - stamp_s
        oldest_s = math.inf if self.is_trusted else MAX_FIRST_AGE_S
        is_sane = stamp_s > 0 and 0 <= age_s < oldest_s and stamp_s > self._last_stamp_s
        self._good_in_a_row = self._good_in_a_row + 1 if is_sane else 0
        self._last_stamp_s = stamp_s
