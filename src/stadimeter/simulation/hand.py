"""A hand in the simulated world: it takes the ball from its path, puts it elsewhere, and lets it go again."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

GLIDE_S = 0.1
"""The ball takes this long to a new place: a mouse that draws it gives ten places a second or more."""

RETURN_S = 1.0
"""It takes this long back to its path."""

MOVES_MAX = 256
"""The newest moves are remembered, for questions about a moment that has passed."""

Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class _HandMove:
    """The ball begins to move at `start_s` from a point, to a place (x, y) or, with None, back to its path."""

    start_s: float
    begin: Point
    place: tuple[float, float] | None


class Hand:
    """Where the ball is, by its path and by hand. Like everything in the world, a function of time.

    Args:
        path: Returns where the ball is on its path at a time.
    """

    def __init__(self, path: Callable[[float], Point]) -> None:
        self._path = path
        self._moves: deque[_HandMove] = deque(maxlen=MOVES_MAX)

    @property
    def holds(self) -> bool:
        """Whether it holds the ball away from its path now."""
        return bool(self._moves) and self._moves[-1].place is not None

    def put(self, place: tuple[float, float] | None, now_s: float) -> None:
        """Move the ball to a place from now on, and leave it there; with None, let it go back to its path."""
        if place is not None or self.holds:
            self._moves.append(_HandMove(now_s, self.position_m(now_s), place))

    def position_m(self, time_s: float) -> Point:
        """Return where the ball's centre is: x to the east, y to the north, z up from the floor."""
        on_path = self._path(time_s)
        move = next((each for each in reversed(self._moves) if each.start_s <= time_s), None)
        if move is None:
            return on_path
        end = on_path if move.place is None else (*move.place, on_path[2])
        share = min(1.0, (time_s - move.start_s) / (RETURN_S if move.place is None else GLIDE_S))
        x_m, y_m = (begin + share * (to - begin) for begin, to in zip(move.begin[:2], end[:2], strict=True))
        return (x_m, y_m, on_path[2])
