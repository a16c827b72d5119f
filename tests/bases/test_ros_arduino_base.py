from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Iterator
from typing import Any

import pytest
from pydantic import ValidationError

from stadimeter.app.clock import MonotonicClock
from stadimeter.bases.differential_drive import WheelSpeeds
from stadimeter.bases.ros_arduino_base import RosArduinoOptions
from stadimeter.bases.serial_base import SerialBase
from stadimeter.config.plugins import DriverContext
from stadimeter.core.command import TwistCommand
from stadimeter.errors import DeviceClosedError, DeviceOpenError, LinkLostError, ProtocolError
from stadimeter.simulation.world import World, WorldOptions
from support.base_bench import BaseBench, base_bench, opened
from support.each_case import each_case

OPTIONS = {
    "wheel_diameter": "65 mm",
    "ticks_per_turn": 1440,
    "track_width": "16 cm",
    "max_wheel_speed": "0.5 m/s",
}


@pytest.fixture
def bench() -> Iterator[BaseBench]:
    with base_bench("ros-arduino-bridge") as bench:
        yield bench


@pytest.fixture
def base(bench: BaseBench) -> Iterator[SerialBase]:
    with opened(bench, **OPTIONS) as base:
        yield base


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
def test_options_make_up_for_crossed_wires(
    bench: BaseBench, wiring: dict[str, bool], wheels: tuple[float, float]
) -> None:
    base = bench.base(**OPTIONS, **wiring)
    base.open()
    bench.drive(base, 0.2, 0.2 / 0.16)
    assert bench.wheels_mps == pytest.approx(wheels, rel=0.02)
    base.close()


def test_when_the_host_dies_the_base_stops_by_itself_after_two_seconds(bench: BaseBench, base: SerialBase) -> None:
    bench.drive(base, 0.3)
    last_command_s = bench.clock.now_s() - 0.05
    bench.clock.sleep_until_s(last_command_s + 1.99)
    assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)
    bench.clock.sleep_until_s(last_command_s + 2.7)
    assert bench.stands


def test_wheels_that_are_wired_otherwise_are_reported_as_they_roll(bench: BaseBench) -> None:
    base = bench.base(**OPTIONS, swap_sides=True, invert_left=True)
    base.open()
    bench.drive(base, 0.2, 0.2 / 0.16)  # so the left wheel rolls at 0.1 m/s, and the right one at 0.3 m/s
    bench.drive(base, 0.0, 0.0)
    report = base.report()
    assert report
    assert report.left_m == pytest.approx(0.1, abs=0.02)
    assert report.right_m == pytest.approx(0.3, abs=0.05)
    base.close()


def test_closing_an_unplugged_base_says_that_it_was_not_stopped_and_releases_it(
    bench: BaseBench, base: SerialBase
) -> None:
    bench.world.faults.base_unplugged = True
    bench.clock.advance_s(0.01)
    with pytest.raises(LinkLostError):
        base.close()
    base.close()
    with pytest.raises(DeviceClosedError):
        bench.command(base, 0.0)


def test_a_base_that_nothing_is_asked_of_may_be_silent(bench: BaseBench, base: SerialBase) -> None:
    bench.pass_time(base, 0.5)
    bench.firmware.silent = True
    bench.pass_time(base, 5.0)


def test_a_base_that_answers_again_can_be_driven_again(bench: BaseBench, base: SerialBase) -> None:
    bench.firmware.silent = True
    base.stop()
    with pytest.raises(LinkLostError):
        bench.pass_time(base, 1.0)
    bench.firmware.silent = False
    for _ in range(60):  # the ticks go on, whatever they report, and repeat the stop
        bench.clock.advance_s(0.01)
        with contextlib.suppress(LinkLostError):
            base.tick(bench.clock.now_s())
    bench.drive(base, 0.3)
    assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)


def test_an_acknowledged_stop_is_not_repeated(bench: BaseBench, base: SerialBase) -> None:
    bench.drive(base, 0.3)
    base.stop()
    bench.pass_time(base, 0.1)
    bench.firmware.silent = True  # repeats would go unanswered now, and be a lost link
    bench.pass_time(base, 2.0)


def test_a_lost_command_before_a_stop_does_not_leave_the_stop_unacknowledged(
    bench: BaseBench, base: SerialBase
) -> None:
    bench.drive(base, 0.3)
    bench.firmware.silent = True
    bench.drive(base, 0.3, seconds=0.2)
    bench.firmware.silent = False
    base.stop()
    bench.pass_time(base, 1.0)
    bench.firmware.silent = True  # a stop that is still repeated would be a lost link
    bench.pass_time(base, 2.0)
    assert bench.stands


def test_a_refused_command_is_an_error_that_names_the_switch_of_the_sketch(bench: BaseBench, base: SerialBase) -> None:
    bench.firmware.use_base_off = True
    with pytest.raises(ProtocolError, match="USE_BASE"):
        bench.drive(base, 0.3)


def test_a_base_unplugged_while_it_is_greeted_cannot_be_opened(bench: BaseBench) -> None:
    bench.firmware.silent = True

    def pull_the_cable(now_s: float) -> None:
        bench.world.faults.base_unplugged = True

    bench.clock.call_every(1.0, pull_the_cable)
    with pytest.raises(DeviceOpenError, match="vanished"):
        bench.base(**OPTIONS).open()


def flood(bench: BaseBench, base: SerialBase) -> None:
    """Command until the port is full, as if each command had been answered."""

    def command() -> None:
        while True:  # time stands still, so nobody reads at the other end
            base._send(base._link, b"m 10 10\r", bench.clock.now_s(), WheelSpeeds(left_mps=0.3, right_mps=0.3))

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


def test_a_stop_behind_half_a_frame_is_not_read_as_part_of_it(bench: BaseBench, base: SerialBase) -> None:
    flood(bench, base)
    bench.clock.advance_s(0.5)
    bench.firmware.receive(b"m 50", bench.clock.now_s())  # what the port took of the last frame
    base.stop()
    bench.pass_time(base, 0.05)  # sooner than a stop is repeated
    assert bench.firmware.left.driven_mps == 0.0
    bench.pass_time(base, 1.0)
    bench.drive(base, 0.3)
    assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)


def test_a_stop_comes_before_the_commands_that_a_full_port_still_held(bench: BaseBench, base: SerialBase) -> None:
    bench.drive(base, 0.3)
    flood(bench, base)
    base.stop()
    bench.pass_time(base, 0.05)  # sooner than a stop is repeated
    assert bench.firmware.left.driven_mps == 0.0


def test_a_stop_that_the_port_did_not_take_is_tried_again(bench: BaseBench, base: SerialBase) -> None:
    bench.drive(base, 0.3)
    fill(bench.board.port.path)
    with pytest.raises(LinkLostError):
        base.stop()
    bench.clock.advance_s(0.2)
    bench.pass_time(base, 1.0)
    assert bench.stands


@each_case(
    ("wrong", "says"),
    [
        ({"ticks_per_turn": 4}, "the firmware takes 1 to 32767"),
        ({"ticks_per_turn": 10_000_000}, "the firmware takes 1 to 32767"),
        ({"ticks_per_turn": 0}, "greater than 0"),
        ({"wheel_diameter": "65"}, "no unit"),
    ],
)
def test_options_that_make_no_robot_are_errors(wrong: dict[str, Any], says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        RosArduinoOptions.model_validate({"port": "emulated-ros-arduino-bridge"} | OPTIONS | wrong)


@pytest.mark.long
def test_on_a_real_clock_with_the_board_in_a_thread_the_wheels_turn_and_stop() -> None:
    clock = MonotonicClock()
    context = DriverContext(name="base", clock=clock)
    world = World(WorldOptions(track_width="16 cm", ticks_per_metre=1440 / (math.pi * 0.065)), clock)
    context.share("world", lambda: world)
    base = RosArduinoOptions.model_validate({"port": "emulated-ros-arduino-bridge"} | OPTIONS).build(context)
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
