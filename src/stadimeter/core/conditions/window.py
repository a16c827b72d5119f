"""Windows of time that slide, or begin at a time of day; and what rules remember of them.

Moments are kept as 8-byte floats, since thousands of Python's own would take ten times the memory.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable

from msgspec import Struct

from stadimeter.core.observation import WallTime
from stadimeter.core.words import duration, time_of_day

DAY_S = 86400.0

# A clock that is put forward or back by less, as for summer time, begins no other day.
_CLOCK_CHANGE_S = 2 * 3600.0

# What is due this soon is due; as `stadimeter.core.rule.ROUNDING_S`.
ROUNDING_S = 1e-6


class Window(Struct, frozen=True, kw_only=True):
    """What of the past counts.

    Attributes:
        for_s: The newest part of the past, this long; one day where it begins at a time of day.
        from_second: It begins at this second of the day, local time; None for one that slides.
    """

    for_s: float = DAY_S
    from_second: float | None = None

    def began_s(self, before_s: float | None, now_s: float, wall: WallTime | None) -> float | None:
        """Return when it began, on the run's clock; None for one that slides, and while the time of day is unknown.

        Args:
            before_s: The same in the cycle before. It stays, however two clocks are read one after the other.
        """
        if self.from_second is None or wall is None:
            return None
        began_s = now_s - (wall.second_of_day - self.from_second) % DAY_S
        return before_s if before_s is not None and abs(began_s - before_s) < _CLOCK_CHANGE_S else began_s

    def start_s(self, began_s: float | None, now_s: float) -> float | None:
        """Return from when on the past counts; None while that is not known."""
        if self.from_second is None:
            return now_s - self.for_s
        return None if began_s is None else began_s - ROUNDING_S

    def __str__(self) -> str:
        """Return it in words, such as ``within 1 min``."""
        if self.from_second is None:
            return f"within {duration(self.for_s)}"
        return f"since {time_of_day(self.from_second)}" if self.from_second else "today"


class Tally(Struct, frozen=True, kw_only=True):
    """What one condition remembers of what other rules did. Times are on the run's clock.

    Attributes:
        times: When they were raised, oldest first; or when they became active and ceased to be, in turn. See `packed`.
        active_since_s: Since when one of them is active, as far as it is not in `times`; None while none is.
        began_s: When the window began that begins at a time of day; None for another, and while that is not known.
    """

    times: bytes = b""
    active_since_s: float | None = None
    began_s: float | None = None


def packed(numbers: Iterable[float]) -> bytes:
    """Return numbers as bytes."""
    return array("d", numbers).tobytes()


def unpacked(data: bytes) -> list[float]:
    """Return the numbers that `packed` was given."""
    numbers = array("d")
    numbers.frombytes(data[: len(data) // 8 * 8])
    return numbers.tolist()
