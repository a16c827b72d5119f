from __future__ import annotations

from collections.abc import Iterator

import pytest
from pydantic import ValidationError

pytest.importorskip("zenoh", reason="the library of the extra zenoh")
pytest.importorskip("rosbags", reason="an independent decoder of CDR, of the group dev")

from stadimeter.bases.ros2_base import Ros2Base
from stadimeter.bases.zenoh_bridge import ZenohOptions
from stadimeter.config.plugins import DriverContext
from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.core.measurement import Track
from stadimeter.errors import DeviceOpenError, LinkLostError, ProtocolError
from stadimeter.testing.rig import ManualClock, eventually
from support.zenoh_robot import ZenohRobot

Driven = list[tuple[float, float]]


@pytest.fixture
def driven() -> Driven:
    return []


@pytest.fixture
def robot(driven: Driven) -> Iterator[ZenohRobot]:
    robot = ZenohRobot(lambda *speeds: driven.append(speeds))
    yield robot
    robot.stop()


def base_at(endpoint: str, **table: object) -> Ros2Base:
    options = ZenohOptions.model_validate({"endpoint": endpoint} | table)
    return options.build(DriverContext(name="base", clock=ManualClock()))


def twist(linear_mps: float, angular_radps: float) -> TwistCommand:
    return TwistCommand(output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=0.0)


@pytest.mark.parametrize(("takes", "topic"), [("Twist", "/cmd_vel"), ("TwistStamped", "/robot_1/cmd_vel")])
def test_the_robot_gets_its_type_of_message(driven: Driven, takes: str, topic: str) -> None:
    robot = ZenohRobot(lambda *speeds: driven.append(speeds), takes, topic.removeprefix("/"))
    base = base_at(robot.endpoint, message=takes, topic=topic)
    base.open()
    base.apply(twist(0.3, -0.5))
    eventually(lambda: len(driven) == 2)
    base.close()
    eventually(lambda: len(driven) == 3)
    assert driven == [(0.0, 0.0), (0.3, -0.5), (0.0, 0.0)]
    robot.stop()


def test_a_message_that_the_robot_would_ignore_is_refused(robot: ZenohRobot, driven: Driven) -> None:
    with pytest.raises(ProtocolError, match="takes Twist, and would ignore TwistStamped"):
        base_at(robot.endpoint, message="TwistStamped").open()
    assert not driven


def test_a_topic_that_nothing_subscribes_to_is_refused(robot: ZenohRobot) -> None:
    with pytest.raises(DeviceOpenError, match="nothing subscribes to cmd_vel_unstamped"):
        base_at(robot.endpoint, topic="/cmd_vel_unstamped").open()


def test_a_subscriber_that_ends_is_a_lost_link_and_can_come_back(robot: ZenohRobot, driven: Driven) -> None:
    base = base_at(robot.endpoint)
    base.open()
    base.apply(twist(0.2, 0.0))
    robot.unsubscribe()
    with pytest.raises(LinkLostError, match="nothing subscribes"):
        eventually(lambda: base.tick(0.0))
    with pytest.raises(LinkLostError, match="nothing subscribes to cmd_vel"):
        base.apply(twist(0.2, 0.0))
    base.close()
    robot.subscribe()
    driven.clear()
    base.open()
    base.apply(twist(0.2, 0.0))
    eventually(lambda: (0.2, 0.0) in driven)
    base.close()


@pytest.mark.long
def test_a_bridge_that_ends_is_a_lost_link_and_cannot_be_opened(robot: ZenohRobot) -> None:
    base = base_at(robot.endpoint)
    base.open()
    robot.stop()
    with pytest.raises(LinkLostError, match="nothing subscribes"):
        eventually(lambda: base.tick(0.0))
    base.close()
    with pytest.raises(DeviceOpenError, match="no Zenoh answers"):
        base.open()


def test_poses_of_targets_and_the_battery_go_over_the_same_session(robot: ZenohRobot) -> None:
    base = base_at(robot.endpoint, pose_topic="/target_pose", battery_topic="/battery_state", pose_target="ball")
    base.open()
    base.show_target(Track(target="ball", distance_m=2.0, sigma_m=0.1, bearing_rad=0.0, elevation_rad=0.0))
    base.show_target(Track(target="post", distance_m=3.0, sigma_m=0.1, bearing_rad=0.0, elevation_rad=0.0))
    base.show_target(Track(target="ball"))
    eventually(lambda: robot.poses)
    robot.say_battery(11.5)
    eventually(lambda: base.tick(1.0) or base.report())
    assert base.report() == BaseReport(at_s=1.0, battery_v=11.5)
    base.close()
    (pose,) = robot.poses
    assert (pose.header.frame_id, pose.pose.pose.position.x) == ("camera_link", 2.0)


@pytest.mark.parametrize("table", [{"endpoint": "robot.local"}, {"topic": "/cmd_vel/"}, {"message": "twist"}])
def test_a_table_that_cannot_be_meant_is_refused(table: dict[str, str]) -> None:
    with pytest.raises(ValidationError):
        ZenohOptions.model_validate({"endpoint": "tcp/robot.local:7447"} | table)
