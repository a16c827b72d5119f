from __future__ import annotations

import pytest

from stadimeter.config.plugins import DriverContext
from stadimeter.errors import ConfigError
from stadimeter.simulation.firmware import EmulatedRosArduinoOptions, RosArduinoFirmware
from stadimeter.testing.rig import ManualClock
from support.base_vectors import vectors, wire

ROS = "ros_arduino_bridge"


@pytest.fixture
def board() -> RosArduinoFirmware:
    return RosArduinoFirmware(ticks_per_metre=1.0)


def speeds(board: RosArduinoFirmware, now_s: float) -> tuple[float, float]:
    board.step(now_s)
    return (board.left.speed_mps, board.right.speed_mps)


@pytest.mark.parametrize(
    ("sent", "answer"),
    [
        (b"m 10 10\r", b"OK\r\n"),
        (b"m 0 0\r", b"OK\r\n"),
        (b"e\r", b"0 0\r\n"),
        (b"r\r", b"OK\r\n"),
        (b"b\r", b"57600\r\n"),
        (b"z\r", b"Invalid Command\r\n"),
        (b"\r", b"Invalid Command\r\n"),
        (b"b\r\nb\r\n", b"57600\r\n57600\r\n"),
    ],
)
def test_it_answers_as_the_sketch_does(board: RosArduinoFirmware, sent: bytes, answer: bytes) -> None:
    assert board.receive(sent, 0.0) == answer


@pytest.mark.parametrize("reply", vectors(ROS, "rx").values(), ids=lambda reply: reply["name"])
def test_it_answers_the_vectors_byte_by_byte(board: RosArduinoFirmware, reply: dict[str, str]) -> None:
    assert board.receive(wire(ROS, reply["reply_to"]), 0.0) == bytes.fromhex(reply["bytes_hex"])


def test_line_feeds_instead_of_carriage_returns_hang_the_board(board: RosArduinoFirmware) -> None:
    assert board.receive(b"m 10 10\n" * 5, 0.0) == b""
    assert board.hung
    assert board.receive(b"\rb\r", 0.1) == b""


def test_wheels_take_time_to_follow(board: RosArduinoFirmware) -> None:
    board.receive(b"m 10 20\r", 0.0)
    assert speeds(board, 0.0) == (0.0, 0.0)
    early, late = speeds(board, 0.133), speeds(board, 1.0)
    assert early[0] == pytest.approx(10 / 0.033 * 0.632, rel=0.01)  # one time constant after the first frame
    assert late == (pytest.approx(10 / 0.033, rel=1e-3), pytest.approx(20 / 0.033, rel=1e-3))


def test_how_often_it_is_stepped_changes_nothing() -> None:
    seldom, often = RosArduinoFirmware(ticks_per_metre=1.0), RosArduinoFirmware(ticks_per_metre=1.0)
    for board in (seldom, often):
        board.receive(b"m 10 20\r", 0.0)
    for millisecond in range(1, 3001):
        often.step(millisecond / 1000)
    seldom.step(3.0)
    assert often.left.rolled_m == pytest.approx(seldom.left.rolled_m, rel=1e-6)
    assert often.right.rolled_m == pytest.approx(seldom.right.rolled_m, rel=1e-6)


def test_it_stops_by_itself_two_seconds_after_the_last_motor_command(board: RosArduinoFirmware) -> None:
    board.receive(b"m 10 10\r", 0.0)
    board.receive(b"m 10 10\r", 1.5)
    assert speeds(board, 3.49)[0] == pytest.approx(10 / 0.033, rel=1e-3)
    assert speeds(board, 3.6)[0] == pytest.approx(10 / 0.033 * 0.37, rel=0.01)
    assert speeds(board, 6.0) == (0.0, 0.0)


def test_questions_do_not_keep_it_moving(board: RosArduinoFirmware) -> None:
    board.receive(b"m 10 10\r", 0.0)
    for tenth in range(1, 60):
        board.receive(b"b\re\r", tenth / 10)
    assert speeds(board, 6.0) == (0.0, 0.0)


def test_without_a_world_it_says_that_it_needs_one() -> None:
    with pytest.raises(ConfigError, match=r"\[world\]"):
        EmulatedRosArduinoOptions.board(DriverContext(name="base", clock=ManualClock()))
