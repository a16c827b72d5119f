"""Capture times of frames, from the driver's or the sender's time stamps and from arrivals.

`DriverStamp` serves devices: the kernel stamps their frames on a clock that we can read. `StreamTime` serves streams,
whose pictures have at most stamps of another clock. An arrival hides how long a picture was on its way. What can be
known: the usual way takes ``latency``, which the user states; and a picture that took longer gives itself away, by a
time stamp that lags, by coming at a pace that no camera has, or with the next one on its heels. Without that, a stream
that was held up for a second looks fresh while it delivers the pictures of that second.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable

# The pace at which pictures arrive, and what it tells of pictures that waited on the way ------------------------------

# Time that a pace must last to be believed.
SETTLE_S = 0.3

# After a pause longer than this many usual periods, and longer than one by this much, pictures may have waited.
GAP_PERIODS = 3.0
GAP_S = 0.1

# The usual period is the mean of so many intervals; the shortest such mean where nothing but arrivals is known.
USUAL_INTERVALS = 32
BLIND_INTERVALS = 128

# Pictures that come after less than this part of the usual period, on the average, come faster than captured.
FAST = 0.85

# After a gap as long as the age that stops a robot, a long queue that drains slowly matters. So the pace is measured
# for longer, which tells 3 % from a jitter of 10 ms, before what waited counts as dropped.
LONG_GAP_S = 0.2
LONG_SETTLE_S = 1.5
LONG_FAST = 0.97

# The mean of `USUAL_INTERVALS` with a jitter of a third of a period is known to this part. So after 5 s at 30 pictures
# a second their number alone no longer says that a queue is empty.
PERIOD_ERROR = 0.01

# A pace that lasts for so many times the gap is believed, whatever it is: a queue would be empty, had it drained at
# 1 / `LONG_FAST`. The camera has become faster.
MAX_CATCH_UP_GAPS = 33.0
MIN_CATCH_UP_S = 10.0

# Where nothing but arrivals is known, a pace that is slower than the usual one by this may be a lag that builds up, and
# is believed after a minute. Pictures that come in threes make the shortest mean of 128 periods 2 % too short.
SLOWER = 1.05
SLOWER_AFTER_S = 60.0
BLIND_SETTLE_S = 2.0
BLIND_FAST = 0.95
MAX_BEHIND_S = 0.15

# Time and pictures that say something of a pace.
PICTURES_NEEDED = 3


class ArrivalPace:
    """Tells pictures that waited somewhere from those that come as they are captured, by their arrivals alone.

    After a gap it takes pictures for ones that waited until one of these holds:

    * As many have come as the usual period gives for the whole time, and no longer in a burst.
    * They have come no faster than usual for `SETTLE_S`, after a long gap for `LONG_SETTLE_S`, on the average and
      without another gap: the pictures of the gap were dropped elsewhere, or the camera has become slower.
    * More have come than the usual period gives, or so much time has passed that any queue is empty: the camera has
      become faster.

    The usual period is the mean of the last intervals; the median would be 0 where a radio link delivers pictures in
    threes.

    Args:
        is_blind: Whether nothing else would show a lag that builds up. Then the usual period is the shortest mean so
            far, pictures that fall behind it bit by bit count as a gap too, and a slower pace is believed only after
            `SLOWER_AFTER_S`.
        has_long_queue: Whether many pictures may wait, as in a sender; a device keeps four or so.
    """

    def __init__(self, *, is_blind: bool = False, has_long_queue: bool = False) -> None:
        self.is_slower = False
        self._is_blind = is_blind
        self._has_long_queue = has_long_queue
        self._settle_s, self._fast = (BLIND_SETTLE_S, BLIND_FAST) if is_blind else (SETTLE_S, FAST)
        self._last_at_s = math.nan
        self._usual: deque[tuple[float, int]] = deque(maxlen=BLIND_INTERVALS if is_blind else USUAL_INTERVALS)
        self._shortest_s = math.inf
        self._behind_s = 0.0
        self._is_reopened = False
        # Since a gap: when the last picture before it came, and when pictures came since, with how many had by then.
        self._gap_from_s = math.nan
        self._longest_gap_s = 0.0
        self._came: list[tuple[float, int]] = []

    @property
    def is_known(self) -> bool:
        """True if enough pictures have come to know the usual period."""
        return sum(pictures for _, pictures in self._usual) >= PICTURES_NEEDED

    def restart(self) -> None:
        """Take what comes next for pictures after a gap: a sender whose stream is opened again may keep a queue."""
        self._is_reopened = True

    def waited(self, arrived_at_s: float, pictures: int = 1) -> bool:
        """Check whether a picture may have waited; `pictures` came since the one before, this one included."""
        last_s, self._last_at_s = self._last_at_s, arrived_at_s
        if math.isnan(last_s):
            return False
        interval_s = arrived_at_s - last_s
        if not self._came:
            if not self._is_gap(interval_s, pictures):
                self._learn(interval_s, pictures)
                return False
            self._longest_gap_s = max(interval_s, self._behind_s)
            self._gap_from_s, self._came = arrived_at_s - self._longest_gap_s, [(arrived_at_s, pictures)]
            return True
        self._came.append((arrived_at_s, self._came[-1][1] + pictures))
        if not self._still_waited(interval_s):
            self._came, self._behind_s, self.is_slower = [], 0.0, False
        return bool(self._came)

    def _learn(self, interval_s: float, pictures: int) -> None:
        self._usual.append((interval_s, pictures))
        if len(self._usual) == self._usual.maxlen:
            self._shortest_s = min(self._shortest_s, self._mean_s())

    def _is_gap(self, interval_s: float, pictures: int) -> bool:
        is_reopened, self._is_reopened = self._is_reopened, False
        if not self.is_known:
            return False
        period_s = self._period_s()
        self._behind_s = max(0.0, self._behind_s + interval_s - SLOWER * pictures * period_s)
        is_slipping = self._is_blind and self._behind_s > max(MAX_BEHIND_S, 2.0 * period_s)
        return is_reopened or is_slipping or interval_s > _gap_s(period_s)

    def _period_s(self) -> float:
        return min(self._shortest_s, self._mean_s()) if self._is_blind else self._mean_s()

    def _mean_s(self) -> float:
        return sum(interval_s for interval_s, _ in self._usual) / sum(pictures for _, pictures in self._usual)

    def _still_waited(self, interval_s: float) -> bool:
        now_s, pictures = self._came[-1]
        period_s = self._period_s()
        behind_s = now_s - self._gap_from_s - (1 - PERIOD_ERROR) * pictures * period_s
        if behind_s < 1.5 * period_s and interval_s > 0.5 * period_s:
            return False
        self._longest_gap_s = max(self._longest_gap_s, interval_s)
        settle_s, fast = self._settle_s, self._fast
        if self._has_long_queue and self._longest_gap_s > LONG_GAP_S:
            settle_s, fast = max(settle_s, LONG_SETTLE_S), LONG_FAST
        recent = self._last(settle_s, USUAL_INTERVALS if self._is_blind else PICTURES_NEEDED)
        if recent is not None and self._is_blind:
            self.is_slower = recent[0] > SLOWER * period_s * recent[1] + 0.5 * period_s
            recent = self._last(SLOWER_AFTER_S) if self.is_slower else recent
        # Half a window of a slow link and half a burst look steady together, so the newest part is judged by itself.
        newest = self._last(SETTLE_S)
        is_burst = newest is None or newest[0] < FAST * period_s * newest[1]
        is_steady = recent is not None and recent[0] >= fast * period_s * recent[1] and not is_burst
        catch_up_s = max(MIN_CATCH_UP_S, MAX_CATCH_UP_GAPS * self._longest_gap_s)
        is_over = now_s - self._came[0][0] > catch_up_s and not (self._is_blind and recent is None)
        is_faster = behind_s < -3 * period_s or (is_over and not self.is_slower)
        if recent is not None and (is_faster or (is_steady and (self.is_slower or not self._is_blind))):
            self._usual = deque([recent], maxlen=self._usual.maxlen)
            self._shortest_s = math.inf
        return not (is_steady or is_faster)

    def _last(self, seconds: float, count: int = PICTURES_NEEDED) -> tuple[float, int] | None:
        """Return a time up to now, no shorter, and the pictures in it, no fewer; None if that is too soon to say.

        There is no gap in it: a pause, and a queue that drains after it, look steady together.
        """
        now_s, pictures = self._came[-1]
        intervals_s, last_s = [], now_s
        for at_s, before in reversed(self._came[:-1]):
            intervals_s.append(last_s - at_s)
            last_s = at_s
            if now_s - at_s >= seconds and pictures - before >= count:
                middle_s = sorted(intervals_s)[len(intervals_s) // 2]
                is_even = max(intervals_s) <= _gap_s(max(middle_s, self._period_s()))
                return (now_s - at_s, pictures - before) if is_even else None
        return None


def _gap_s(period_s: float) -> float:
    """Return the shortest pause in which pictures may have waited."""
    return max(GAP_PERIODS * period_s, period_s + GAP_S)


# A stream whose lag still falls by this within `SETTLE_S` is delivering what waited.
FALL_S = 0.05

# Pictures begin without a pause after the one before for longer than this, or most on a running mean: the link has no
# pauses, so a lag builds up. It has them again when that is so for few. On a link that is too slow 1 picture in 8 looks
# otherwise, by the jitter of its packets; with pauses nearly all do.
BACKED_UP_S = 0.3
BACKED_UP_SHARE = 0.6
PAUSES_SHARE = 0.3
WEIGHT_OF_NEW = 0.15

# Stamps are trusted after this many sane ones in a row.
GOOD_STAMPS_NEEDED = 3

# A sender whose stamps were sound so often in a row has a clock: from then on nothing is believed without it.
PROVEN = 30

# A way that is shorter than the shortest so far by more than this at once: the sender's clock was set.
STEP_S = 0.1

# Greatest rise of the smallest lag, in seconds a second: two clocks without a common time run apart by this at most.
#
# A quartz is off by 0.05 in a thousand, a clock that is being corrected by 0.5 for some minutes.
DRIFT = 2e-4

# Why pictures are late.
WAITED = "they waited on the way"
BACKED_UP = (
    "they come without a pause, so the link is slower than the stream; lower its size, rate or quality, or let its"
    " sender write time stamps"
)
SLOWER_PACE = (
    "they come slower than they did, so a lag may build up;"
    f" after {SLOWER_AFTER_S:g} s that counts as the camera's pace"
)
NO_STAMP = "the sender's time stamps are missing or go back"


class StreamTime:
    """Works out when pictures were captured.

    With time stamps of the sender that are sound, the lag beyond the smallest one seen counts into the age. Stamps are
    sound after three in a row that do not go back. When the sender's clock is set, the lag that was known is kept: what
    comes may be as old as what came before. Stamps that stand still do not advance the capture time either.

    Without stamps, pictures are passed over after a gap, until they come at the usual pace again (see `ArrivalPace`),
    and while the link is backed up: when nearly each picture begins without a pause after the one before. A camera that
    exposes for longer leaves pauses; a link that is too slow has none, and pictures queue up in the sender's buffers
    without a sign in the stream. A slower pace is the camera's only where pauses are seen, else it is taken for a lag.

    A stream that was just opened may deliver what waited, too: FFmpeg looks at it for up to five seconds before it
    gives the first picture, and keeps what came meanwhile. Then the smallest lag falls from picture to picture, and
    nothing is believed until it stays. Without time stamps the first pictures are passed over for a fixed time, and
    until they come at the pace from before.

    Args:
        latency_s: How old a picture is on arrival when nothing holds it up.
    """

    def __init__(self, latency_s: float = 0.0) -> None:
        self._latency_s = latency_s
        self._last_captured_s = -math.inf
        self._pace = ArrivalPace(has_long_queue=True)
        self._blind_pace = ArrivalPace(is_blind=True, has_long_queue=True)
        self._has_clock = False
        self.why_late = ""
        self.restart()

    def restart(self, settle_s: float = SETTLE_S) -> None:
        """Judge anew, for a stream that was opened again, which without stamps starts with pictures to pass over.

        Capture times still never go back, and the usual pace is remembered.
        """
        self._lag = _Lag()
        self._pace.restart()
        self._blind_pace.restart()
        self._settle_s = settle_s
        self._opened_at_s = math.nan
        self._emptied_at_s = -math.inf
        self._begun_share, self._is_backed_up = BACKED_UP_SHARE, False

    def captured_at_s(
        self, arrived_at_s: float, stamp_s: float = 0.0, pictures: int = 1, *, has_begun: bool | None = None
    ) -> float | None:
        """Return when a picture was captured, on the run's clock, never before the last one; None if it waited.

        Args:
            stamp_s: The sender's time stamp, on any clock; 0 if it has none.
            pictures: How many have come since the one before, this one included.
            has_begun: Whether it began to arrive without a pause after the one before; None if that is not known.
        """
        if math.isnan(self._opened_at_s):
            self._opened_at_s = arrived_at_s
        lag_s = self._lag.lag_s(arrived_at_s, stamp_s)
        self._has_clock = self._has_clock or self._lag.is_proven
        self.why_late = self._why_late_without_stamps(arrived_at_s, pictures, has_begun)
        if lag_s is not None:
            self.why_late = WAITED if arrived_at_s - self._lag.fell_at_s < SETTLE_S else ""
        elif self._has_clock:
            self.why_late = NO_STAMP
        if self.why_late:
            return None
        if not self._lag.is_still:
            self._last_captured_s = max(self._last_captured_s, arrived_at_s - self._latency_s - (lag_s or 0.0))
        return self._last_captured_s

    def _why_late_without_stamps(self, arrived_at_s: float, pictures: int, has_begun: bool | None) -> str:
        is_settling = arrived_at_s - self._opened_at_s < self._settle_s
        if is_settling and not self._pace.is_known:
            return WAITED  # a pace learnt from what waited while the stream was opened would be too fast
        waited, waited_blindly = (pace.waited(arrived_at_s, pictures) for pace in (self._pace, self._blind_pace))
        self._look_for_pauses(arrived_at_s, has_begun)
        if self._is_backed_up:
            return BACKED_UP
        has_pauses = arrived_at_s - self._emptied_at_s <= BACKED_UP_S
        if waited_blindly and not has_pauses and self._blind_pace.is_slower:
            return SLOWER_PACE
        return WAITED if is_settling or (waited if has_pauses else waited_blindly) else ""

    def _look_for_pauses(self, arrived_at_s: float, has_begun: bool | None) -> None:
        if has_begun is None:
            return
        self._begun_share += WEIGHT_OF_NEW * (has_begun - self._begun_share)
        if not has_begun:
            self._emptied_at_s = arrived_at_s
        elif arrived_at_s - self._emptied_at_s > BACKED_UP_S:
            self._begun_share = 1.0
        self._is_backed_up = self._begun_share > (PAUSES_SHARE if self._is_backed_up else BACKED_UP_SHARE)


class _Lag:
    """Lag of pictures behind the quickest one, by the sender's time stamps."""

    def __init__(self) -> None:
        self.fell_at_s = -math.inf  # when the smallest lag last fell by `FALL_S`
        self._fell_to_s = math.inf
        self._good_in_a_row = 0
        self._last_stamp_s = math.inf
        self._smallest_s = math.inf
        self._judged_at_s = -math.inf
        self.is_still = False  # whether the last stamp, which was trusted, came again
        self._known_s = 0.0  # the lag of the last picture whose stamp was trusted

    @property
    def is_proven(self) -> bool:
        """True if the stamps were sound for so long that the sender has a clock."""
        return self._good_in_a_row >= PROVEN

    def lag_s(self, arrived_at_s: float, stamp_s: float) -> float | None:
        """Return the lag in seconds, or None while the stamps are not believed.

        Stamps that stay the same are not, before they were: they may be in whole seconds.
        """
        last_s, self._last_stamp_s = self._last_stamp_s, stamp_s
        self.is_still = stamp_s == last_s and self._good_in_a_row >= GOOD_STAMPS_NEEDED
        if self.is_still:
            return self._known_s
        if not 0 < last_s < stamp_s < math.inf:
            self._good_in_a_row, self._smallest_s, self._fell_to_s = 0, math.inf, math.inf
            return None
        self._good_in_a_row += 1
        way_s = arrived_at_s - stamp_s
        if way_s < self._smallest_s - STEP_S:
            self._smallest_s = way_s - self._known_s
        self._smallest_s = min(self._smallest_s + DRIFT * (arrived_at_s - self._judged_at_s), way_s)
        self._judged_at_s = arrived_at_s
        if self._smallest_s < self._fell_to_s - FALL_S:
            self._fell_to_s, self.fell_at_s = self._smallest_s, arrived_at_s
        if self._good_in_a_row < GOOD_STAMPS_NEEDED:
            return None
        self._known_s = way_s - self._smallest_s
        return self._known_s


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
        """True while capture times are the driver's stamps."""
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
