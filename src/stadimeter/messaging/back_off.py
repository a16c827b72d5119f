"""Time-outs, and the growing pauses between attempts."""

from __future__ import annotations

from msgspec import Struct


class Patience(Struct, frozen=True, kw_only=True):
    """The time-outs and pauses of a connection.

    Attributes:
        answer_s: For a broker's answer to a connection. Some brokers that do not know MQTT 5 never answer it.
        first_pause_s: After the first attempt that failed.
        longest_pause_s: The pauses double up to this.
        alarm_pause_s: No pause is longer while something waits that must arrive: an alarm, or a notification.
        goodbye_s: For what is on its way when we close, and as long again for the thread to end.
    """

    answer_s: float = 5.0
    first_pause_s: float = 1.0
    longest_pause_s: float = 60.0
    alarm_pause_s: float = 10.0
    goodbye_s: float = 0.3


class BackOff:
    """Pauses that double from the first to the longest."""

    def __init__(self, patience: Patience) -> None:
        self._first_s = patience.first_pause_s
        self._longest_s = patience.longest_pause_s
        self._next_s = self._first_s

    def next_s(self) -> float:
        """Return the next pause in seconds."""
        pause_s = self._next_s
        self._next_s = min(self._longest_s, pause_s * 2)
        return pause_s

    def reset(self) -> None:
        """Begin with the first pause again."""
        self._next_s = self._first_s

    def jump_to_longest(self) -> None:
        """Let the next pause be the longest."""
        self._next_s = self._longest_s
