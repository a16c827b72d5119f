from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest
from msgspec.structs import replace
from pydantic import ValidationError

from stadimeter.app.guard import MAX_WAIT_S, REST_S, LeasedOutput
from stadimeter.bases.protocol import WheelSpeeds
from stadimeter.bases.roomba_base import RoombaCodec, RoombaOptions
from stadimeter.bases.serial_base import Greeting, SerialBase
from stadimeter.config.plugins import SerialStop
from stadimeter.core.command import TwistCommand
from stadimeter.errors import ProtocolError
from stadimeter.testing.rig import ManualClock
from support.base_bench import BaseBench, base_bench, opened, wire
from support.each_case import each_case
from support.firmware import FULL, OFF, PASSIVE, SAFE, RoombaFirmware

OI = "irobot_oi"
TABLE = {"track_width": "16 cm"}


def started(mode: int = SAFE) -> RoombaFirmware:
    robot = RoombaFirmware()
    robot.mode = mode
    return robot


def test_an_encoder_that_wraps_around_counts_on() -> None:
    listener, robot = RoombaCodec(), started()
    robot.receive(listener.question, 0.0)
    rolled_m = []
    for step in range(1, 9):
        robot.left.rolled_m = -10.0 * step  # 22,500 counts each: beyond 32,768 at the second
        (message,) = listener.feed(robot.receive(b"", 0.016 * step))
        rolled_m.append(message.left_m)
    assert rolled_m[-1] - rolled_m[0] == pytest.approx(-70.0, abs=0.01)


@each_case("size", range(6))
def test_a_stop_behind_any_part_of_a_frame_stops(size: int) -> None:
    robot, sender = started(), RoombaCodec()
    moving = sender.encode(WheelSpeeds(left_mps=0.4, right_mps=-0.3)).frame
    robot.receive(moving, 0.0)
    robot.receive(moving[:size] + sender.ends_cut_frame + sender.stop, 0.001)
    assert (robot.left.driven_mps, robot.right.driven_mps) == (0.0, 0.0)


@each_case("size", range(12))
def test_the_stop_from_outside_stops_also_behind_half_a_request(size: int) -> None:
    options = RoombaOptions.model_validate({"port": "/dev/ttyUSB0"})
    stop = options.serial_stop()
    robot = started(FULL)
    robot.receive(RoombaCodec().encode(WheelSpeeds(left_mps=0.4, right_mps=0.4)).frame, 0.0)
    robot.receive(options.codec().question[:size], 0.0)
    assert isinstance(stop, SerialStop)
    assert len(stop.frame) <= 64
    robot.receive(stop.frame, 0.001)
    assert (robot.left.driven_mps, robot.right.driven_mps) == (0.0, 0.0)


@pytest.fixture
def bench() -> Iterator[BaseBench]:
    with base_bench("roomba") as bench:
        yield bench


@pytest.fixture
def base(bench: BaseBench) -> Iterator[SerialBase]:
    with opened(bench, **TABLE) as base:
        yield base


class LateLink:
    """A port on which nothing comes before the robot was woken so often."""

    path = "late"

    def __init__(self, *reads: bytes, wakings: int) -> None:
        self._reads, self._starts, self._wakings = [*reads], 0, wakings

    def write(self, frame: bytes) -> None:
        self._starts += frame == b"\x80"

    def read(self) -> bytes:
        return self._reads.pop(0) if self._starts >= self._wakings and self._reads else b""


def report(mode: int) -> bytes:
    robot = started(mode)
    robot.receive(RoombaCodec().question, 0.0)
    return robot.receive(b"", 0.016)


@pytest.mark.parametrize("wakings", [1, 2])
def test_a_robot_that_is_woken_may_report_what_was_in_between(wakings: int) -> None:
    def greet(*reads: bytes) -> None:
        codec = RoombaCodec()
        Greeting(link=LateLink(*reads, wakings=wakings), clock=ManualClock(), codec=codec, boot_wait_s=2.0).run()

    late = report(SAFE) + report(PASSIVE)
    greet(late, b"", report(SAFE))
    with pytest.raises(ProtocolError, match="not in Safe mode"):
        greet(late, report(PASSIVE))


def test_nothing_stops_it_when_the_host_dies_and_it_says_so(bench: BaseBench, base: SerialBase) -> None:
    bench.drive(base, 0.3)
    bench.clock.advance_s(60.0)
    assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)
    assert RoombaOptions.model_validate({"port": "emulated-roomba"}).stops_by_itself_after_s() == math.inf


def test_closing_stops_it_and_ends_the_open_interface(bench: BaseBench, base: SerialBase) -> None:
    bench.drive(base, 0.3)
    base.close()
    bench.clock.advance_s(1.0)
    assert bench.stands
    assert bench.firmware.mode == OFF
    bench.clock.advance_s(0.1)
    assert bench.firmware.receive(b"", bench.clock.now_s()) == b""


def test_it_reports_battery_bumper_travel_and_overcurrents(bench: BaseBench, base: SerialBase) -> None:
    bench.firmware.battery_v, bench.firmware.is_bumped, bench.firmware.overcurrents = 14.2, True, 0b11000
    bench.drive(base, 0.2, seconds=3.0)
    report = bench.report(base)
    assert report.battery_v == pytest.approx(14.2)
    assert report.is_bumped
    assert report.is_at_cliff is False
    assert report.errors == ("overcurrent of the left wheel", "overcurrent of the right wheel")
    assert (report.left_m, report.right_m) == pytest.approx((0.58, 0.58), abs=0.02)


@pytest.mark.parametrize(
    ("what", "says"),
    [("is_at_cliff", "sees a cliff"), ("is_wheel_dropped", "wheel hangs"), ("is_on_charger", "on its charger")],
)
def test_what_makes_it_leave_safe_mode_is_a_fault_and_it_is_not_put_back(
    bench: BaseBench, base: SerialBase, what: str, says: str
) -> None:
    bench.drive(base, 0.3)
    setattr(bench.firmware, what, True)
    with pytest.raises(ProtocolError, match=says):
        bench.drive(base, 0.3, seconds=0.1)
    setattr(bench.firmware, what, False)
    for _ in range(100):  # commands go on, as if nobody had noticed
        bench.clock.advance_s(0.02)
        with pytest.raises(ProtocolError):
            bench.command(base, 0.3)
    assert bench.firmware.mode == PASSIVE
    assert bench.stands


@pytest.mark.parametrize(("what", "says"), [("is_at_cliff", "sees a cliff"), ("is_wheel_dropped", "wheel hangs")])
def test_at_a_cliff_it_cannot_be_opened_until_somebody_has_moved_it(
    bench: BaseBench, base: SerialBase, what: str, says: str
) -> None:
    bench.drive(base, 0.3)
    setattr(bench.firmware, what, True)
    with pytest.raises(ProtocolError):
        bench.drive(base, 0.3)
    base.close()
    for _ in range(2):
        with pytest.raises(ProtocolError, match=says):
            base.open()
        assert bench.stands
    setattr(bench.firmware, what, False)
    base.open()
    bench.drive(base, 0.3)
    assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)


@pytest.mark.long
def test_a_run_leaves_it_standing_at_a_stair_until_it_is_moved_away(bench: BaseBench) -> None:
    clock = bench.clock
    standing = TwistCommand(output="base", linear_mps=0.0, angular_radps=0.0)
    output = LeasedOutput(bench.base(**TABLE), standing, 0.2, clock)
    output.open()

    def run(seconds: float) -> None:
        for _ in range(round(seconds / 0.05)):
            output.observed_fault()
            output.apply(replace(standing, linear_mps=0.3, captured_at_s=clock.now_s()))
            clock.advance_s(0.05)
            output.check(clock.now_s())

    run(1.0)
    assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)
    bench.firmware.is_at_cliff = True
    run(1.0)
    for _ in range(60):
        run(1.0)
        assert bench.stands
    assert "cliff" in output.fault
    bench.firmware.is_at_cliff = False
    run(MAX_WAIT_S + REST_S + 2.0)
    assert not output.fault
    assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)
    output.close()


def test_a_cliff_behind_a_robot_that_backs_away_is_reported_and_no_fault(bench: BaseBench, base: SerialBase) -> None:
    bench.drive(base, -0.2, seconds=0.5)
    bench.firmware.is_at_cliff = True
    bench.drive(base, -0.2, seconds=0.5)
    assert bench.report(base).is_at_cliff


def test_a_robot_that_drove_when_an_earlier_program_died_is_stopped_by_opening_it(bench: BaseBench) -> None:
    bench.firmware.mode = FULL
    bench.firmware.receive(wire(OI, "drive_direct_r-200_l500")[:3], 0.0)
    bench.firmware.left.driven_mps = bench.firmware.right.driven_mps = 0.5
    with opened(bench, **TABLE):
        bench.clock.advance_s(1.0)
        assert bench.stands
        assert bench.firmware.mode == SAFE


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"max_wheel_speed": "0.6 m/s"}, "beyond 0.5 m/s"),
        ({"model": "create-2"}, "model"),
        ({"track_width": "0 cm"}, "track_width"),
    ],
)
def test_a_table_that_cannot_be_meant_is_refused(table: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        RoombaOptions.model_validate({"port": "emulated-roomba"} | table)
