"""Messages of ROS 2: in JSON as rosbridge has them, and in CDR as on a wire. No socket is touched here.

A `TwistStamped` bears the time 0. Controllers of ros2_control put the time of its arrival in its place, and those that
look at no time do not mind; a time of this computer would be too old, or in the future, on a robot whose clock differs.

A pose bears the time of its frame, by this computer's clock: filters need it, and both clocks must agree.

Source: geometry_msgs, sensor_msgs and std_msgs of ROS 2; REP 103; OMG, Common Data Representation, version 1,
little-endian.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from msgspec import Struct

from stadimeter.bases.differential_drive import Motion
from stadimeter.core.measurement import Track

MessageName = Literal["Twist", "TwistStamped"]

POSE_TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"
BATTERY_TYPE = "sensor_msgs/msg/BatteryState"

# Version 1, little-endian, no options. What follows is aligned from here on.
_CDR_HEAD = b"\x00\x01\x00\x00"

# Variance of an orientation of which nothing is known: that of angles spread evenly over a turn.
_ANY_ANGLE_RAD2 = math.pi**2 / 3


class TargetPose(Struct, frozen=True, kw_only=True):
    """The place of a target, as ROS has it. Its orientation is not known.

    Attributes:
        at_s: When its frame was taken, in seconds since 1970.
        position_m: From the camera: ahead, to the left, upwards.
        covariance: Row by row of 6 by 6: the position in m², then the angles about these axes in rad².
    """

    at_s: float
    position_m: tuple[float, float, float]
    covariance: tuple[float, ...]


def target_pose(track: Track, at_s: float, bearing_sigma_rad: float) -> TargetPose | None:
    """Return the pose of a target; None if it is not known.

    Its variance is that of the distance along the line of sight, and that of the direction across it.
    """
    if track.distance_m is None or track.sigma_m is None or track.bearing_rad is None or track.elevation_rad is None:
        return None
    level = math.cos(track.elevation_rad)
    sight = np.array(
        (level * math.cos(track.bearing_rad), -level * math.sin(track.bearing_rad), math.sin(track.elevation_rad))
    )
    along, across_m2 = np.outer(sight, sight), (track.distance_m * bearing_sigma_rad) ** 2
    covariance = np.diag([0.0] * 3 + [_ANY_ANGLE_RAD2] * 3)
    covariance[:3, :3] = track.sigma_m**2 * along + across_m2 * (np.eye(3) - along)
    x, y, z = (track.distance_m * sight).tolist()
    return TargetPose(at_s=at_s, position_m=(x, y, z), covariance=tuple(covariance.ravel().tolist()))


def type_name(message: MessageName) -> str:
    """Return the name of the type in ROS 2."""
    return f"geometry_msgs/msg/{message}"


def velocity_json(motion: Motion, message: MessageName, frame_id: str) -> dict[str, Any]:
    """Return the fields of a message."""
    twist = {
        "linear": {"x": motion.linear_mps, "y": 0.0, "z": 0.0},
        "angular": {"x": 0.0, "y": 0.0, "z": motion.angular_radps},
    }
    if message == "Twist":
        return twist
    return {"header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame_id}, "twist": twist}


def velocity_cdr(motion: Motion, message: MessageName, frame_id: str) -> bytes:
    """Return the bytes of a message."""
    header = b"" if message == "Twist" else _header_cdr(frame_id)
    return _CDR_HEAD + header + struct.pack("<6d", motion.linear_mps, 0.0, 0.0, 0.0, 0.0, motion.angular_radps)


def pose_json(pose: TargetPose, frame_id: str) -> dict[str, Any]:
    """Return the fields of a pose."""
    seconds, nanoseconds = _stamp(pose.at_s)
    return {
        "header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame_id},
        "pose": {
            "pose": {
                "position": dict(zip("xyz", pose.position_m, strict=True)),
                "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
            },
            "covariance": list(pose.covariance),
        },
    }


def pose_cdr(pose: TargetPose, frame_id: str) -> bytes:
    """Return the bytes of a pose."""
    orientation = (0.0, 0.0, 0.0, 1.0)
    numbers = struct.pack("<43d", *pose.position_m, *orientation, *pose.covariance)
    return _CDR_HEAD + _header_cdr(frame_id, pose.at_s) + numbers


def battery_from_json(fields: Mapping[str, Any]) -> float | None:
    """Return the voltage of a battery state; None if it has none, for which NaN stands, and null in JSON."""
    voltage = fields.get("voltage")
    if isinstance(voltage, bool) or not isinstance(voltage, int | float):
        return None
    return float(voltage) if math.isfinite(voltage) else None


def battery_from_cdr(message: bytes) -> float | None:
    """Return the voltage of a battery state; None if it has none, or the message is cut."""
    try:
        (length,) = struct.unpack_from("<I", message, 12)
        # The voltage, four bytes, follows the header's name.
        (voltage,) = struct.unpack_from("<f", message, 16 + length + -length % 4)
    except struct.error:
        return None
    return voltage if math.isfinite(voltage) else None


def _stamp(at_s: float) -> tuple[int, int]:
    seconds = math.floor(at_s)
    return seconds, int((at_s - seconds) * 1e9)


def _header_cdr(frame_id: str, at_s: float = 0.0) -> bytes:
    """Return a header, filled up to where a number of 8 bytes may begin."""
    name = frame_id.encode() + b"\x00"
    header = struct.pack("<iII", *_stamp(at_s), len(name)) + name
    return header + bytes(-len(header) % 8)
