"""The end of a run: one deadline for all that must be closed, so that waits do not add up.

Somebody who asks for the end (SIGTERM, Ctrl-C) waits two seconds at most: then systemd kills. Each part of the end
takes what it needs of that time, and no part has a limit of its own that another one could add to. Parts are closed
side by side; what does not come back is left behind, and that is said.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping

from stadimeter.errors import DriverError

END_WITHIN_S = 1.3
"""After somebody has asked for the end, nothing is waited for any longer than this."""

LOOK_EVERY_S = 0.02

Steps = list[tuple[str, Callable[[], object]]]
"""What is closed one after the other, the last one first, with the name of each."""


class Deadline:
    """Until when a run must have ended: without limit, until somebody asks for its end."""

    def __init__(self) -> None:
        self._by_s = math.inf

    def set(self) -> None:
        """Note that somebody asks for the end. Asking again changes nothing."""
        self._by_s = min(self._by_s, time.monotonic() + END_WITHIN_S)

    @property
    def is_set(self) -> bool:
        """Whether somebody has asked for the end."""
        return self._by_s < math.inf

    def left_s(self, wish_s: float, keep_s: float = 0.0) -> float:
        """Return for how long something may be waited for.

        Args:
            keep_s: What must be left for others after that.
        """
        return max(0.0, min(wish_s, self._by_s - time.monotonic() - keep_s))


def close_side_by_side(
    lanes: Mapping[str, Steps], deadline: Deadline, wish_s: float = 30.0, keep_s: float = 0.0
) -> list[str]:
    """Close everything: each lane in a thread of its own, whatever becomes of the others.

    Args:
        lanes: What must be closed one after the other, by name.
        deadline: Until when. It may be set while we wait.
        keep_s: How much of the time must be left for others.

    Returns:
        What went wrong, in words, and what was left behind.
    """
    troubles: list[str] = []
    until_s = time.monotonic() + wish_s
    threads = [threading.Thread(target=_close, args=(steps, troubles), daemon=True) for steps in lanes.values()]
    for thread in threads:
        thread.start()
    for thread in threads:
        while thread.is_alive() and deadline.left_s(until_s - time.monotonic(), keep_s) > 0:
            thread.join(LOOK_EVERY_S)
    left = [f"{steps[-1][0]}: it did not end in time, and was left behind" for steps in lanes.values() if steps]
    return [*troubles, *left]


def _close(steps: Steps, troubles: list[str]) -> None:
    while steps:
        name, close = steps[-1]
        try:
            close()
        except Exception as error:  # noqa: BLE001 - a defect in one part must not keep the next from being closed
            words = str(error) if isinstance(error, DriverError) else f"{type(error).__name__}: {error}"
            troubles.append(f"{name}: {words}")
        steps.pop()
