"""Speeds as messages of ROS 2: in JSON as rosbridge has them, and in CDR as on a wire. No socket is touched here.

A `TwistStamped` bears the time 0. Controllers of ros2_control put the time of its arrival in its place, and those that
look at no time do not mind; a time of this computer would be too old, or in the future, on a robot whose clock differs.

Source: geometry_msgs and std_msgs of ROS 2; OMG, Common Data Representation, version 1, little-endian.
"""

from __future__ import annotations

import struct
from typing import Any, Literal

from stadimeter.bases.differential_drive import Motion

MessageName = Literal["Twist", "TwistStamped"]

# Version 1, little-endian, no options. What follows is aligned from here on.
_CDR_HEAD = b"\x00\x01\x00\x00"


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


def _header_cdr(frame_id: str) -> bytes:
    """Return a header with the time 0, filled up to where a number of 8 bytes may begin."""
    name = frame_id.encode() + b"\x00"
    header = struct.pack("<iII", 0, 0, len(name)) + name
    return header + bytes(-len(header) % 8)
