"""When a frame was captured: the driver's time stamp where it can be trusted, else the frame's arrival."""

from __future__ import annotations

import math

OLDEST_AT_FIRST_S = 1.0
"""A stamp that is older than this before any was trusted belongs to another clock."""

GOOD_STAMPS_NEEDED = 3
"""How many sane stamps in a row make stamps trusted."""


class FrameStamp:
    """Judges each frame's stamp, and returns capture times that never go back.

    A stamp is sane if it lies on the run's clock: not after the frame's arrival, at most a second before it, and after
    the stamp before. Stamps are used after three sane ones in a row, and until one is not. A driver that has no stamps
    (it returns 0), or has them on another clock, is never trusted.

    Two cases keep to the stamp on purpose, since arrival would make old data look fresh. A trusted stamp that is older
    than a second belongs to a frame that waited in the driver's queue while nobody read. A trusted stamp that stays
    the same belongs to a picture that stands still: the capture time then does not advance, and whoever watches it
    sees that the camera is frozen.
    """

    def __init__(self) -> None:
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
        chosen_s = stamp_s if self.is_trusted else arrived_at_s
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
