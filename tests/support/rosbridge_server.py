"""A robot with ROS 2 behind rosbridge, as far as its web socket shows it.

It speaks the rosbridge protocol with the library's own server: advertise, publish, status, and the services of rosapi
that tell of topics. Its controller moves the simulated robot, and stops it when no message came for half a second.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.server import Server, ServerConnection, serve

from support.broker import free_port


class RosbridgeServer:
    """The bridge, and the one topic ``/cmd_vel`` of its robot.

    Attributes:
        takes: What the robot subscribes with; an empty string for no subscriber.
        has_rosapi: Whether rosapi runs beside it.
        heard: What the robot has got: messages of its own type.
        poses: The poses of targets that were published after their topic was advertised.
        subscribed: The topics that were subscribed to, and their types.
    """

    def __init__(self, drive: Callable[[float, float], None], takes: str = "Twist") -> None:
        self.takes = takes
        self.has_rosapi = True
        self.heard: list[dict[str, Any]] = []
        self.poses: list[dict[str, Any]] = []
        self.subscribed: dict[str, str] = {}
        self._advertised: dict[str, str] = {}
        self._drive = drive
        self._connections: set[ServerConnection] = set()
        self._server: Server | None = None
        self._port = free_port()  # nothing else takes it while it is stopped
        self.start()

    @property
    def url(self) -> str:
        """Where it listens, or listened."""
        return f"ws://127.0.0.1:{self._port}"

    @property
    def is_used(self) -> bool:
        """Whether somebody is connected."""
        return any(connection.state.name == "OPEN" for connection in tuple(self._connections))

    def start(self) -> None:
        """Listen, at the same port as before."""
        self._server = serve(self._talk, "127.0.0.1", self._port, ping_interval=None)
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def stop(self) -> None:
        """End, as a robot does that is switched off properly: every connection is closed."""
        if self._server:
            self._server.shutdown()
            self._server = None
        for connection in tuple(self._connections):
            connection.close()

    def say(self, operation: object) -> None:
        """Send something to all who are connected."""
        for connection in tuple(self._connections):
            connection.send(json.dumps(operation))

    def _talk(self, connection: ServerConnection) -> None:
        self._connections.add(connection)
        try:
            for text in connection:
                self._take(connection, json.loads(text))
        except ConnectionClosed:
            pass
        finally:
            self._connections.discard(connection)

    def _take(self, connection: ServerConnection, operation: dict[str, Any]) -> None:
        match operation:
            case {"op": "call_service", "id": name, "service": service, "args": {"topic": topic}}:
                values = self._answer(service, topic)
                answer = {"op": "service_response", "id": name, "service": service, "values": values}
                connection.send(json.dumps(answer | {"result": self.has_rosapi}))
            case {"op": "advertise", "topic": topic, "type": name}:
                self._advertised[topic] = name
            case {"op": "subscribe", "topic": topic, "type": name}:
                self.subscribed[topic] = name
            case {"op": "publish", "topic": topic, "msg": fields} if (
                self._advertised.get(topic) == "geometry_msgs/msg/PoseWithCovarianceStamped"
            ):
                self.poses.append(fields)
            case {"op": "publish", "topic": "/cmd_vel", "msg": fields} if ("header" in fields) == (
                self.takes == "TwistStamped"
            ):
                twist = fields.get("twist", fields)
                self._drive(twist["linear"]["x"], twist["angular"]["z"])
                self.heard.append(fields)

    def _answer(self, service: str, topic: str) -> dict[str, Any] | str:
        if not self.has_rosapi:
            return f"Service {service} does not exist"
        is_known = topic == "/cmd_vel" and self.takes
        if service == "/rosapi/topic_type":
            return {"type": f"geometry_msgs/msg/{self.takes}" if is_known else ""}
        return {"subscribers": ["/diff_drive_controller"] if is_known else []}
