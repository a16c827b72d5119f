"""The interface of a simulated world, for views of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol


class StagedWorld(Protocol):
    """A world in which things can be made to go wrong, and which says what happens."""

    def narration(self) -> str:
        """Return in a sentence what happens now; an empty string if there is nothing to say."""
        ...

    def state(self) -> Mapping[str, Any]:
        """Return where things are, and what goes wrong, for a view from above.

        Returns:
            ``targets`` and ``camera`` with ``x_m`` to the east and ``y_m`` to the north, the camera with its
            ``heading_rad`` counter-clockwise from east; ``faults``: by kind, whether it is there now.
        """
        ...

    def goes_wrong(self, fault: str) -> bool:
        """Return whether a fault is there now.

        Args:
            fault: Its kind, as in the schedule of a configuration: such as ``hide-target``.
        """
        ...

    def toggle(self, fault: str) -> None:
        """Make something go wrong, or put it right again; `ValueError` if there is no such fault."""
        ...

    def place_target(self, x_m: float, y_m: float) -> None:
        """Have the target go there and stay. Many places a second draw a path."""
        ...

    def in_world_m(self, bearing_rad: float, distance_m: float) -> tuple[float, float]:
        """Return where a target is that the camera would see there now.

        Args:
            bearing_rad: Positive to the right.
            distance_m: From the camera to the target's centre.
        """
        ...

    def let_go(self) -> None:
        """Have the target go on along its path."""
        ...
