"""When a buzzer sounds: beeps that follow each other the faster, the higher the level."""

from __future__ import annotations


class BeepPattern:
    """Beeps of one length whose rate follows a level, as in a parking sensor.

    The period goes from the slowest to the fastest in equal ratios: a step of level sounds like the same step
    everywhere. A change of level moves the next beep, never the one that sounds.

    Args:
        slowest_s: The period, from one beep's start to the next one's, at the lowest level above 0.
        fastest_s: The period just below level 1, at most `slowest_s`.
        beep_s: How long a beep is, less than `fastest_s`.
    """

    def __init__(self, *, slowest_s: float, fastest_s: float, beep_s: float) -> None:
        self._slowest_s = slowest_s
        self._ratio = fastest_s / slowest_s
        self._beep_s = beep_s
        self._started_s: float | None = None

    def period_s(self, level: float) -> float:
        """Return the time from one beep's start to the next one's.

        Args:
            level: 0 to 1.

        Returns:
            ``slowest_s * (fastest_s / slowest_s) ** level``.
        """
        return float(self._slowest_s * self._ratio**level)

    def sounds(self, level: float, now_s: float) -> bool:
        """Move on to a time and return whether it sounds then. Asking twice for one time gives the same answer.

        Args:
            level: 0 is silent, and the first level above it beeps at once; 1 sounds without a break.
        """
        if level <= 0.0:
            self._started_s = None
            return False
        self._started_s = self._newest_start_s(self.period_s(level), now_s)
        return level >= 1.0 or now_s - self._started_s < self._beep_s

    def _newest_start_s(self, period_s: float, now_s: float) -> float:
        if self._started_s is None:
            return now_s
        due_s = self._started_s + period_s
        if now_s < due_s:
            return self._started_s
        # Counted from when it was due, so that late ticks do not slow the beeping down, but never so far back that
        # the beep would be over before it was heard.
        return due_s if now_s - due_s < self._beep_s / 2 else now_s
