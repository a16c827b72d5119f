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
from collections.abc import Callable

from stadimeter.cameras.arrival_pace import SETTLE_S, SLOWER_AFTER_S, ArrivalPace

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
