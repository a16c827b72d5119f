"""What a simulated world says of itself: the words of its story, and what goes wrong on purpose."""

from __future__ import annotations

import bisect
from collections.abc import Collection, Sequence

from pydantic import Field

from stadimeter.config.plugins import OptionsTable
from stadimeter.config.units import Duration, Length


class StoryLine(OptionsTable):
    """A sentence about what the ball does, from some time on."""

    at: Duration
    """When, in seconds from the start of the path."""
    say: str = Field(min_length=1)
    """The sentence. Lengths in it are in metres, such as ``3.05 m``, and are shown in the unit that was asked for."""
    nearer: Length | None = None
    """It is said only while the ball is nearer to the camera than this; else the line before it."""
    beyond: Length | None = None
    """It is said only while the ball is further from the camera than this; else the line before it."""

    def fits(self, distance_m: float) -> bool:
        """Return whether what it says is so with the ball at a distance from the camera."""
        is_near_enough = self.nearer is None or distance_m < self.nearer
        return is_near_enough and (self.beyond is None or distance_m > self.beyond)


# The ball is not where the camera looks. Like the kinds of faults, it is said while it lasts and when it is over.
OUT_OF_SIGHT = "out-of-sight"


# What is said while a fault lasts, by its kind.
DURING = {
    "hide-target": "The ball is hidden on purpose: the robot must stop.",
    "freeze-camera": "The camera is frozen on purpose: old pictures must move nothing.",
    "freeze-under-clock": "The sensor is frozen on purpose, under a clock that runs: the robot must notice, and stop.",
    "freeze-under-noise": "The sensor is frozen on purpose, with noise added: the robot must notice, and stop.",
    "block-camera": "The camera is blocked on purpose: without pictures nothing may move.",
    "block-second-camera": "The second camera is blocked on purpose: the first one measures alone.",
    "unplug-base": "The robot's cable is out on purpose: nothing reaches it, so it must stop by itself.",
    "press-bumper": "The robot has bumped into something on purpose: it must stand.",
    "silence-sensors": "The range sensors are silent on purpose: what must not come near may be near.",
    "broker-gone": "The message broker is away on purpose: messages must wait for it.",
    OUT_OF_SIGHT: "The ball is out of the camera's sight: the robot stands still until the ball comes back.",
}

# What is said when it is over.
AFTER = {
    "hide-target": "The ball is back in sight: the robot may go on.",
    "freeze-camera": "The camera sends new pictures again: the robot may go on.",
    "freeze-under-clock": "The sensor works again: the robot may go on once it is armed.",
    "freeze-under-noise": "The sensor works again: the robot may go on once it is armed.",
    "block-camera": "The camera sends pictures again: the robot may go on.",
    "block-second-camera": "The second camera sends pictures again.",
    "unplug-base": "The robot's cable is in again: it is identified, and stands still for 3 s before it goes on.",
    "press-bumper": "Nothing presses the bumper any more: the robot may go on.",
    "silence-sensors": "The range sensors answer again: the robot may go on.",
    "broker-gone": "The message broker is back: what waited is delivered.",
    OUT_OF_SIGHT: "The ball has come back to the camera: the robot may go on.",
}

# For how long that is said.
AFTER_S = 4.0

# What is said in place of the story while the ball is not on its path.
BY_HAND = "The ball is where a hand has put it: the robot goes by where it sees it."


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

    def words(
        self,
        faults: Collection[str],
        now_s: float,
        *,
        path_s: float = 0.0,
        distance_m: float = 0.0,
        is_by_hand: bool = False,
    ) -> str:
        """Return what is said at a time.

        Args:
            faults: The kinds of what is wrong at that time, `OUT_OF_SIGHT` among them.
            now_s: That time, not before that of the last call.
            path_s: How long the ball is on its path.
            distance_m: How far from the camera it is.
            is_by_hand: Whether a hand holds it elsewhere.
        """
        ended = [kind for kind in self._active if kind not in faults]
        self._active = tuple(faults)
        if ended:
            self._over = (now_s + AFTER_S, AFTER[ended[-1]])
        if self._active:
            return " ".join(DURING[kind] for kind in self._active)
        if self._over is not None and now_s < self._over[0]:
            return self._over[1]
        if is_by_hand and self._story:
            return BY_HAND
        return self._line(path_s % self._period_s if self._period_s else path_s, distance_m)

    def _line(self, at_s: float, distance_m: float) -> str:
        begun = self._story[: bisect.bisect_right(self._story, at_s, key=lambda line: line.at)]
        return next((line.say for line in reversed(begun) if line.fits(distance_m)), "")
