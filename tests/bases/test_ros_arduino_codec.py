"""What is special about the protocol of ros_arduino_bridge; its vectors are tried in `test_codecs.py`."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.bases.differential_drive import WheelSpeeds
from stadimeter.bases.ros_arduino_base import FRAME_S, RosArduinoCodec
from stadimeter.bases.serial_codec import BaseMessage
from stadimeter.errors import CommandRangeError

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


def test_a_delete_character_is_noise(codec: RosArduinoCodec) -> None:
    assert codec.feed(b"1\x7f234\r") == []
