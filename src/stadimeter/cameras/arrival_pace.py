"""The pace at which pictures arrive, and what it tells of pictures that waited on the way."""

from __future__ import annotations

import math
from collections import deque

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
