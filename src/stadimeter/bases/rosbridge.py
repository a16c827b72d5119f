"""A robot with ROS 2 through rosbridge: messages in JSON over a web socket.

rosbridge_server runs on the robot, and rosapi beside it, which tells what type a topic has and who subscribes to it.
Nothing waits in a queue of ours, and little in the system's: a socket that has not taken a message in 50 ms, or whose
other end has confirmed nothing for half a second, is a lost link. A bridge that hangs is found by pings.

The web socket is that of the library ``websockets``. roslibpy, the usual client of rosbridge, has an event loop that
cannot start a second time in a process, so that a lost robot could never be opened again, and a queue without bounds.

Source: RobotWebTools, rosbridge protocol 2.1; rosapi.
"""

from __future__ import annotations

import json
import math
import socket
import struct
import time
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from pydantic import Field

from stadimeter.bases.protocol import Motion, Unacknowledged
from stadimeter.config.extras import missing
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Duration, Speed, TurnRate
from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.core.measurement import Track
from stadimeter.errors import DeviceClosedError, DeviceOpenError, DriverUnavailableError, LinkLostError, ProtocolError

# Messages of ROS 2 in JSON, as rosbridge has them. No socket is touched here -----------------------------------------
#
# A `TwistStamped` bears the time 0. Controllers of ros2_control put the time of its arrival in its place, and those
# that look at no time do not mind; a time of this computer would be too old, or in the future, on a robot whose
# clock differs.
#
# A pose bears the time of its frame, by this computer's clock: filters need it, and both clocks must agree.
#
# Source: geometry_msgs, sensor_msgs and std_msgs of ROS 2; REP 103.

MessageName = Literal["Twist", "TwistStamped"]

POSE_TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"
BATTERY_TYPE = "sensor_msgs/msg/BatteryState"

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


def pose_json(pose: TargetPose, frame_id: str) -> dict[str, Any]:
    """Return the fields of a pose."""
    seconds = math.floor(pose.at_s)
    return {
        "header": {"stamp": {"sec": seconds, "nanosec": int((pose.at_s - seconds) * 1e9)}, "frame_id": frame_id},
        "pose": {
            "pose": {
                "position": dict(zip("xyz", pose.position_m, strict=True)),
                "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
            },
            "covariance": list(pose.covariance),
        },
    }


def battery_from_json(fields: Mapping[str, Any]) -> float | None:
    """Return the voltage of a battery state; None if it has none, for which NaN stands, and null in JSON."""
    voltage = fields.get("voltage")
    if isinstance(voltage, bool) or not isinstance(voltage, int | float):
        return None
    return float(voltage) if math.isfinite(voltage) else None


# A robot that runs ROS 2 behind rosbridge: its options, the web socket, and the driver around it ----------------------
#
# No ROS is installed here.
#
# A subscriber ignores messages of a type that is not its own, without a word: a robot that waits for
# ``TwistStamped`` stands for ever under a driver that sends ``Twist``. So the other side is asked for its type when
# the link is opened.

_CONNECTED_WITHIN_S = 3.0
_ANSWERED_WITHIN_S = 2.0
_CLOSED_WITHIN_S = 0.2

# A bridge that has not answered a ping for a second hangs. Less would blame it for a busy processor of ours.
_PINGED_EVERY_S = 0.25
_PONG_WITHIN_S = 1.0

# What the system may hold back: how long it may take a message, and how long the other end may confirm nothing.
_TAKEN_WITHIN_US = 50_000
_CONFIRMED_WITHIN_MS = 500

# What websockets 17 raises when its thread finds the connection broken while another thread writes.
_RACE = AssertionError

# Nothing says that a stop arrived.
_STOP_REPEATS = 3

# A voltage older than this is not known any more. Robots report it every second, or every ten.
_BATTERY_WITHIN_S = 30.0

TopicName = Annotated[str, Field(pattern=r"^/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*$")]

_STANDING = Motion(linear_mps=0.0, angular_radps=0.0)


class RosbridgeOptions(DriverOptions):
    """The options of a robot with ROS 2, by rosbridge."""

    title: ClassVar = "a robot that runs ROS 2, through rosbridge"
    auto_stop_advice: ClassVar = (
        "set the time-out of the robot's controller (cmd_vel_timeout of diff_drive_controller) to 0.5 s, "
        'and write auto_stop = "500 ms"'
    )

    url: Annotated[str, Field(pattern=r"^wss?://.+", examples=["ws://robot.local:9090"])]
    """Where rosbridge_server listens."""
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

    def link(self) -> RosbridgeLink:
        """Return a link that is not open."""
        return RosbridgeLink(self)

    def build(self, context: DriverContext) -> RosbridgeBase:
        """Return the base."""
        return RosbridgeBase(self, context)

    def lacks(self) -> tuple[str, ...]:
        """Return that the library is not installed, if so."""
        return tuple(filter(None, (missing("ros2"),)))

    def stops_by_itself_after_s(self) -> float:
        """Return the time that the controller is said to have; infinity for 0, which stands for none."""
        return self.auto_stop or math.inf


class RosbridgeLink:
    """A web socket to rosbridge."""

    def __init__(self, options: RosbridgeOptions) -> None:
        self._options = options
        self._url, self._message = options.url, options.message
        self._topic, self._pose_topic, self._battery_topic = (
            "/" + (topic or "").removeprefix("/")
            for topic in (options.topic, options.pose_topic, options.battery_topic)
        )
        self._battery_v: float | None = None
        self._socket: Any = None
        self._closing = ExitStack()

    def open(self) -> None:
        """Connect, ask rosapi for the type and the subscribers of the topic, and advertise it."""
        self._socket = self._connect()
        self._limit_what_waits()
        try:
            self._check_other_side()
            self._say({"op": "advertise", "topic": self._topic, "type": type_name(self._message)})
            if self._options.pose_topic:
                self._say({"op": "advertise", "topic": self._pose_topic, "type": POSE_TYPE})
            if self._options.battery_topic:
                self._say({"op": "subscribe", "topic": self._battery_topic, "type": BATTERY_TYPE})
        except LinkLostError as error:
            raise DeviceOpenError(f"the connection was lost while it was opened: {error}") from error

    def send(self, motion: Motion) -> None:
        """Send a message."""
        fields = velocity_json(motion, self._message, self._options.frame_id)
        self._say({"op": "publish", "topic": self._topic, "msg": fields})

    def show(self, pose: TargetPose) -> None:
        """Send the pose of a target."""
        fields = pose_json(pose, self._options.pose_frame_id)
        self._say({"op": "publish", "topic": self._pose_topic, "msg": fields})

    def battery_v(self) -> float | None:
        """Return the voltage that `check` has read since this was last asked."""
        battery_v, self._battery_v = self._battery_v, None
        return battery_v

    def check(self) -> None:
        """Read what rosbridge has sent: what it refuses, and what was subscribed to."""
        while said := self._read(0):
            if said.get("topic") == self._battery_topic and isinstance(fields := said.get("msg"), dict):
                self._battery_v = battery_from_json(fields)
            if said.get("op") == "status" and said.get("level") == "error":
                raise ProtocolError(f"rosbridge at {self._url} refuses {self._topic}: {said.get('msg')}")

    def close(self) -> None:
        """Let go of the connection."""
        self._socket = None
        self._closing.close()

    def _connect(self) -> Any:
        try:
            from websockets.exceptions import WebSocketException  # noqa: PLC0415 - optional
            from websockets.sync.client import connect  # noqa: PLC0415 - optional
        except ImportError as error:
            raise DriverUnavailableError(f"ros2-rosbridge needs websockets: {missing('ros2') or error}") from error
        try:
            # As a context manager: what `connect` returns without one is no connection since websockets 17.
            return self._closing.enter_context(
                connect(
                    self._url,
                    compression=None,
                    proxy=None,
                    open_timeout=_CONNECTED_WITHIN_S,
                    close_timeout=_CLOSED_WITHIN_S,
                    ping_interval=_PINGED_EVERY_S,
                    ping_timeout=_PONG_WITHIN_S,
                )
            )
        except (OSError, WebSocketException, _RACE) as error:
            raise DeviceOpenError(
                f"no rosbridge answers at {self._url}: {error}; is rosbridge_server running on the robot?"
            ) from error

    def _limit_what_waits(self) -> None:
        taken_within = struct.pack("ll", 0, _TAKEN_WITHIN_US)
        self._socket.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, taken_within)
        self._socket.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _CONFIRMED_WITHIN_MS)

    def _check_other_side(self) -> None:
        """Ask what the topic takes. Where no rosapi runs, that stays unknown."""
        about = self._ask("topic_type")
        if about is None:
            return
        if not about.get("type") or not (self._ask("subscribers") or {}).get("subscribers"):
            raise DeviceOpenError(
                f"nothing subscribes to {self._topic} behind rosbridge at {self._url}; is the robot's base started, "
                "and is that its topic?"
            )
        name = str(about["type"]).rpartition("/")[2]
        if name != self._message:
            raise ProtocolError(
                f"{self._topic} behind rosbridge at {self._url} takes {name}, and would ignore {self._message}; "
                f'write message = "{name}" if that is Twist or TwistStamped'
            )

    def _ask(self, service: str) -> dict[str, Any] | None:
        """Return the answer of rosapi; None if it refuses, or does not run."""
        self._say(
            {"op": "call_service", "id": service, "service": f"/rosapi/{service}", "args": {"topic": self._topic}}
        )
        while said := self._read(_ANSWERED_WITHIN_S):
            if said.get("op") == "service_response" and said.get("id") == service:
                values = said.get("values")
                return values if said.get("result") and isinstance(values, dict) else None
        return None

    def _say(self, operation: dict[str, Any]) -> None:
        from websockets.exceptions import ConnectionClosed  # noqa: PLC0415 - optional

        try:
            self._socket.send(json.dumps(operation))
        except (ConnectionClosed, OSError, _RACE) as error:
            raise self._lost(error) from error

    def _read(self, seconds: float) -> dict[str, Any] | None:
        """Return the next operation that comes in that time; what is none is passed over."""
        from websockets.exceptions import ConnectionClosed  # noqa: PLC0415 - optional

        try:
            said = json.loads(self._socket.recv(timeout=seconds))
        except TimeoutError:
            return None
        except (ConnectionClosed, OSError, _RACE) as error:
            raise self._lost(error) from error
        except ValueError as error:
            raise ProtocolError(f"what answers at {self._url} is no rosbridge: {error}") from error
        return said if isinstance(said, dict) else {"op": "unknown"}

    def _lost(self, error: Exception) -> LinkLostError:
        return LinkLostError(f"the connection to rosbridge at {self._url} is lost: {error}; check the robot's network")


class RosbridgeBase:
    """A `MobileBase` that is a robot with ROS 2. Limits of speed keep to the curve: both speeds shrink alike."""

    def __init__(self, options: RosbridgeOptions, context: DriverContext) -> None:
        self._options = options
        self._context = context
        self._link: RosbridgeLink | None = None
        self._awaited = Unacknowledged(context.clock.now_s(), streams=False, stop_repeats=_STOP_REPEATS)
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

    def _opened(self) -> RosbridgeLink:
        if self._link is None:
            raise DeviceClosedError(f"the base '{self._context.name}' is not open")
        return self._link
