"""What a base owes us: which commands it has not answered yet, and since when it is silent."""

from __future__ import annotations

STOP_REPEATED_AFTER_S = 0.1

LOOK_S = 0.05
"""The time between two looks at the line counts as silence up to this."""


class Acknowledgements:
    """Counts commands and their answers on a line where each command gets one, in order.

    A lost answer must not count as a lost link for ever. Therefore silence is counted from the first command that was
    sent after the last answer, not from the oldest one that was never answered.

    Silence is time in which the line was read. When this process waits for a processor, the clock goes on and nothing
    is read; and a command may leave the computer long after its time was noted. So silence adds up from look to look,
    and a gap between two looks counts for `LOOK_S` at most: ten looks in a row must have found nothing.
    """

    def __init__(self) -> None:
        self._unanswered = 0
        self._silent_s: float | None = None
        self._looked_s = 0.0
        self._stop_sent_s: float | None = None

    def sent(self, now_s: float, *, stop: bool) -> None:
        """Note that a command was sent.

        Args:
            stop: Whether it told the base to stand still. Any other command takes an earlier stop back.
        """
        self._unanswered += 1
        self._stop_sent_s = now_s if stop else None
        if self._silent_s is None:
            self._silent_s, self._looked_s = 0.0, now_s

    def looked(self, now_s: float) -> None:
        """Note that everything which had arrived at that time was read."""
        if self._silent_s is not None:
            self._silent_s += min(max(0.0, now_s - self._looked_s), LOOK_S)
            self._looked_s = now_s

    def repeating(self) -> None:
        """Note that a command is about to be repeated, so the answers that are still missing will not come."""
        self._unanswered = 0

    def acknowledged(self) -> None:
        """Note that a command was done. With the last one that is waited for, a stop is known to have arrived."""
        self._answered()
        if not self._unanswered:
            self._stop_sent_s = None

    def refused(self) -> None:
        """Note that a command was answered, but not done: a stop must be repeated."""
        self._answered()

    def stop_is_overdue(self, now_s: float) -> bool:
        """Return whether a stop was sent at least `STOP_REPEATED_AFTER_S` ago and is not acknowledged."""
        return self._stop_sent_s is not None and now_s - self._stop_sent_s >= STOP_REPEATED_AFTER_S

    @property
    def silent_s(self) -> float:
        """For how long commands have been sent and the line was read without any answer; 0 if none is waited for."""
        return self._silent_s or 0.0

    def _answered(self) -> None:
        self._unanswered = max(0, self._unanswered - 1)
        self._silent_s = None
