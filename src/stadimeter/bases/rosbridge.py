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
import socket
import struct
from contextlib import ExitStack
from typing import Annotated, Any, ClassVar

from pydantic import Field

from stadimeter.bases import ros2_base
from stadimeter.bases.differential_drive import Motion
from stadimeter.config.extras import missing
from stadimeter.errors import DeviceOpenError, DriverUnavailableError, LinkLostError, ProtocolError

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


class RosbridgeOptions(ros2_base.Ros2BaseOptions):
    """The table of such a base in the configuration."""

    title: ClassVar = "a robot that runs ROS 2, through rosbridge"
    extra: ClassVar = "ros2"

    url: Annotated[str, Field(pattern=r"^wss?://.+", examples=["ws://robot.local:9090"])]
    """Where rosbridge_server listens."""

    def link(self) -> RosbridgeLink:
        """Return a link that is not open."""
        return RosbridgeLink(self)


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
            self._say({"op": "advertise", "topic": self._topic, "type": ros2_base.type_name(self._message)})
            if self._options.pose_topic:
                self._say({"op": "advertise", "topic": self._pose_topic, "type": ros2_base.POSE_TYPE})
            if self._options.battery_topic:
                self._say({"op": "subscribe", "topic": self._battery_topic, "type": ros2_base.BATTERY_TYPE})
        except LinkLostError as error:
            raise DeviceOpenError(f"the connection was lost while it was opened: {error}") from error

    def send(self, motion: Motion) -> None:
        """Send a message."""
        fields = ros2_base.velocity_json(motion, self._message, self._options.frame_id)
        self._say({"op": "publish", "topic": self._topic, "msg": fields})

    def show(self, pose: ros2_base.TargetPose) -> None:
        """Send the pose of a target."""
        fields = ros2_base.pose_json(pose, self._options.pose_frame_id)
        self._say({"op": "publish", "topic": self._pose_topic, "msg": fields})

    def battery_v(self) -> float | None:
        """Return the voltage that `check` has read since this was last asked."""
        battery_v, self._battery_v = self._battery_v, None
        return battery_v

    def check(self) -> None:
        """Read what rosbridge has sent: what it refuses, and what was subscribed to."""
        while said := self._read(0):
            if said.get("topic") == self._battery_topic and isinstance(fields := said.get("msg"), dict):
                self._battery_v = ros2_base.battery_from_json(fields)
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
