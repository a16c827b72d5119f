"""What was looked at and is not the target, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from stadimeter.core.detection import RejectedCandidate
from stadimeter.core.measurement import MeasurementStatus

if TYPE_CHECKING:
    from stadimeter.app.cycle_record import CycleRecord


class LookedAt:
    """What was looked at in the newest frame of a run, for each target that was not measured in it."""

    def __init__(self) -> None:
        self._by_target: Mapping[str, Sequence[RejectedCandidate]] = {}

    def add(self, record: CycleRecord) -> None:
        """Take note of a cycle. One without a new frame leaves things as they were.

        Args:
            record: The cycle.
        """
        if record.observation.frame is None:
            return
        self._by_target = {
            measured.target: record.rejected.get(measured.target, ())
            for measured in record.observation.measurements
            if measured.status is not MeasurementStatus.MEASURED
        }

    @property
    def by_target(self) -> Mapping[str, Sequence[RejectedCandidate]]:
        """The candidates for each target that was not measured, the most like it first."""
        return self._by_target


def format_place(candidate: RejectedCandidate) -> str:
    """Say how large a candidate is, and where.

    Args:
        candidate: What was looked at.

    Returns:
        Such as ``24 px at 310, 120``.
    """
    x, y = candidate.centre_px
    return f"{candidate.size_px:.0f} px at {x:.0f}, {y:.0f}"


def format_best(reason: str, rejected: Sequence[RejectedCandidate]) -> str:
    """Say what looked most like the target, and which test it failed.

    Args:
        reason: What stands beside it: a test that is told there already is not told again.
        rejected: What was looked at, the most like the target first.

    Returns:
        Such as ``looked at 24 px at 310, 120: edge scatters by 2.1 px, limit 1.0 px``; empty if nothing was.
    """
    if not rejected:
        return ""
    best = rejected[0]
    words = f"looked at {format_place(best)}"
    return words if not best.reason or best.reason in reason else f"{words}: {best.reason}"
