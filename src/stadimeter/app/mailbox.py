"""A mailbox of one: between the thread that reads the camera and the loop."""

from __future__ import annotations

import threading

from stadimeter.core.frame import Frame


class Mailbox:
    """Holds the newest frame until somebody takes it. A newer frame takes the place of one that nobody took."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._frame: Frame | None = None
        self._is_closed = False
        self._passed_over = 0

    @property
    def passed_over(self) -> int:
        """How many frames were replaced before anybody took them."""
        return self._passed_over

    def put(self, frame: Frame) -> None:
        """Put in a frame, in place of the one that is there. A closed mailbox takes none."""
        with self._changed:
            if self._is_closed:
                return
            self._passed_over += self._frame is not None
            self._frame = frame
            self._changed.notify()

    def take(self, timeout_s: float) -> Frame | None:
        """Take out the frame; wait for one if there is none.

        Args:
            timeout_s: How long to wait, in real seconds.

        Returns:
            The frame, or None if none came in time or the mailbox is closed.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._frame is not None or self._is_closed, timeout_s)
            frame, self._frame = self._frame, None
            return frame

    def close(self) -> None:
        """Take no more frames, and let whoever waits go."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
