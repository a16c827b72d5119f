"""Noticing a camera that goes on delivering the same picture."""

from __future__ import annotations

import math

import numpy as np

from stadimeter.core.frame import Frame, Image
from stadimeter.core.safety import FROM_THE_FUTURE_S

FROZEN_AFTER_S = 1.0


class FreezeDetector:
    """Tells new pictures from repeated ones.

    The noise of a sensor makes two exposures differ in some byte, so a picture that equals the one before, byte for
    byte, is that picture again: a driver or a stream that hangs repeats it at full rate, with fresh arrival times. A
    capture time that does not advance shows the same. Robots that trusted such pictures drove into walls. A capture
    time from the future, or one that is no number, is not believed and not remembered: every later frame would look
    old beside it.

    Args:
        frozen_after_s: After how many seconds of repeated pictures the camera counts as frozen.
    """

    def __init__(self, frozen_after_s: float = FROZEN_AFTER_S) -> None:
        self._frozen_after_s = frozen_after_s
        self._image: Image | None = None
        self._captured_at_s = -math.inf
        self._changed_at_s = -math.inf

    def restart(self, now_s: float) -> None:
        """Give the camera its time again, after it was opened. The last picture is remembered.

        Args:
            now_s: The time in seconds.
        """
        self._changed_at_s = now_s

    def is_new(self, frame: Frame, now_s: float) -> bool:
        """Return whether a frame differs from the last new one in its bytes, and was captured later.

        Args:
            frame: What the camera delivered.
            now_s: The time in seconds.

        Returns:
            Whether it is a new picture.
        """
        if not self._captured_at_s < frame.captured_at_s <= now_s + FROM_THE_FUTURE_S or self._repeats(frame.image):
            return False
        self._image = frame.image
        self._captured_at_s = frame.captured_at_s
        self._changed_at_s = now_s
        return True

    def frozen_for_s(self, now_s: float) -> float:
        """Return for how long the picture has not changed, in seconds, or 0 while that is within what is allowed.

        Args:
            now_s: The time in seconds.

        Returns:
            The time since the last new picture or the last `restart`, or 0.
        """
        unchanged_s = now_s - self._changed_at_s
        return unchanged_s if unchanged_s > self._frozen_after_s else 0.0

    def _repeats(self, image: Image) -> bool:
        last = self._image
        if last is None or last.shape != image.shape:
            return False
        # A few rows tell most new pictures from old ones; only a likely repetition is compared in full.
        return np.array_equal(last[::32], image[::32]) and np.array_equal(last, image)
