"""A base with ros_arduino_bridge: its protocol, its greeting, and how it stops."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Struct
from pydantic import ValidationError

from stadimeter.bases.protocol import WheelSpeeds
from stadimeter.bases.ros_arduino_base import FRAME_S, RosArduinoCodec, RosArduinoOptions
from stadimeter.bases.serial_base import BaseMessage, Greeting, SerialBase, SerialLink
from stadimeter.errors import CommandRangeError, DeviceOpenError, LinkLostError, ProtocolError
from stadimeter.simulation.emulated_base import EmulatedPort
from stadimeter.simulation.firmware import RosArduinoFirmware
from stadimeter.testing.rig import ManualClock
from support.base_bench import BaseBench, base_bench, opened
from support.each_case import each_case

OPTIONS = {"wheel_diameter": "65 mm", "ticks_per_turn": 1440, "track_width": "16 cm", "max_wheel_speed": "0.5 m/s"}


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


# What is special about the protocol of ros_arduino_bridge; its vectors are tried in `test_codecs.py`.

DONE, IDENTITY = BaseMessage(was_done=True), BaseMessage(is_identity=True)


@pytest.fixture
def codec() -> RosArduinoCodec:
    """One tick per frame is 1 m/s."""
    return RosArduinoCodec(1 / FRAME_S)


@given(st.integers(-32767, 32767), st.integers(-32767, 32767))
def test_a_drive_command_ends_with_one_carriage_return_and_overruns_no_argument(left: int, right: int) -> None:
    frame = RosArduinoCodec(1 / FRAME_S).encode(WheelSpeeds(left_mps=left, right_mps=right)).frame
    assert frame.endswith(b"\r")
    assert frame.count(b"\r") == 1
    assert b"\n" not in frame
    assert all(len(argument) < 16 for argument in frame.split(b" "))


@pytest.mark.parametrize("ticks", [(32768, 0), (0, -32768)])
def test_ticks_that_do_not_fit_the_firmware_are_an_error(codec: RosArduinoCodec, ticks: tuple[int, int]) -> None:
    with pytest.raises(CommandRangeError, match="32767"):
        codec.encode(WheelSpeeds(left_mps=ticks[0], right_mps=ticks[1]))


@given(st.floats(-9, 9), st.floats(-9, 9))
def test_what_is_sent_is_whole_ticks_at_most_half_a_tick_away(left_mps: float, right_mps: float) -> None:
    codec = RosArduinoCodec(7000.0)
    command = codec.encode(WheelSpeeds(left_mps=left_mps, right_mps=right_mps))
    letter, left, right = command.frame.split()
    assert letter == b"m"
    assert (command.sent.left_mps, command.sent.right_mps) == (
        int(left) * codec.steps.step_mps,
        int(right) * codec.steps.step_mps,
    )
    assert command.sent.left_mps == pytest.approx(left_mps, abs=codec.steps.step_mps * 0.500001)


def test_a_limit_of_exactly_n_ticks_allows_n_ticks() -> None:
    codec = RosArduinoCodec(7000.0)
    limits_mps = [ticks * codec.steps.step_mps for ticks in range(1, 200)]
    assert [codec.steps.limit_mps(each) for each in limits_mps] == pytest.approx(limits_mps, rel=1e-12)


def test_the_fork_that_puts_a_space_before_its_baud_rate_is_understood(codec: RosArduinoCodec) -> None:
    assert codec.feed(b" 57600\r\n") == [IDENTITY]


@pytest.mark.parametrize("number", [b"57600", b"250 -1000"])
def test_a_number_behind_noise_is_not_trusted_because_digits_may_be_missing(
    codec: RosArduinoCodec, number: bytes
) -> None:
    assert codec.feed(b"\xff" + number + b"\r\n") == []
    assert codec.dropped_bytes == 1 + len(number)


@pytest.mark.parametrize("size", [63, 64, 65, 66, 1000])
def test_a_flood_without_an_end_is_dropped_and_counted(codec: RosArduinoCodec, size: int) -> None:
    assert codec.feed(b"x" * size + b"\r\nOK\r\n") == [DONE]
    assert codec.dropped_bytes == size


class SlowBoard(RosArduinoFirmware):
    """A board whose answers take 0.3 s, as through a slow adapter."""

    def __init__(self) -> None:
        super().__init__()
        self._answers: list[tuple[float, bytes]] = []

    def receive(self, data: bytes, now_s: float) -> bytes:
        self._answers.append((now_s + 0.3, super().receive(data, now_s)))
        ready = [answer for due_s, answer in self._answers if due_s <= now_s]
        del self._answers[: len(ready)]
        return b"".join(ready)


class Bench(Struct, frozen=True):
    """A board on a port that is open, about to be greeted."""

    clock: ManualClock
    port: EmulatedPort
    link: SerialLink

    def run(self, boot_wait_s: float = 4.0) -> None:
        Greeting(link=self.link, clock=self.clock, codec=RosArduinoCodec(4000.0), boot_wait_s=boot_wait_s).run()

    def repeat(self, data: bytes, every_s: float) -> None:
        """Let the board's end say something again and again, unasked."""

        def say(now_s: float) -> None:
            self.port.say(data)

        self.clock.call_every(every_s, say)


@pytest.fixture
def greet() -> Iterator[Callable[[RosArduinoFirmware], Bench]]:
    with contextlib.ExitStack() as at_end:

        def connect(board: RosArduinoFirmware) -> Bench:
            clock = ManualClock()
            port = EmulatedPort(board, clock)
            at_end.callback(port.close)
            link = SerialLink(port.path, 57600)
            link.open()
            at_end.callback(link.close)
            return Bench(clock=clock, port=port, link=link)

        yield connect


Greet = Callable[[RosArduinoFirmware], Bench]


@pytest.mark.parametrize("left_behind", [b"m 50 50\r", b"m 50 50"], ids=["driving", "half a command"])
def test_what_another_program_left_behind_is_stopped_at_once(greet: Greet, left_behind: bytes) -> None:
    board = SlowBoard()
    board.receive(left_behind, 0.0)
    greeting = greet(board)
    greeting.clock.advance_s(1.0)
    driven_mps: list[float] = []
    greeting.clock.call_every(0.01, lambda _now_s: driven_mps.append(board.left.driven_mps))
    greeting.run()
    assert set(driven_mps[2:]) == {0.0}


def test_the_encoders_are_set_to_zero(greet: Greet) -> None:
    board = RosArduinoFirmware()
    greeting = greet(board)
    for command in (b"m 50 50\r", b"m 0 0\r"):
        board.receive(command, greeting.clock.now_s())
        greeting.clock.advance_s(1.9)
    assert int(board.receive(b"e\r", greeting.clock.now_s()).split()[0]) > 1000
    greeting.run()
    assert board.receive(b"e\r", greeting.clock.now_s()) == b"0 0\r\n"


def test_a_board_that_still_boots_is_asked_until_it_answers(greet: Greet) -> None:
    board = RosArduinoFirmware()
    board.reset(boot_s=1.7)
    greeting = greet(board)
    greeting.run()
    assert greeting.clock.now_s() >= 1.7


def test_what_a_boot_loader_says_does_not_hide_the_answer(greet: Greet) -> None:
    greeting = greet(RosArduinoFirmware())
    greeting.port.say(b"\x00\xffbootloader 4.4\r\n\xfe57")
    greeting.run()


def test_late_answers_do_not_pass_for_answers_to_later_commands(greet: Greet) -> None:
    greeting = greet(SlowBoard())
    greeting.run()
    greeting.clock.advance_s(2.0)
    assert greeting.link.read() == b""


def test_silence_is_an_error_after_the_time_to_boot(greet: Greet) -> None:
    board = RosArduinoFirmware()
    board.silent = True
    greeting = greet(board)
    with pytest.raises(DeviceOpenError, match="nothing answers in 3 s"):
        greeting.run(boot_wait_s=3.0)
    assert 3.0 <= greeting.clock.now_s() < 3.5
