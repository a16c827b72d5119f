"""When the pictures of a stream were captured, and which of them waited on the way.

A stream's pictures have no capture times on our clock, only arrivals, and an arrival hides how long a picture was on
its way. What can be known: the usual way takes ``latency``, which the user states; and a picture that took longer gives
itself away, by a time stamp that lags, or by coming at a pace that no camera has. Without that, a stream that was held
up for a second looks fresh while it delivers the pictures of that second.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

SETTLE_S = 0.3
"""How long a pace must last to be believed."""

FALL_S = 0.05
"""A stream whose lag still falls by this within `SETTLE_S` is delivering what waited."""

GAP_PERIODS = 3.0
GAP_S = 0.1
"""After a pause longer than this many usual periods, and longer than one by this much, pictures may have waited."""

LONGEST_CATCH_UP_S = 10.0
"""A pace that lasts for this long is believed, whatever it is: the camera has become faster."""

FAST = 0.7
"""Pictures that come after less than this part of the usual period come faster than they were captured."""

GOOD_STAMPS_NEEDED = 3

DRIFT = 2e-4
"""How fast the smallest lag may rise, in seconds a second: two clocks without a common time run apart by this at most.

A quartz is off by 0.05 in a thousand, a clock that is being corrected by 0.5 for some minutes.
"""


class StreamTime:
    """Works out when pictures were captured.

    With time stamps of the sender that are sound, the lag beyond the smallest one seen counts into the age. Stamps are
    sound after three in a row that do not go back; when one does, the judgement begins anew. Without them, pictures
    are passed over after a gap, until they come at the usual pace again; see `Pace`.

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
        """Judge anew, for a stream that was opened again. Capture times still never go back.

        Args:
            settle_s: How long to pass over the pictures of a stream without time stamps.
        """
        self._lag = _Lag()
        self._pace = Pace()
        self._settle_s = settle_s
        self._opened_at_s = math.nan

    def captured_at_s(self, arrived_at_s: float, stamp_s: float = 0.0, pictures: int = 1) -> float | None:
        """Return when a picture was captured.

        Args:
            arrived_at_s: When it arrived, on the run's clock.
            stamp_s: The sender's time stamp, on any clock; 0 if it has none.
            pictures: How many have come since the one before, this one included.

        Returns:
            The time in seconds on the run's clock, never before the last one; None if the picture waited on the way.
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
    """How much longer than the quickest one a picture was on its way, by the sender's time stamps.

    Attributes:
        fell_at_s: When the smallest lag last fell by `FALL_S`.
    """

    def __init__(self) -> None:
        self.fell_at_s = -math.inf
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
    """What has come since a gap.

    Attributes:
        since_s: When the last picture before the gap came.
        began_s: When the first one after it came.
        steady_s: Since when none has come too fast.
        pictures: How many have come.
        steady: The intervals between those that did not come too fast.
    """

    since_s: float
    began_s: float
    steady_s: float
    pictures: int
    steady: list[float] = field(default_factory=list)


class Pace:
    """Tells pictures that waited somewhere from those that come as they are captured, by their arrivals alone.

    After a gap it takes pictures for ones that waited until one of these holds:

    * As many have come as the usual period gives for the whole time, and no longer in a burst.
    * None has come too fast for `SETTLE_S`: the pictures of the gap were dropped elsewhere, or the camera has become
      slower.
    * They have come at their pace for `LONGEST_CATCH_UP_S`.

    The usual period is the mean of the last intervals; the median would be 0 where a radio link delivers pictures in
    threes.
    """

    def __init__(self) -> None:
        self._last_at_s = math.nan
        self._intervals: deque[float] = deque(maxlen=32)
        self._catch_up: _CatchUp | None = None

    def waited(self, arrived_at_s: float, pictures: int = 1) -> bool:
        """Return whether a picture may have waited.

        Args:
            arrived_at_s: When it came.
            pictures: How many have come since the one before, this one included.
        """
        interval_s, self._last_at_s = arrived_at_s - self._last_at_s, arrived_at_s
        if math.isnan(interval_s):
            return False
        if self._catch_up is not None:
            self._catch_up.pictures += pictures
            return self._still_waited(self._catch_up, interval_s, interval_s / pictures)
        if len(self._intervals) < GOOD_STAMPS_NEEDED or interval_s <= self._longest_s():
            self._intervals.append(interval_s / pictures)
            return False
        self._catch_up = _CatchUp(arrived_at_s - interval_s, arrived_at_s, arrived_at_s, pictures)
        return True

    def _period_s(self) -> float:
        return sum(self._intervals) / len(self._intervals)

    def _longest_s(self) -> float:
        return max(GAP_PERIODS * self._period_s(), self._period_s() + GAP_S)

    def _still_waited(self, since: _CatchUp, interval_s: float, each_s: float) -> bool:
        now_s, period_s = self._last_at_s, self._period_s()
        if each_s < FAST * period_s:
            since.steady_s = now_s
            since.steady.clear()
        else:
            since.steady.append(each_s)
        behind_s = now_s - since.since_s - since.pictures * period_s
        caught_up = behind_s < 1.5 * period_s and interval_s > 0.5 * period_s
        is_steady = len(since.steady) >= 3 and now_s - since.steady_s >= SETTLE_S
        if not (caught_up or is_steady or behind_s < -3 * period_s or now_s - since.began_s > LONGEST_CATCH_UP_S):
            return True
        if is_steady or not caught_up:  # the pace is another one than before
            self._intervals.clear()
            self._intervals.extend(since.steady or [each_s])
        self._catch_up = None
        return False
