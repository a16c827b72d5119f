from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from msgspec import Struct
from pydantic import ValidationError

from stadimeter.app.clock import MonotonicClock
from stadimeter.bases.ros_arduino_base import RosArduinoOptions
from stadimeter.bases.serial_base import SerialBase
from stadimeter.bases.serial_link import SerialLink
from stadimeter.config.plugins import DriverContext
from stadimeter.core.command import TwistCommand
from stadimeter.errors import DeviceClosedError, DeviceOpenError, LinkLostError, ProtocolError
from stadimeter.simulation.emulated_base import EmulatedBoard
from stadimeter.simulation.ros_arduino_firmware import EmulatedRosArduinoOptions
from stadimeter.simulation.world import World, WorldOptions
from stadimeter.testing.rig import ManualClock
from support.each_case import each_case

OPTIONS = {
    "port": "emulated-ros-arduino-bridge",
    "wheel_diameter": "65 mm",
    "ticks_per_turn": 1440,
    "track_width": "16 cm",
    "max_wheel_speed": "0.5 m/s",
}
TICKS_PER_METRE = 1440 / (math.pi * 0.065)


class Bench(Struct, frozen=True):
    """An emulated Arduino in a simulated world, behind a real pseudo-terminal, on a clock that tests move."""

    clock: ManualClock
    context: DriverContext
    world: World
    board: EmulatedBoard

    def base(self, **options: Any) -> SerialBase:
        return SerialBase(RosArduinoOptions.model_validate(OPTIONS | options), self.context)

    def twist(self, linear_mps: float, angular_radps: float) -> TwistCommand:
        now_s = self.clock.now_s()
        return TwistCommand(output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=now_s)

    def drive(self, base: SerialBase, linear_mps: float, angular_radps: float, seconds: float = 1.0) -> None:
        """Command a motion as the loop does: fresh 20 times a second, with ticks in between."""
        for _ in range(round(seconds / 0.05)):
            base.apply(self.twist(linear_mps, angular_radps))
            self.pass_time(base, 0.05)

    def pass_time(self, base: SerialBase, seconds: float) -> None:
        for _ in range(round(seconds / 0.01)):
            self.clock.advance_s(0.01)
            base.tick(self.clock.now_s())

    @property
    def wheels_mps(self) -> tuple[float, float]:
        return self.world.robot.wheels_mps

    @property
    def stands(self) -> bool:
        return max(map(abs, self.wheels_mps)) < 1e-3


@pytest.fixture
def bench() -> Iterator[Bench]:
    clock = ManualClock()
    context = DriverContext(name="base", clock=clock)
    world = World(WorldOptions(track_width="16 cm", ticks_per_metre=TICKS_PER_METRE), clock)
    context.share("world", lambda: world)
    yield Bench(clock=clock, context=context, world=world, board=EmulatedRosArduinoOptions.board(context))
    for close in reversed(context.shared.closers):
        close()


@pytest.fixture
def base(bench: Bench) -> Iterator[SerialBase]:
    """A base that is open, and is closed at the end even if its link is gone."""
    opened = bench.base()
    opened.open()
    yield opened
    with contextlib.suppress(LinkLostError):
        opened.close()


def test_a_turn_to_the_left_turns_the_robot_to_the_left(bench: Bench, base: SerialBase) -> None:
    bench.drive(base, 0.0, 1.0)
    left_mps, right_mps = bench.wheels_mps
    assert left_mps < 0 < right_mps
    assert bench.world.robot.pose.heading_rad > 0.5


def test_driving_ahead_moves_the_robot_ahead(bench: Bench, base: SerialBase) -> None:
    bench.drive(base, 0.3, 0.0, seconds=2.0)
    assert bench.world.robot.pose.x_m == pytest.approx(0.3 * (2.0 - 0.15), abs=0.02)


@pytest.mark.parametrize(
    ("wiring", "wheels"),
    [
        ({"swap_sides": True}, (0.3, 0.1)),
        ({"invert_left": True}, (-0.1, 0.3)),
        ({"invert_right": True}, (0.1, -0.3)),
        ({"swap_sides": True, "invert_left": True}, (0.3, -0.1)),
        ({"swap_sides": True, "invert_right": True}, (-0.3, 0.1)),
    ],
)
def test_options_make_up_for_crossed_wires(bench: Bench, wiring: dict[str, bool], wheels: tuple[float, float]) -> None:
    base = bench.base(**wiring)
    base.open()
    bench.drive(base, 0.2, 0.2 / 0.16)
    assert bench.wheels_mps == pytest.approx(wheels, rel=0.02)
    base.close()


def test_too_fast_a_curve_is_driven_slower_along_the_same_curve(bench: Bench, base: SerialBase) -> None:
    applied = base.apply(bench.twist(2.0, 5.0))
    assert applied.linear_mps + applied.angular_radps * 0.08 == pytest.approx(0.5, abs=0.005)
    assert applied.linear_mps / applied.angular_radps == pytest.approx(2.0 / 5.0, rel=0.02)


def test_the_answer_shows_the_rounding_to_whole_ticks(bench: Bench, base: SerialBase) -> None:
    tick_mps = 1 / (TICKS_PER_METRE * 0.033)
    assert base.apply(bench.twist(3.4 * tick_mps, 0.0)).linear_mps == pytest.approx(3 * tick_mps)


def test_when_the_host_dies_the_base_stops_by_itself_after_two_seconds(bench: Bench, base: SerialBase) -> None:
    bench.drive(base, 0.3, 0.0)
    last_command_s = bench.clock.now_s() - 0.05
    bench.clock.sleep_until_s(last_command_s + 1.99)
    assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)
    bench.clock.sleep_until_s(last_command_s + 2.7)
    assert bench.stands


def test_it_reports_how_far_each_wheel_has_rolled_since_it_was_opened(bench: Bench, base: SerialBase) -> None:
    assert base.report() is None
    bench.drive(base, 0.3, 0.5)
    bench.drive(base, 0.0, 0.0)
    report = base.report()
    assert report
    rolled_m = (bench.board.firmware.left.rolled_m, bench.board.firmware.right.rolled_m)
    assert rolled_m[1] > rolled_m[0] > 0.1
    assert (report.left_m, report.right_m) == pytest.approx(rolled_m, abs=2 / TICKS_PER_METRE)
    assert bench.clock.now_s() - report.at_s < 0.25


def test_wheels_that_are_wired_otherwise_are_reported_as_they_roll(bench: Bench) -> None:
    base = bench.base(swap_sides=True, invert_left=True)
    base.open()
    bench.drive(base, 0.2, 0.2 / 0.16)  # so the left wheel rolls at 0.1 m/s, and the right one at 0.3 m/s
    bench.drive(base, 0.0, 0.0)
    report = base.report()
    assert report
    assert report.left_m == pytest.approx(0.1, abs=0.02)
    assert report.right_m == pytest.approx(0.3, abs=0.05)
    base.close()


def test_an_unplugged_base_is_a_lost_link_at_the_next_use(bench: Bench, base: SerialBase) -> None:
    bench.drive(base, 0.3, 0.0)
    bench.world.faults.base_unplugged = True
    bench.clock.advance_s(0.01)
    with pytest.raises(LinkLostError, match="unplugged"):
        base.tick(bench.clock.now_s())
    with pytest.raises(LinkLostError, match="unplugged"):
        base.apply(bench.twist(0.3, 0.0))
    with pytest.raises(LinkLostError, match="unplugged"):
        base.stop()


def test_closing_an_unplugged_base_says_that_it_was_not_stopped_and_releases_it(bench: Bench, base: SerialBase) -> None:
    bench.world.faults.base_unplugged = True
    bench.clock.advance_s(0.01)
    with pytest.raises(LinkLostError):
        base.close()
    base.close()
    with pytest.raises(DeviceClosedError):
        base.apply(bench.twist(0.0, 0.0))


def test_a_base_that_is_plugged_in_again_can_be_opened_again(bench: Bench, base: SerialBase) -> None:
    bench.world.faults.base_unplugged = True
    bench.clock.advance_s(0.01)
    with pytest.raises(LinkLostError):
        base.close()
    with pytest.raises(DeviceOpenError, match="there is no serial port"):
        base.open()
    bench.clock.advance_s(2.0)
    bench.world.faults.base_unplugged = False
    bench.clock.advance_s(0.01)
    base.open()
    bench.drive(base, 0.3, 0.0)
    assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)


def test_a_silent_base_is_a_lost_link_after_half_a_second_of_commands(bench: Bench, base: SerialBase) -> None:
    bench.board.firmware.silent = True
    bench.drive(base, 0.3, 0.0, seconds=0.45)
    with pytest.raises(LinkLostError, match="acknowledged nothing"):
        bench.drive(base, 0.3, 0.0, seconds=0.1)


def test_a_base_that_nothing_is_asked_of_may_be_silent(bench: Bench, base: SerialBase) -> None:
    bench.pass_time(base, 0.5)
    bench.board.firmware.silent = True
    bench.pass_time(base, 5.0)


def test_a_base_that_answers_again_can_be_driven_again(bench: Bench, base: SerialBase) -> None:
    bench.board.firmware.silent = True
    base.stop()
    with pytest.raises(LinkLostError):
        bench.pass_time(base, 1.0)
    bench.board.firmware.silent = False
    for _ in range(20):  # the ticks go on, whatever they report, and repeat the stop
        bench.clock.advance_s(0.01)
        with contextlib.suppress(LinkLostError):
            base.tick(bench.clock.now_s())
    bench.drive(base, 0.3, 0.0)
    assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)


def test_a_stop_that_the_link_lost_is_repeated_until_it_is_acknowledged(bench: Bench, base: SerialBase) -> None:
    bench.drive(base, 0.3, 0.0)
    bench.board.firmware.silent = True
    base.stop()
    bench.pass_time(base, 0.05)
    bench.board.firmware.silent = False
    assert not bench.stands
    bench.pass_time(base, 1.0)
    assert bench.stands


def test_an_acknowledged_stop_is_not_repeated(bench: Bench, base: SerialBase) -> None:
    bench.drive(base, 0.3, 0.0)
    base.stop()
    bench.pass_time(base, 0.1)
    bench.board.firmware.silent = True  # repeats would go unanswered now, and be a lost link
    bench.pass_time(base, 2.0)


def test_a_lost_command_before_a_stop_does_not_leave_the_stop_unacknowledged(bench: Bench, base: SerialBase) -> None:
    bench.drive(base, 0.3, 0.0)
    bench.board.firmware.silent = True
    bench.drive(base, 0.3, 0.0, seconds=0.2)
    bench.board.firmware.silent = False
    base.stop()
    bench.pass_time(base, 1.0)
    bench.board.firmware.silent = True  # a stop that is still repeated would be a lost link
    bench.pass_time(base, 2.0)
    assert bench.stands


def test_a_refused_command_is_an_error_that_names_the_switch_of_the_sketch(bench: Bench, base: SerialBase) -> None:
    bench.board.firmware.use_base_off = True
    with pytest.raises(ProtocolError, match="USE_BASE"):
        bench.drive(base, 0.3, 0.0)


def test_a_sketch_without_motors_is_refused_when_opening(bench: Bench) -> None:
    bench.board.firmware.use_base_off = True
    base = bench.base()
    with pytest.raises(ProtocolError, match="USE_BASE"):
        base.open()
    with pytest.raises(DeviceClosedError):
        base.tick(bench.clock.now_s())


def test_noise_on_the_line_hides_no_answers(bench: Bench, base: SerialBase) -> None:
    for _ in range(40):
        bench.board.port.say(b"\x00~\xfe")
        bench.drive(base, 0.3, 0.0, seconds=0.05)
    assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)


def test_a_board_that_boots_after_opening_is_waited_for(bench: Bench) -> None:
    bench.board.firmware.reset(boot_s=1.7)
    base = bench.base()
    base.open()
    assert bench.clock.now_s() >= 1.7
    bench.drive(base, 0.3, 0.0)
    assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)
    base.close()


def test_a_port_where_nothing_answers_cannot_be_opened_and_is_released(bench: Bench) -> None:
    bench.board.firmware.silent = True
    base = bench.base(boot_wait="3 s")
    with pytest.raises(DeviceOpenError, match="nothing answers in 3 s") as refusal:
        base.open()
    assert 3.0 <= bench.clock.now_s() < 3.5
    assert refusal.tb  # what it refers to lives on, so that only a close can have released the port
    link = SerialLink(bench.board.port.path, 57600)
    link.open()
    link.close()


def test_a_port_that_another_base_holds_cannot_be_opened(bench: Bench, base: SerialBase) -> None:
    with pytest.raises(DeviceOpenError, match="already open"):
        bench.base().open()
    bench.drive(base, 0.1, 0.0, seconds=0.1)


def test_an_absent_port_cannot_be_opened(bench: Bench, tmp_path: Path) -> None:
    with pytest.raises(DeviceOpenError, match="there is no serial port"):
        bench.base(port=str(tmp_path / "ttyUSB0")).open()


def test_a_base_unplugged_while_it_is_greeted_cannot_be_opened(bench: Bench) -> None:
    bench.board.firmware.silent = True

    def pull_the_cable(now_s: float) -> None:
        bench.world.faults.base_unplugged = True

    bench.clock.call_every(1.0, pull_the_cable)
    with pytest.raises(DeviceOpenError, match="vanished"):
        bench.base().open()


def flood(bench: Bench, base: SerialBase) -> None:
    def command() -> None:
        while True:  # time stands still, so nobody reads at the other end
            base.apply(bench.twist(0.3, 0.0))

    with pytest.raises(LinkLostError, match="50 ms"):
        command()


def fill(path: str) -> None:
    """Fill the port up with what the firmware passes over."""
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    refusals = 0
    while refusals < 10:  # the kernel moves bytes on between its own buffers, and then has room once more
        try:
            os.write(descriptor, b"\n")
            refusals = 0
        except BlockingIOError:
            refusals += 1
            time.sleep(0.01)
    os.close(descriptor)


def test_a_stop_behind_half_a_frame_is_not_read_as_part_of_it(bench: Bench, base: SerialBase) -> None:
    flood(bench, base)
    bench.clock.advance_s(0.5)
    bench.board.firmware.receive(b"m 50", bench.clock.now_s())  # what the port took of the last frame
    base.stop()
    bench.pass_time(base, 0.05)  # sooner than a stop is repeated
    assert bench.board.firmware.left.driven_mps == 0.0
    bench.pass_time(base, 1.0)
    bench.drive(base, 0.3, 0.0)
    assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)


def test_a_stop_comes_before_the_commands_that_a_full_port_still_held(bench: Bench, base: SerialBase) -> None:
    bench.drive(base, 0.3, 0.0)
    flood(bench, base)
    base.stop()
    bench.pass_time(base, 0.05)  # sooner than a stop is repeated
    assert bench.board.firmware.left.driven_mps == 0.0


def test_a_stop_that_the_port_did_not_take_is_tried_again(bench: Bench, base: SerialBase) -> None:
    bench.drive(base, 0.3, 0.0)
    fill(bench.board.port.path)
    with pytest.raises(LinkLostError):
        base.stop()
    bench.clock.advance_s(0.2)
    bench.pass_time(base, 1.0)
    assert bench.stands


@each_case(
    ("wrong", "says"),
    [
        ({"max_wheel_speed": "0 m/s"}, "max_wheel_speed is 0"),
        ({"ticks_per_turn": 4}, "the firmware takes 1 to 32767"),
        ({"ticks_per_turn": 10_000_000}, "the firmware takes 1 to 32767"),
        ({"ticks_per_turn": 0}, "greater than 0"),
        ({"wheel_diameter": "65"}, "no unit"),
        ({"track_width": "0 cm"}, "above zero"),
        ({"baud": -1}, "greater than 0"),
        ({"speed": "1 m/s"}, "Extra inputs"),
    ],
)
def test_options_that_make_no_robot_are_errors(wrong: dict[str, Any], says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        RosArduinoOptions.model_validate(OPTIONS | wrong)


@pytest.mark.long
def test_on_a_real_clock_with_the_board_in_a_thread_the_wheels_turn_and_stop() -> None:
    clock = MonotonicClock()
    context = DriverContext(name="base", clock=clock)
    world = World(WorldOptions(track_width="16 cm", ticks_per_metre=TICKS_PER_METRE), clock)
    context.share("world", lambda: world)
    base = SerialBase(RosArduinoOptions.model_validate(OPTIONS), context)
    base.open()
    while world.robot.wheels_mps[0] < 0.25:
        now_s = clock.now_s()
        base.apply(TwistCommand(output="base", linear_mps=0.3, angular_radps=0.0, captured_at_s=now_s))
        clock.sleep_until_s(now_s + 0.05)
        base.tick(clock.now_s())
    base.close()
    while world.robot.wheels_mps[0] > 1e-3:
        time.sleep(0.01)
    for close in reversed(context.shared.closers):
        close()
