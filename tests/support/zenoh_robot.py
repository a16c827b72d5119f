"""A robot with ROS 2 behind zenoh-bridge-ros2dds, as far as Zenoh shows it: a real peer that listens."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import zenoh
from rosbags.typesys import Stores, get_typestore

from support.broker import free_port

STORE = get_typestore(Stores.ROS2_JAZZY)


class ZenohRobot:
    """The bridge of a robot that takes ``/cmd_vel``, and decodes it with an independent library.

    Attributes:
        heard: The messages that the robot has got.
    """

    def __init__(self, drive: Callable[[float, float], None], takes: str = "Twist", topic: str = "cmd_vel") -> None:
        self.heard: list[Any] = []
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
        self.subscribe()

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

    def _take(self, sample: Any) -> None:
        message = STORE.deserialize_cdr(sample.payload.to_bytes(), f"geometry_msgs/msg/{self._takes}")
        twist = getattr(message, "twist", message)
        self._drive(twist.linear.x, twist.angular.z)
        self.heard.append(message)
