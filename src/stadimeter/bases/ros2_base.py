"""The parts that robots that run ROS 2 have in common: their options, and the driver around a link to them.

No ROS is installed here. Speeds go to the robot's ``cmd_vel`` through a bridge that runs beside its ROS: one file each
for rosbridge and for Zenoh.

A subscriber ignores messages of a type that is not its own, without a word: a robot that waits for ``TwistStamped``
stands for ever under a driver that sends ``Twist``. So the other side is asked for its type when the link is opened.
"""

from __future__ import annotations

import math
import time
from typing import Annotated, ClassVar, Protocol

from msgspec.structs import replace
from pydantic import Field

from stadimeter.bases.acknowledgements import Unacknowledged
from stadimeter.bases.differential_drive import Motion
from stadimeter.bases.ros2_messages import MessageName, TargetPose, target_pose
from stadimeter.config.extras import missing
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Angle, Duration, Speed, TurnRate
from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.core.measurement import Track
from stadimeter.errors import DeviceClosedError

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
    pose_bearing_sigma: Annotated[Angle, Field(gt=0)] = math.radians(0.5)
    """Standard deviation of the direction of a target. Nothing measures it: it is how well the camera is mounted."""
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
        if pose := target_pose(track, time.time() - age_s, self._options.pose_bearing_sigma):
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
