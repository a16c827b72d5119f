"""Messages on where the camera is: ``camera/pose``, when it has moved, at most five times a second, and every 5 s."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from typing import Any

from stadimeter.core.camera_pose import CameraPose
from stadimeter.core.message import Message

TOPIC = "camera/pose"
INTERVAL_S = 0.2
HEARTBEAT_S = 5.0
EXPIRES_S = 10

# What counts as a move: 1 cm or half a degree, and half a standard deviation.
DEADBAND_M, DEADBAND_RAD, DEADBAND_SIGMAS = 0.01, math.radians(0.5), 0.5


_JSON = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False, allow_nan=False)


class PoseReports:
    """Decides when the camera's pose is published: metres and radians to three decimals; null if not known."""

    def __init__(self) -> None:
        self._told: CameraPose | None = None
        self._told_at_s = -math.inf

    def messages(self, now_s: float, wall_clock: Callable[[], str], pose: CameraPose | None) -> Iterator[Message]:
        """Return the messages after a cycle; none without a new pose."""
        if pose is None or not self._is_due(pose, now_s - self._told_at_s):
            return
        self._told, self._told_at_s = pose, now_s
        payload = {"v": 1, "ts": wall_clock(), **pose_figures(pose)}
        yield Message(topic=TOPIC, payload=_JSON.encode(payload), qos=0, retain=True, expires_s=EXPIRES_S)

    def _is_due(self, pose: CameraPose, silent_s: float) -> bool:
        told = self._told
        if told is None or silent_s >= HEARTBEAT_S:
            return True
        if silent_s < INTERVAL_S:
            return False
        return (pose.moved, pose.position_m is None) != (told.moved, told.position_m is None) or _has_moved(told, pose)


def _has_moved(before: CameraPose, now: CameraPose) -> bool:
    """Check whether the difference matters. Of a pose that is not known there is none."""
    one, other = ((*(each.position_m or ()), *(each.angles_rad or ())) for each in (before, now))
    off = [abs(a - b) for a, b in zip(one, other, strict=False)]
    off[3:] = [abs(math.remainder(each, math.tau)) for each in off[3:]]
    floors = [DEADBAND_M] * 3 + [DEADBAND_RAD] * 3
    each_of = zip(off, floors, now.sigmas, strict=False)
    return any(moved > max(floor, DEADBAND_SIGMAS * sigma) for moved, floor, sigma in each_of)


def pose_figures(pose: CameraPose) -> dict[str, Any]:
    """Return a pose as messages and `locate --json` have it."""
    position = dict(zip(("x_m", "y_m", "z_m"), pose.position_m or (None,) * 3, strict=True))
    angles = dict(zip(("yaw_rad", "tilt_rad", "roll_rad"), pose.angles_rad or (None,) * 3, strict=True))
    rounded = {name: None if value is None else round(value, 3) + 0.0 for name, value in (position | angles).items()}
    return {
        **rounded,
        "orientation": None if pose.orientation is None else [round(each, 6) + 0.0 for each in pose.orientation],
        "covariance": list(pose.covariance) or None,
        "tags": list(pose.tags),
        "moved": list(pose.moved),
        "reason": pose.reason,
    }
