"""The parts that robots that run ROS 2 have in common: messages, in JSON and in CDR, options, and the driver."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Protocol

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from pydantic import Field

from stadimeter.bases.differential_drive import Motion
from stadimeter.bases.protocol import Unacknowledged
from stadimeter.config.extras import missing
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Duration, Speed, TurnRate
from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.core.measurement import Track
from stadimeter.errors import DeviceClosedError

# Messages of ROS 2: in JSON as rosbridge has them, and in CDR as on a wire. No socket is touched here -----------------
#
# A `TwistStamped` bears the time 0. Controllers of ros2_control put the time of its arrival in its place, and those
# that look at no time do not mind; a time of this computer would be too old, or in the future, on a robot whose
# clock differs.
#
# A pose bears the time of its frame, by this computer's clock: filters need it, and both clocks must agree.
#
# Source: geometry_msgs, sensor_msgs and std_msgs of ROS 2; REP 103; OMG, Common Data Representation, version 1,
# little-endian.

MessageName = Literal["Twist", "TwistStamped"]

POSE_TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"
BATTERY_TYPE = "sensor_msgs/msg/BatteryState"

# Version 1, little-endian, no options. What follows is aligned from here on.
_CDR_HEAD = b"\x00\x01\x00\x00"

# Variance of an orientation of which nothing is known: that of angles spread evenly over a turn.
_ANY_ANGLE_RAD2 = math.pi**2 / 3

# Standard deviation of the direction of a target. Nothing measures it: it is how well the camera is mounted.
BEARING_SIGMA_RAD = math.radians(0.5)


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


# The parts that robots that run ROS 2 have in common: their options, and the driver around a link to them -------------
#
# No ROS is installed here. Speeds go to the robot's ``cmd_vel`` through a bridge that runs beside its ROS: one file
# each for rosbridge and for Zenoh.
#
# A subscriber ignores messages of a type that is not its own, without a word: a robot that waits for
# ``TwistStamped`` stands for ever under a driver that sends ``Twist``. So the other side is asked for its type when
# the link is opened.

# Nothing says that a stop arrived.
_STOPS = 3

# A voltage older than this is not known any more. Robots report it every second, or every ten.
_BATTERY_WITHIN_S = 30.0

TopicName = Annotated[str, Field(pattern=r"^/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*$")]

_STANDING = Motion(linear_mps=0.0, angular_radps=0.0)


class VelocityLink(Protocol):
    """A way to the ``cmd_vel`` of a robot."""

    def open(self) -> None:
        """Connect, and ask the other side whether it takes such messages.

        Raises:
            DeviceOpenError: The bridge cannot be reached, or nothing subscribes.
            ProtocolError: The other side takes another type of message.
            DriverUnavailableError: A library is not installed.
        """

    def send(self, motion: Motion) -> None:
        """Send a message; `LinkLostError` if it cannot be sent."""

    def show(self, pose: TargetPose) -> None:
        """Send the pose of a target; `LinkLostError` if it cannot be sent."""

    def battery_v(self) -> float | None:
        """Return the voltage that has come since this was last asked, if any. Never waits."""

    def check(self) -> None:
        """Read what the other side has sent. Never waits.

        Raises:
            LinkLostError: The bridge, or what subscribed, is gone.
            ProtocolError: The bridge has refused something.
        """

    def close(self) -> None:
        """Let go of the link, open or not."""


class Ros2BaseOptions(DriverOptions):
    """The options of every robot that runs ROS 2.

    Attributes:
        extra: The extra of this package that has the library.
    """

    extra: ClassVar[str]

    auto_stop_advice: ClassVar = (
        "set the time-out of the robot's controller (cmd_vel_timeout of diff_drive_controller) to 0.5 s, "
        'and write auto_stop = "500 ms"'
    )

    topic: TopicName = "/cmd_vel"
    """Where the robot takes its speeds."""
    message: Annotated[MessageName, Field(examples=["TwistStamped"])] = "Twist"
    """What it takes: ``TwistStamped`` in most robots since ROS 2 Jazzy."""
    frame_id: str = "base_link"
    """The frame of reference that a ``TwistStamped`` names."""
    pose_topic: TopicName | None = None
    """Where targets are published, as ``PoseWithCovarianceStamped``; None for nowhere."""
    pose_target: str = ""
    """The one target that is published; empty for each."""
    pose_frame_id: str = "camera_link"
    """The frame of reference of the camera: ahead, to the left, upwards (REP 103)."""
    battery_topic: TopicName | None = None
    """Where the robot publishes its ``BatteryState``; None for nowhere."""
    max_linear: Speed = 0.5
    """No faster speed forwards or backwards is sent."""
    max_angular: TurnRate = 2.0
    """No faster turn is sent."""
    auto_stop: Duration = 0.5
    """The time-out of the robot's controller, 0 for none. It only says so."""

    def link(self) -> VelocityLink:
        """Return a link that is not open."""
        raise NotImplementedError(f"{type(self).__name__} has no method `link`")

    def build(self, context: DriverContext) -> Ros2Base:
        """Return the base."""
        return Ros2Base(self, context)

    def lacks(self) -> tuple[str, ...]:
        """Return that the library is not installed, if so."""
        return tuple(filter(None, (missing(self.extra),)))

    def stops_by_itself_after_s(self) -> float:
        """Return the time that the controller is said to have; infinity for 0, which stands for none."""
        return self.auto_stop or math.inf


class Ros2Base:
    """A `MobileBase` that is a robot with ROS 2. Limits of speed keep to the curve: both speeds shrink alike."""

    def __init__(self, options: Ros2BaseOptions, context: DriverContext) -> None:
        self._options = options
        self._context = context
        self._link: VelocityLink | None = None
        self._awaited = Unacknowledged(context.clock.now_s(), streams=False, stops=_STOPS)
        self._report: BaseReport | None = None

    def open(self) -> None:
        """Connect, check the type of message, and stop the robot. Does nothing when open."""
        if self._link:
            return
        link = self._options.link()
        try:
            link.open()
            link.send(_STANDING)
        except BaseException:
            link.close()
            raise
        self._link = link

    def apply(self, command: TwistCommand) -> TwistCommand:
        """Send the speeds, and return them as they were sent."""
        link = self._opened()
        link.check()
        limits = (
            self._options.max_linear / max(abs(command.linear_mps), self._options.max_linear),
            self._options.max_angular / max(abs(command.angular_radps), self._options.max_angular),
        )
        motion = Motion(linear_mps=command.linear_mps * min(limits), angular_radps=command.angular_radps * min(limits))
        self._awaited.sent(self._context.clock.now_s(), stop=motion == _STANDING)
        link.send(motion)
        return replace(command, linear_mps=motion.linear_mps, angular_radps=motion.angular_radps, tilt_radps=0.0)

    def show_target(self, track: Track) -> None:
        """Publish where a target is, if that is wanted."""
        if self._options.pose_topic is None or self._options.pose_target not in ("", track.target):
            return
        age_s = self._context.clock.now_s() - (track.as_of_s or 0.0)
        if pose := target_pose(track, time.time() - age_s, BEARING_SIGMA_RAD):
            self._opened().show(pose)

    def tick(self, now_s: float) -> None:
        """Look after the link, and repeat a stop."""
        link = self._opened()
        link.check()
        if (battery_v := link.battery_v()) is not None:
            self._report = BaseReport(at_s=now_s, battery_v=battery_v)
        if self._awaited.stop_is_overdue(now_s):
            self._awaited.repeating()
            self._awaited.sent(now_s, stop=True)
            link.send(_STANDING)

    def report(self) -> BaseReport | None:
        """Return the voltage of the battery; None where it is not published, or was not for long."""
        if self._report and self._context.clock.now_s() - self._report.at_s > _BATTERY_WITHIN_S:
            self._report = None
        return self._report

    def stop(self) -> None:
        """Stand still at once. Does nothing when closed."""
        if self._link:
            self._awaited.sent(self._context.clock.now_s(), stop=True)
            self._link.send(_STANDING)

    def close(self) -> None:
        """Stop, then let go of the link, even if the stop fails."""
        link = self._link
        if not link:
            return
        try:
            self.stop()
        finally:
            self._link = None
            link.close()

    def _opened(self) -> VelocityLink:
        if self._link is None:
            raise DeviceClosedError(f"the base '{self._context.name}' is not open")
        return self._link
