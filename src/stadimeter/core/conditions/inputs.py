"""All that conditions are judged by in one cycle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from stadimeter.core.observation import WallTime
from stadimeter.core.track import Track


@dataclass(frozen=True, slots=True, kw_only=True)
class RuleInputs:
    """All that conditions are judged by in one cycle.

    Attributes:
        tracks: The targets, by name.
        now_s: The run's monotonic clock.
        wall: The local time of day; None while it is not known.
        active: Whether each rule is active, by its name; None for one that has nothing to judge by.
        before: The targets as they were in the cycle before, by name.
        is_after_gap: Whether the program stood still before this cycle: unobserved time counts for no timer.
    """

    tracks: Mapping[str, Track]
    now_s: float
    wall: WallTime | None = None
    active: Mapping[str, bool | None] = field(default_factory=dict)
    before: Mapping[str, Track] = field(default_factory=dict)
    is_after_gap: bool = False
