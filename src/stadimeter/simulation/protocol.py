"""The interface of a simulated world, to whoever watches it."""

from __future__ import annotations

from typing import Protocol


class StagedWorld(Protocol):
    """A world in which things can be made to go wrong, and which says what happens."""

    def narration(self) -> str:
        """Return in a sentence what happens now; an empty string if there is nothing to say."""
        ...

    def goes_wrong(self, fault: str) -> bool:
        """Return whether a fault is there now.

        Args:
            fault: Its kind, as in the schedule of a configuration: such as ``hide-target``.
        """
        ...

    def toggle(self, fault: str) -> None:
        """Make something go wrong, or put it right again."""
        ...

    def ball_at_m(self) -> tuple[float, float]:
        """Return where the ball is now: metres to the east, where the camera looks at first, and to the north."""
        ...

    def move_ball(self, x_m: float, y_m: float) -> None:
        """Put the ball somewhere; it leaves its path, and stays there."""
        ...
