"""A robot with ROS 2 behind zenoh-bridge-ros2dds, as far as Zenoh shows it: a real peer that listens."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import zenoh
from rosbags.typesys import Stores, get_typestore

from support.broker import free_port

STORE = get_typestore(Stores.ROS2_JAZZY)


def battery_state(voltage: float, frame_id: str = "battery") -> Any:
    """Return the state of a battery of which little more than the voltage is known."""
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), frame_id)
    unknown = [math.nan] * 6
    nothing = np.array([], np.float32)
    states = (0, 0, 0, True)
    return types["sensor_msgs/msg/BatteryState"](header, voltage, *unknown, *states, nothing, nothing, "", "")


class ZenohRobot:
    """The bridge of a robot that takes ``/cmd_vel``, and decodes it with an independent library.

    Attributes:
        heard: The messages that the robot has got.
        poses: The poses of targets that something on the robot has got, on ``/target_pose``.
    """

    def __init__(self, drive: Callable[[float, float], None], takes: str = "Twist", topic: str = "cmd_vel") -> None:
        self.heard: list[Any] = []
        self.poses: list[Any] = []
        self._drive = drive
        self._takes = takes
        self._topic = topic
        self._port = free_port()
        self._session: Any = None
        self._subscriber: Any = None
        self.start()

    @property
    def endpoint(self) -> str:
        """Where it listens, or listened."""
        return f"tcp/127.0.0.1:{self._port}"

    @property
    def is_used(self) -> bool:
        """Whether somebody is connected."""
        return bool(self._session and self._session.info.transports())

    def start(self) -> None:
        """Listen, at the same port as before."""
        config = zenoh.Config()
        config.insert_json5("mode", '"router"')
        config.insert_json5("listen/endpoints", f'["{self.endpoint}"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        self._session = zenoh.open(config)
        self._session.declare_subscriber("target_pose", self._take_pose)
        self.subscribe()

    def say_battery(self, voltage: float) -> None:
        """Publish the state of the battery."""
        message = battery_state(voltage)
        self._session.put("battery_state", bytes(STORE.serialize_cdr(message, message.__msgtype__)))

    def subscribe(self) -> None:
        """Let the robot's base begin: it subscribes, and the bridge declares a token for that."""
        name = f"geometry_msgs§msg§{self._takes}"
        self._subscriber = self._session.declare_subscriber(self._topic, self._take)
        token = f"@/{self._session.zid()}/@ros2_lv/MS/{self._topic.replace('/', '§')}/{name}/:::"
        self._token = self._session.liveliness().declare_token(token)

    def unsubscribe(self) -> None:
        """Let the robot's base end, while the bridge runs on."""
        self._token.undeclare()
        self._subscriber.undeclare()

    def stop(self) -> None:
        """End."""
        if self._session:
            self._session.close()
            self._session = None

    def _take_pose(self, sample: Any) -> None:
        self.poses.append(
            STORE.deserialize_cdr(sample.payload.to_bytes(), "geometry_msgs/msg/PoseWithCovarianceStamped")
        )

    def _take(self, sample: Any) -> None:
        message = STORE.deserialize_cdr(sample.payload.to_bytes(), f"geometry_msgs/msg/{self._takes}")
        twist = getattr(message, "twist", message)
        self._drive(twist.linear.x, twist.angular.z)
        self.heard.append(message)
