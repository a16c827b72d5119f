"""How what is measured again in recorded pictures compares with what was measured when they were taken."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median

from stadimeter.core.observation import Observation


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredAgain:
    """One target in the pictures of a recording.

    Attributes:
        frames: In how many pictures it was looked for again.
        found_before: In how many of them it was measured when they were recorded.
        found_again: In how many of them it is measured now.
        differs_median_m: By how much the two distances differ in the middle; None if it was never measured both times.
        differs_most_m: The same at most.
    """

    target: str
    frames: int
    found_before: int
    found_again: int
    differs_median_m: float | None = None
    differs_most_m: float | None = None


class AgainTally:
    """Compares measurements through a replay."""

    def __init__(self) -> None:
        self._pairs: dict[str, list[tuple[float | None, float | None]]] = {}

    def add(self, before: Observation, again: Observation) -> None:
        """Add one cycle.

        Args:
            before: What was observed when it was recorded.
        """
        before_m = {measured.target: measured.distance_m for measured in before.measurements}
        for measured in again.measurements:
            pair = before_m.get(measured.target), measured.distance_m
            self._pairs.setdefault(measured.target, []).append(pair)

    def targets(self) -> tuple[MeasuredAgain, ...]:
        """Return how each target compares."""
        return tuple(_compared(target, pairs) for target, pairs in self._pairs.items())


def _compared(target: str, pairs: list[tuple[float | None, float | None]]) -> MeasuredAgain:
    apart_m = [abs(again_m - before_m) for before_m, again_m in pairs if before_m is not None and again_m is not None]
    return MeasuredAgain(
        target=target,
        frames=len(pairs),
        found_before=sum(before_m is not None for before_m, _ in pairs),
        found_again=sum(again_m is not None for _, again_m in pairs),
        differs_median_m=median(apart_m) if apart_m else None,
        differs_most_m=max(apart_m, default=None),
    )
