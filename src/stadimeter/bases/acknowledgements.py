"""What a base has answered so far, and what that says of the link to it and of the last stop."""

from __future__ import annotations

STOP_REPEATED_AFTER_S = 0.1

# The time between two looks at the line counts as silence up to this.
LOOK_S = 0.05


class Acknowledgements:
    """Counts commands and their answers on a line where each command gets one, in order.

    A lost answer must not count as a lost link for ever. Therefore silence is counted from the first command that was
    sent after the last answer, not from the oldest one that was never answered.

    Silence is time in which the line was read. When this process waits for a processor, the clock goes on and nothing
    is read; and a command may leave the computer long after its time was noted. So silence adds up from look to look,
    and a gap between two looks counts for `LOOK_S` at most: ten looks in a row must have found nothing.

    Args:
        quiet_s: How long the line is left quiet after each second stop that is not answered, for a board that any byte
            keeps from stopping by itself. On a noisy line stops that never arrive would keep its wheels turning.
    """

    def __init__(self, quiet_s: float = 0.0) -> None:
        self._quiet_s = quiet_s
        self._stops_in_a_row = 0
        self._unanswered = 0
        self._silent_s: float | None = None
        self._looked_s = 0.0
        self._stop_sent_s: float | None = None

    def sent(self, now_s: float, *, stop: bool) -> None:
        """Note that a command was sent. Any other command takes an earlier stop back."""
        self._unanswered += 1
        self._stop_sent_s = now_s if stop else None
        self._stops_in_a_row = self._stops_in_a_row + 1 if stop else 0
        if self._silent_s is None:
            self._silent_s, self._looked_s = 0.0, now_s

    def looked(self, now_s: float) -> None:
        """Note that everything which had arrived at that time was read."""
        if self._silent_s is not None:
            self._silent_s += min(max(0.0, now_s - self._looked_s), LOOK_S)
            self._looked_s = now_s

    def repeating(self) -> None:
        """Note that a stop is about to be repeated, so the answers that are still missing will not come."""
        self._unanswered = 0

    def note_answer(self, *, is_done: bool) -> None:
        """Note an answer. If the last command waited for was done, a stop has arrived; else it must be repeated."""
        self._unanswered = max(0, self._unanswered - 1)
        self._silent_s = None
        if is_done and not self._unanswered:
            self._stop_sent_s = None
            self._stops_in_a_row = 0

    def heard(self, now_s: float) -> None:
        """Note that the base said something that is no answer: it takes no command for done."""

    def stop_is_overdue(self, now_s: float) -> bool:
        """Return whether a stop that is not acknowledged shall be sent again."""
        is_due = self._stop_sent_s is not None and now_s - self._stop_sent_s >= STOP_REPEATED_AFTER_S
        return is_due and not self.must_be_quiet(now_s)

    def must_be_quiet(self, now_s: float) -> bool:
        """Return whether nothing shall be sent but a command that drives: two stops were, and are not acknowledged."""
        is_second = self._stop_sent_s is not None and self._stops_in_a_row % 2 == 0
        return is_second and now_s - (self._stop_sent_s or 0.0) < self._quiet_s

    @property
    def silent_s(self) -> float:
        """How long the line has been silent although something should have come."""
        return self._silent_s or 0.0


class Unacknowledged(Acknowledgements):
    """The same for a base that acknowledges nothing.

    Nothing tells whether a stop arrived, so each is sent several times.

    Args:
        streams: Whether the base sends something all the time, so that silence is a lost link. Else it never is one.
        stops: How often a stop is sent.
    """

    def __init__(self, now_s: float, *, streams: bool, stops: float) -> None:
        super().__init__()
        self._streams = streams
        self._stops = self._stops_left = stops
        self._is_repeating = False
        self.heard(now_s)

    def sent(self, now_s: float, *, stop: bool) -> None:
        """Note that a command was sent. Any other command takes an earlier stop back."""
        self._stops_left = (self._stops_left if self._is_repeating else self._stops) - 1
        self._is_repeating = False
        self._stop_sent_s = now_s if stop and self._stops_left > 0 else None

    def repeating(self) -> None:
        """Note that a stop is about to be repeated."""
        self._is_repeating = True

    def heard(self, now_s: float) -> None:
        """Note that the base said something."""
        if self._streams:
            self._silent_s, self._looked_s = 0.0, now_s
