"""When a frame was captured: the driver's time stamp where it can be trusted, else the frame's arrival."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

OLDEST_AT_FIRST_S = 1.0
"""A stamp that is older than this before any was trusted belongs to another clock."""

GOOD_STAMPS_NEEDED = 3
"""How many sane stamps in a row make stamps trusted."""

SUSPENDED_S = 0.05
"""The run's clock and the kernel's stand apart by this much more than before when the computer was suspended."""


class KernelTime:
    """Brings the stamps of the kernel, which are on ``CLOCK_MONOTONIC``, to the run's clock.

    That clock stands still while the computer is suspended, and the run's goes on. A picture that was captured before
    a suspend and is read after it is as old as the suspend was long; the offset of now would make it fresh.

    Args:
        monotonic: ``CLOCK_MONOTONIC``; another one is for tests.
    """

    def __init__(self, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._monotonic = monotonic
        self._offset_s = math.inf
        self._offset_before_s = -math.inf
        self._changed_at_s = -math.inf

    def on_run_clock(self, stamp_s: float, now_s: float) -> float:
        """Return a stamp on the run's clock.

        Args:
            stamp_s: The kernel's stamp in seconds, 0 or less if there is none.
            now_s: The run's clock, read just before.

        Returns:
            The stamp in seconds, or 0.
        """
        if stamp_s <= 0:
            return 0.0
        kernel_now_s = self._monotonic()
        last_s, self._offset_s = self._offset_s, now_s - kernel_now_s
        if self._offset_s > last_s + SUSPENDED_S:
            self._offset_before_s, self._changed_at_s = last_s, kernel_now_s
        return stamp_s + (self._offset_before_s if stamp_s <= self._changed_at_s else self._offset_s)


class FrameStamp:
    """Judges each frame's stamp, and returns capture times that never go back.

    A stamp is sane if it lies on the run's clock: not after the frame's arrival, at most a second before it, and after
    the stamp before. Stamps are used after three sane ones in a row, and until one is not. A driver that has no stamps
    (it returns 0), or has them on another clock, is never trusted.

    Two cases keep to the stamp on purpose, since arrival would make old data look fresh. A trusted stamp that is older
    than a second belongs to a frame that waited in the driver's queue while nobody read. A trusted stamp that stays
    the same belongs to a picture that stands still: the capture time then does not advance, and whoever watches it
    sees that the camera is frozen.

    Args:
        latency_s: How old a frame is on arrival; it counts where the stamp is not trusted.
    """

    def __init__(self, latency_s: float = 0.0) -> None:
        self._latency_s = latency_s
        self._good_in_a_row = 0
        self._last_stamp_s = -math.inf
        self._last_captured_s = -math.inf

    @property
    def is_trusted(self) -> bool:
        """Whether capture times are the driver's stamps at present."""
        return self._good_in_a_row >= GOOD_STAMPS_NEEDED

    def restart(self) -> None:
        """Judge anew, for a device that was opened again. Capture times still never go back."""
        self._good_in_a_row = 0
        self._last_stamp_s = -math.inf

    def captured_at_s(self, stamp_s: float, arrived_at_s: float) -> float:
        """Return when a frame was captured.

        Args:
            stamp_s: The driver's time stamp in seconds, 0 if it has none.
            arrived_at_s: When the frame arrived, on the run's clock.

        Returns:
            The capture time in seconds on the run's clock, never before the last one.
        """
        self._judge(stamp_s, arrived_at_s)
        chosen_s = stamp_s if self.is_trusted else arrived_at_s - self._latency_s
        self._last_captured_s = max(self._last_captured_s, chosen_s)
        return self._last_captured_s

    def _judge(self, stamp_s: float, arrived_at_s: float) -> None:
        if self.is_trusted and stamp_s == self._last_stamp_s:
            return
        age_s = arrived_at_s - stamp_s
        oldest_s = math.inf if self.is_trusted else OLDEST_AT_FIRST_S
        is_sane = stamp_s > 0 and 0 <= age_s < oldest_s and stamp_s > self._last_stamp_s
        self._good_in_a_row = self._good_in_a_row + 1 if is_sane else 0
        self._last_stamp_s = stamp_s
