"""The answers of a base so far, and what they say of the link to it and of the last stop."""

from __future__ import annotations

import math

STOP_REPEATED_AFTER_S = 0.1

# A board answers within milliseconds, an adapter or a radio adds up to some tens. After this much a command is doubted,
# and a stop goes out behind it.
DOUBTED_AFTER_S = 0.15

# What is answered later than this tells of a line that is too slow; what is not answered by then, while something else
# was, is lost. Longer than a stop may take where commands take no longer than `DOUBTED_AFTER_S`, so that no answer that
# is still under way counts as lost: else commands would queue up.
LATE_AFTER_S = 0.25

# The time between two looks at the line counts as silence up to this.
LOOK_S = 0.05


class Acknowledgements:
    """Counts commands and their answers on a line where each command gets one, in order.

    At most one command that drives is under way (`is_free`): more would queue up in an adapter or a radio that is
    slower than they come, and be obeyed late. A command that is not answered in time is followed by a stop, and none
    follows until it is known what became of both.

    Silence is time in which the line was read. When this process waits for a processor, the clock goes on and nothing
    is read; and a command may leave the computer long after its time was noted. So silence adds up from look to look,
    and a gap between two looks counts for `LOOK_S` at most.

    Args:
        any_byte_feeds: Whether every byte keeps the board from stopping by itself. Then nothing is sent behind two
            frames that are not answered: on a line that spoils or delays them, more would keep its wheels turning.

    Attributes:
        is_late: Whether the last answer came so late that the line does not carry what is sent.
    """

    def __init__(self, *, any_byte_feeds: bool = False) -> None:
        self.is_late = False
        self._any_byte_feeds = any_byte_feeds
        self._unanswered = 0
        self._is_stop = self._was_heard = False
        self._sent_s = self._looked_s = 0.0
        self._silent_s: float | None = None
        self._quiet_s = 0.0  # since the last command or answer

    def sent(self, now_s: float, *, stop: bool) -> None:
        """Note that a command was sent. Any other command takes an earlier stop back."""
        self._unanswered += 1
        self._is_stop, self._was_heard = stop, False
        self._sent_s, self._quiet_s = now_s, 0.0
        if self._silent_s is None:
            self._silent_s, self._looked_s = 0.0, now_s

    def looked(self, now_s: float) -> None:
        """Note that everything which had arrived at that time was read."""
        if self._silent_s is not None:
            silent_s = min(max(0.0, now_s - self._looked_s), LOOK_S)
            self._silent_s += silent_s
            self._quiet_s += silent_s
            self._looked_s = now_s

    def repeating(self) -> None:
        """Note that a stop is about to be repeated. If answers came, those that are still missing will not come."""
        if self._was_heard:
            self._unanswered, self._silent_s = 0, None

    def note_answer(self, *, is_done: bool) -> None:
        """Note an answer. If all was answered, and the last command done, a stop has arrived; else it is repeated."""
        self.is_late = self.silent_s > LATE_AFTER_S
        self._quiet_s = 0.0
        if self._unanswered == 1 and self._is_stop and not is_done:
            return
        self._was_heard = True
        self._unanswered = max(0, self._unanswered - 1)
        if not self._unanswered:
            self._silent_s = None

    def heard(self, now_s: float) -> None:
        """Note that the base said something that is no answer: it takes no command for done."""

    def stop_is_overdue(self, now_s: float) -> bool:
        """Check whether a stop shall be sent: one is not acknowledged, or a command is not answered in time."""
        if not self._unanswered or self.must_be_quiet:
            return False
        if not self._is_stop:
            return self._quiet_s >= DOUBTED_AFTER_S
        if self._was_heard:
            return self._quiet_s >= LATE_AFTER_S
        return now_s - self._sent_s >= STOP_REPEATED_AFTER_S

    @property
    def is_free(self) -> bool:
        """True if a command that drives may be sent: all before it were answered."""
        return not self._unanswered

    @property
    def must_be_quiet(self) -> bool:
        """True if nothing shall be sent, so that the board stops by itself."""
        return self._any_byte_feeds and self._unanswered > 1

    @property
    def silent_s(self) -> float:
        """Time for which the line has been silent although something should have come, or not all was answered."""
        return self._silent_s or 0.0


class Unacknowledged(Acknowledgements):
    """The same for a base that acknowledges nothing.

    Nothing tells whether a stop arrived, so each is sent several times; nor whether a command did, so the line is free.

    Args:
        streams: Whether the base sends something all the time, so that silence is a lost link. Else it never is one.
        stops: How often a stop is sent.
    """

    def __init__(self, now_s: float, *, streams: bool, stops: float) -> None:
        super().__init__()
        self._streams = streams
        self._stops = self._stops_left = stops
        self._is_repeating = False
        self._sent_s = math.inf
        self.heard(now_s)

    def sent(self, now_s: float, *, stop: bool) -> None:
        """Note that a command was sent. Any other command takes an earlier stop back."""
        self._stops_left = (self._stops_left if self._is_repeating else self._stops) - 1
        self._is_repeating = False
        self._sent_s = now_s if stop and self._stops_left > 0 else math.inf

    def repeating(self) -> None:
        """Note that a stop is about to be repeated."""
        self._is_repeating = True

    def heard(self, now_s: float) -> None:
        """Note that the base said something."""
        if self._streams:
            self._silent_s, self._looked_s = 0.0, now_s

    def stop_is_overdue(self, now_s: float) -> bool:
        """Check whether a stop shall be sent once more."""
        return now_s - self._sent_s >= STOP_REPEATED_AFTER_S
