"""What a simulated world says of itself: the words of its story, and what goes wrong on purpose."""

from __future__ import annotations

import bisect
from collections.abc import Collection, Sequence

from pydantic import Field

from stadimeter.config.plugins import Options
from stadimeter.config.units import Duration


class StoryLine(Options):
    """A sentence about what the ball does, from some time on."""

    at: Duration
    """When, in seconds from the start of the path."""
    say: str = Field(min_length=1)
    """The sentence. Lengths in it are in metres, such as ``3.05 m``, and are shown in the unit that was asked for."""


DURING = {
    "hide-target": "The ball is hidden on purpose: the robot must stop.",
    "freeze-camera": "The camera is frozen on purpose: old pictures must move nothing.",
    "block-camera": "The camera is blocked on purpose: without pictures nothing may move.",
    "unplug-base": "The robot's cable is out on purpose: nothing reaches it, so it must stop by itself.",
    "broker-gone": "The message broker is away on purpose: messages must wait for it.",
}
"""What is said while a fault lasts, by its kind."""

AFTER = {
    "hide-target": "The ball is back in sight: the robot may go on.",
    "freeze-camera": "The camera sends new pictures again: the robot may go on.",
    "block-camera": "The camera sends pictures again: the robot may go on.",
    "unplug-base": "The robot's cable is in again: it is asked who it is, and must stand for 3 s before it may go on.",
    "broker-gone": "The message broker is back: what waited is delivered.",
}
"""What is said when it is over."""

AFTER_S = 4.0
"""For how long that is said."""


class Narrator:
    """Says in a sentence what happens.

    Args:
        period_s: After this long the story begins again, with the path; None or 0 for never.
    """

    def __init__(self, story: Sequence[StoryLine], period_s: float | None) -> None:
        self._story = sorted(story, key=lambda line: line.at)
        self._period_s = period_s
        self._active: tuple[str, ...] = ()
        self._over: tuple[float, str] | None = None

    def words(self, faults: Collection[str], into_s: float) -> str:
        """Return what is said at a time.

        Args:
            faults: The kinds of what is wrong at that time.
            into_s: The time since the start, not before that of the last call.
        """
        ended = [kind for kind in self._active if kind not in faults]
        self._active = tuple(faults)
        if ended:
            self._over = (into_s + AFTER_S, AFTER[ended[-1]])
        if self._active:
            return " ".join(DURING[kind] for kind in self._active)
        if self._over is not None and into_s < self._over[0]:
            return self._over[1]
        return self._told(into_s % self._period_s if self._period_s else into_s)

    def _told(self, at_s: float) -> str:
        line = bisect.bisect_right(self._story, at_s, key=lambda line: line.at) - 1
        return self._story[line].say if line >= 0 else ""
