"""What can go wrong in the world: knobs, and a schedule that turns them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from stadimeter.simulation.options import FaultKind, ScheduledFault


@dataclass(slots=True)
class Faults:
    """The knobs. Tests and people turn them by hand; the schedule of the configuration turns them too.

    Attributes:
        target_hidden: Nobody can see the ball.
        camera_frozen: The camera keeps delivering the same old frame, as a stuck driver does.
        camera_blocked: No frame comes from the camera.
        base_unplugged: The cable to the robot base is out.
        broker_gone: Nobody answers where the message broker was.
    """

    target_hidden: bool = False
    camera_frozen: bool = False
    camera_blocked: bool = False
    base_unplugged: bool = False
    broker_gone: bool = False


KNOBS = {
    FaultKind.HIDE_TARGET: "target_hidden",
    FaultKind.FREEZE_CAMERA: "camera_frozen",
    FaultKind.BLOCK_CAMERA: "camera_blocked",
    FaultKind.UNPLUG_BASE: "base_unplugged",
    FaultKind.BROKER_GONE: "broker_gone",
}


class FaultSchedule:
    """Turns knobs at set times. A knob that was turned by hand stays so until its next time comes.

    Args:
        planned: What goes wrong when. Faults of one kind may overlap.
        start_s: The time that the plan counts from.
    """

    def __init__(self, planned: Sequence[ScheduledFault], start_s: float) -> None:
        self._spans = [(fault.kind, start_s + fault.at, start_s + _end_s(fault)) for fault in planned]
        self._left = sorted(
            {(time_s, kind) for kind, begin_s, end_s in self._spans for time_s in (begin_s, end_s)}, reverse=True
        )

    def turn(self, faults: Faults, now_s: float) -> None:
        """Turn every knob whose time has come since the last call."""
        while self._left and self._left[-1][0] <= now_s:
            time_s, kind = self._left.pop()
            active = any(kind is other and begin_s <= time_s < end_s for other, begin_s, end_s in self._spans)
            setattr(faults, KNOBS[kind], active)


def _end_s(fault: ScheduledFault) -> float:
    return float("inf") if fault.duration is None else fault.at + fault.duration
