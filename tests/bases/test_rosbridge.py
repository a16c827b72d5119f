from __future__ import annotations

import math
import socket
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from pydantic import ValidationError

pytest.importorskip("websockets", reason="the library of the extra ros2")

from stadimeter.app.bootstrap import build
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits, Loop
from stadimeter.bases.rosbridge import RosbridgeBase, RosbridgeOptions
from stadimeter.config.loader import load_configuration
from stadimeter.config.plugins import DriverContext
from stadimeter.core.command import TwistCommand
from stadimeter.core.frame import Frame
from stadimeter.errors import DeviceOpenError, DriverError, LinkLostError, ProtocolError
from stadimeter.testing.rig import ManualClock, eventually
from support.each_case import each_case
from support.rosbridge_server import RosbridgeServer
from support.simulated_run import SIMULATED_BALL
from support.tunnel import Tunnel


@pytest.fixture
def driven() -> list[tuple[float, float]]:
    return []


@pytest.fixture
def bridge(driven: list[tuple[float, float]]) -> Iterator[RosbridgeServer]:
    bridge = RosbridgeServer(lambda *speeds: driven.append(speeds))
    yield bridge
    bridge.stop()


def base_at(url: str, clock: ManualClock | None = None, **table: object) -> RosbridgeBase:
    options = RosbridgeOptions.model_validate({"url": url} | table)
    return options.build(DriverContext(name="base", clock=clock or ManualClock()))


def twist(linear_mps: float, angular_radps: float) -> TwistCommand:
    return TwistCommand(output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=0.0)


@pytest.mark.parametrize("message", ["Twist", "TwistStamped"])
def test_the_robot_gets_its_type_of_message(
    bridge: RosbridgeServer, driven: list[tuple[float, float]], message: str
) -> None:
    bridge.takes = message
    base = base_at(bridge.url, message=message)
    base.open()
    base.apply(twist(0.3, -0.5))
    base.close()
    eventually(lambda: len(driven) == 3)
    assert driven == [(0.0, 0.0), (0.3, -0.5), (0.0, 0.0)]


@pytest.mark.parametrize(("takes", "message"), [("Twist", "TwistStamped"), ("TwistStamped", "Twist")])
def test_a_message_that_the_robot_would_ignore_is_refused(bridge: RosbridgeServer, takes: str, message: str) -> None:
    bridge.takes = takes
    with pytest.raises(ProtocolError, match=f'takes {takes}, and would ignore {message}; write message = "{takes}"'):
        base_at(bridge.url, message=message).open()
    eventually(lambda: not bridge.is_used)


@pytest.mark.parametrize("topic", ["/cmd_vel", "/cmd_vel_unstamped"])
def test_a_topic_that_nothing_subscribes_to_is_refused(bridge: RosbridgeServer, topic: str) -> None:
    bridge.takes = "" if topic == "/cmd_vel" else "Twist"
    with pytest.raises(DeviceOpenError, match=f"nothing subscribes to {topic}"):
        base_at(bridge.url, topic=topic).open()


def test_without_rosapi_the_type_stays_unknown_and_it_drives(
    bridge: RosbridgeServer, driven: list[tuple[float, float]]
) -> None:
    bridge.has_rosapi = False
    base = base_at(bridge.url)
    base.open()
    base.apply(twist(0.2, 0.0))
    eventually(lambda: (0.2, 0.0) in driven)
    base.close()


def test_a_curve_that_is_too_fast_is_driven_slower_along_the_same_curve(bridge: RosbridgeServer) -> None:
    base = base_at(bridge.url, max_linear="0.4 m/s", max_angular="1 rad/s")
    base.open()
    applied = base.apply(twist(0.8, 1.0))
    assert (applied.linear_mps, applied.angular_radps) == pytest.approx((0.4, 0.5))
    base.close()


def test_a_stop_is_repeated(bridge: RosbridgeServer, driven: list[tuple[float, float]]) -> None:
    clock = ManualClock()
    base = base_at(bridge.url, clock)
    base.open()
    base.apply(twist(0.2, 0.0))
    base.stop()
    for _ in range(50):
        clock.advance_s(0.02)
        base.tick(clock.now_s())
    eventually(lambda: len(driven) == 5)
    assert driven[2:] == [(0.0, 0.0)] * 3
    base.close()


def test_a_battery_is_reported_until_its_robot_says_nothing_of_it_any_more(bridge: RosbridgeServer) -> None:
    clock = ManualClock()
    base = base_at(bridge.url, clock, battery_topic="battery_state")
    base.open()
    assert base.report() is None
    eventually(lambda: bridge.subscribed == {"/battery_state": "sensor_msgs/msg/BatteryState"})
    bridge.say({"op": "publish", "topic": "/other", "msg": {"voltage": 5.0}})
    bridge.say({"op": "publish", "topic": "/battery_state", "msg": {"voltage": 11.5}})
    eventually(lambda: base.tick(clock.now_s()) or base.report())
    assert base.report().battery_v == 11.5
    clock.advance_s(31.0)
    assert base.report() is None
    base.close()


def loop_with_poses(folder: Path, url: str, camera: str = SIMULATED_BALL) -> Loop:
    path = folder / "robot.toml"
    path.write_text(
        camera + f'[base]\ndriver = "ros2-rosbridge"\nurl = "{url}"\npose_topic = "/target_pose"\n'
        '[rules.follow]\nactuator = "base"\nfollow = { distance = "1 m", max_speed = "0.1 m/s" }\n[world]\n'
    )
    return Loop(build(load_configuration(path), speed=None))


def test_a_run_publishes_where_its_target_is_while_it_sees_it(bridge: RosbridgeServer, tmp_path: Path) -> None:
    loop = loop_with_poses(tmp_path, bridge.url)
    world = loop.parts.shared.parts["world"]
    seen = []

    def listen(record: CycleRecord, frame: Frame | None) -> None:
        world.faults.target_hidden = record.observation.now_s > 2.0
        seen.extend(each for each in record.decision.tracks if frame and each.measured_at_s == frame.captured_at_s)

    loop.listeners.append(listen)
    loop.run(Limits(seconds=4.0))
    assert eventually(lambda: len(bridge.poses) == len(seen) and len(seen)) > 30
    poses = [fields["pose"]["pose"]["position"] for fields in bridge.poses]
    for pose, track in zip(poses, seen, strict=True):
        assert math.dist(pose.values(), (0, 0, 0)) == pytest.approx(track.distance_m)
        assert math.atan2(-pose["y"], pose["x"]) == pytest.approx(track.bearing_rad)


def test_a_run_whose_pictures_are_too_old_publishes_no_poses(bridge: RosbridgeServer, tmp_path: Path) -> None:
    late = SIMULATED_BALL.replace("render = false", 'render = false\nlatency = "600 ms"')
    loop = loop_with_poses(tmp_path, bridge.url, late)
    seen = []
    loop.listeners.append(lambda record, _frame: seen.extend(record.decision.tracks))
    loop.run(Limits(seconds=3.0))
    assert seen
    assert bridge.poses == []


def test_what_rosbridge_refuses_is_an_error(bridge: RosbridgeServer) -> None:
    base = base_at(bridge.url)
    base.open()
    bridge.say({"op": "status", "level": "error", "msg": "advertise: /cmd_vel has another type"})
    with pytest.raises(ProtocolError, match="another type"):
        eventually(lambda: base.tick(0.0))
    base.close()


@pytest.mark.parametrize("said", [[1, 2], {"op": "status", "level": "warning", "msg": "slow"}, {"op": 5}])
def test_what_rosbridge_says_besides_is_passed_over(bridge: RosbridgeServer, said: object) -> None:
    base = base_at(bridge.url)
    base.open()
    bridge.say(said)
    bridge.say({"op": "status", "level": "error", "msg": "this comes behind it"})
    with pytest.raises(ProtocolError, match="behind it"):
        eventually(lambda: base.tick(0.0))
    base.close()


@pytest.mark.long
@pytest.mark.parametrize("fault", ["clog", "cut"])
def test_a_bridge_that_hangs_or_vanishes_is_a_lost_link(bridge: RosbridgeServer, fault: str) -> None:
    tunnel = Tunnel(int(bridge.url.rpartition(":")[2]))
    tunnel.mend()
    base = base_at(f"ws://127.0.0.1:{tunnel.port}")
    base.open()
    getattr(tunnel, fault)()
    with pytest.raises(LinkLostError, match="lost"):
        eventually(lambda: base.tick(0.0))
    with suppress(DriverError):
        base.close()
    tunnel.cut()


@pytest.mark.parametrize(("auto_stop", "after_s"), [("250 ms", 0.25), ("0 s", math.inf)])
def test_it_says_what_the_robots_controller_does_when_this_computer_dies(auto_stop: str, after_s: float) -> None:
    options = RosbridgeOptions.model_validate({"url": "ws://robot.local:9090", "auto_stop": auto_stop})
    assert options.stops_by_itself_after_s() == after_s


# A race in websockets 17: its thread may still write while the connection that failed is closed, and then says so.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_port_where_something_else_listens_is_no_rosbridge() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            with suppress(OSError):
                connection, _ = server.accept()
                connection.sendall(b"SSH-2.0-OpenSSH_9.2\r\n")
                connection.close()

        threading.Thread(target=answer, daemon=True).start()
        with pytest.raises(DeviceOpenError, match="no rosbridge answers"):
            base_at(f"ws://127.0.0.1:{server.getsockname()[1]}").open()


@each_case(
    "table",
    [
        {"url": "robot.local"},
        {"topic": "cmd vel"},
        {"topic": ""},
        {"message": "Pose"},
        {"max_linear": "-1 m/s"},
        {"port": "/dev/ttyUSB0"},
        {"pose_topic": "no topic"},
        {"topic": "/größe"},
    ],
)
def test_a_table_that_cannot_be_meant_is_refused(table: dict[str, str]) -> None:
    with pytest.raises(ValidationError):
        RosbridgeOptions.model_validate({"url": "ws://robot.local:9090"} | table)
