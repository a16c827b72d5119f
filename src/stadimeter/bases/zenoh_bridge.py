"""A robot with ROS 2 through Zenoh: messages in CDR, to zenoh-bridge-ros2dds on the robot.

The bridge declares a liveliness token for each subscriber of its ROS, with topic and type in it. So the type is known
when the link is opened, and a subscriber that ends, or a bridge that dies, is noticed at once. A network that breaks is
noticed after the lease that is set in the bridge, 10 s unless changed; the robot's controller stops it before that.

Messages that the network cannot take are dropped, never queued. rmw_zenoh, which is not a bridge, names its topics
otherwise, and is not spoken to.

Source: eclipse-zenoh/zenoh-plugin-ros2dds, ``liveliness_mgt.rs``.
"""

from __future__ import annotations

import json
from typing import Annotated, Any, ClassVar

from pydantic import Field

from stadimeter.bases.differential_drive import Motion
from stadimeter.bases.ros2_base import Ros2BaseOptions, TargetPose, battery_from_cdr, pose_cdr, velocity_cdr
from stadimeter.config.extras import missing
from stadimeter.errors import DeviceOpenError, DriverUnavailableError, LinkLostError, ProtocolError

_CONNECTED_WITHIN_MS = 3000
_ANSWERED_WITHIN_S = 2.0

# In liveliness tokens, where a slash would end a part of their name.
_SLASH = "§"


class ZenohOptions(Ros2BaseOptions):
    """The table of such a base in the configuration."""

    title: ClassVar = "a robot that runs ROS 2, through zenoh-bridge-ros2dds"
    extra: ClassVar = "zenoh"

    endpoint: Annotated[str, Field(pattern=r"^(tcp|udp|tls|quic|ws)/.+:\d+$", examples=["tcp/robot.local:7447"])]
    """Where the bridge listens."""

    def link(self) -> ZenohLink:
        """Return a link that is not open."""
        return ZenohLink(self)


class ZenohLink:
    """A session with the bridge."""

    def __init__(self, options: ZenohOptions) -> None:
        self._options = options
        self._endpoint, self._message = options.endpoint, options.message
        self._key = options.topic.removeprefix("/")
        self._battery_v: float | None = None
        self._session: Any = None
        self._publisher: Any = None
        self._pose_publisher: Any = None
        # The tokens of subscribers that live; a thread of Zenoh writes it.
        self._subscribers: set[str] = set()

    def open(self) -> None:
        """Connect, and look for a subscriber of our type."""
        self._session = self._connect()
        name = self._key.replace("/", _SLASH)
        for tokens in (f"@ros2_lv/*/MS/{name}/*/*", f"@/*/@ros2_lv/MS/{name}/*/*"):  # of older and newer bridges
            self._session.liveliness().declare_subscriber(tokens, self._note)
            for reply in self._session.liveliness().get(tokens, timeout=_ANSWERED_WITHIN_S):
                if reply.ok:
                    self._subscribers.add(str(reply.ok.key_expr))
        self._check_types()
        self._publisher = self._session.declare_publisher(self._key, express=True)
        if self._options.pose_topic:
            self._pose_publisher = self._session.declare_publisher(self._options.pose_topic.removeprefix("/"))
        if self._options.battery_topic:
            self._session.declare_subscriber(self._options.battery_topic.removeprefix("/"), self._note_battery)

    def send(self, motion: Motion) -> None:
        """Send a message, or drop it where the network is full."""
        self._put(self._publisher, velocity_cdr(motion, self._message, self._options.frame_id))

    def show(self, pose: TargetPose) -> None:
        """Send the pose of a target, or drop it where the network is full."""
        self._put(self._pose_publisher, pose_cdr(pose, self._options.pose_frame_id))

    def battery_v(self) -> float | None:
        """Return the voltage that has come since this was last asked."""
        battery_v, self._battery_v = self._battery_v, None
        return battery_v

    def _put(self, publisher: Any, message: bytes) -> None:
        try:
            publisher.put(message)
        except Exception as error:  # Zenoh's own are of no common type
            raise LinkLostError(f"the session with {self._endpoint} is lost: {error}") from error

    def check(self) -> None:
        """Raise `LinkLostError` when the bridge is gone, or nothing subscribes any more.

        A bridge that ends takes its tokens back only as far as a router between us and it would say so.
        """
        info = self._session.info
        if not (info.routers_zid() or info.peers_zid()) or self._message not in self._types():
            raise LinkLostError(
                f"nothing subscribes to {self._key} at {self._endpoint} any more: the bridge or the robot's base ended"
            )

    def close(self) -> None:
        """End the session."""
        if self._session:
            self._session.close()
            self._session = self._publisher = self._pose_publisher = None

    def _connect(self) -> Any:
        try:
            import zenoh  # noqa: PLC0415 - optional, and slow to load
        except ImportError as error:
            raise DriverUnavailableError(f"ros2-zenoh needs eclipse-zenoh: {missing('zenoh') or error}") from error
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([self._endpoint]))
        config.insert_json5("connect/timeout_ms", str(_CONNECTED_WITHIN_MS))
        config.insert_json5("scouting/multicast/enabled", "false")
        try:
            return zenoh.open(config)
        except Exception as error:
            raise DeviceOpenError(
                f"no Zenoh answers at {self._endpoint}: {error}; is zenoh-bridge-ros2dds running on the robot?"
            ) from error

    def _note_battery(self, sample: Any) -> None:
        self._battery_v = battery_from_cdr(sample.payload.to_bytes())

    def _note(self, sample: Any) -> None:
        """Take in that a subscriber has come or gone."""
        change = self._subscribers.discard if str(sample.kind).endswith("DELETE") else self._subscribers.add
        change(str(sample.key_expr))

    def _types(self) -> set[str]:
        """Return the types that subscribers take, such as ``Twist``: the part of a token before the last."""
        return {token.split("/")[-2].rpartition(_SLASH)[2] for token in tuple(self._subscribers)}

    def _check_types(self) -> None:
        types = self._types()
        if not types:
            raise DeviceOpenError(
                f"nothing subscribes to {self._key} at {self._endpoint}; is the robot's base started, is that its "
                "topic, and is what answers zenoh-bridge-ros2dds?"
            )
        if self._message not in types:
            raise ProtocolError(
                f"{self._key} at {self._endpoint} takes {', '.join(sorted(types))}, and would ignore {self._message}; "
                "change message if that is Twist or TwistStamped"
            )
