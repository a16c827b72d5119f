from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.bases import ros_arduino_codec as codec
from stadimeter.bases.ros_arduino_codec import Acknowledged, BaudRate, EncoderCounts, Garbage, Refused, ReplyParser
from stadimeter.errors import CommandRangeError

VECTORS: dict[str, dict[str, Any]] = {
    vector["name"]: vector
    for vector in json.loads(Path(__file__).with_name("ros_arduino_vectors.json").read_text("utf-8"))["vectors"]
}


def wire(name: str) -> bytes:
    return bytes.fromhex(VECTORS[name]["bytes_hex"])


@pytest.mark.parametrize(
    ("name", "encoded"),
    [
        ("closed_loop_10_10", codec.encode_drive(10, 10)),
        ("stop", codec.STOP),
        ("stop", codec.encode_drive(0, 0)),
        ("read_encoders", codec.ASK_ENCODERS),
        ("reset_encoders", codec.RESET_ENCODERS),
        ("baud", codec.ASK_BAUD_RATE),
    ],
)
def test_a_command_is_these_bytes_exactly(name: str, encoded: bytes) -> None:
    assert encoded == wire(name)


@pytest.mark.parametrize(
    ("name", "reply"),
    [
        ("ok", Acknowledged()),
        ("encoders_0_0", EncoderCounts(left=0, right=0)),
        ("baud_57600", BaudRate(baud=57600)),
        ("invalid_command", Refused()),
    ],
)
def test_a_reply_of_these_bytes_means_this(name: str, reply: codec.Reply) -> None:
    assert ReplyParser().feed(wire(name)) == [reply]


@given(st.integers(-32767, 32767), st.integers(-32767, 32767))
def test_a_drive_command_ends_with_one_carriage_return_and_overruns_no_argument(left: int, right: int) -> None:
    frame = codec.encode_drive(left, right)
    assert frame.endswith(b"\r")
    assert frame.count(b"\r") == 1
    assert b"\n" not in frame
    assert all(len(argument) < 16 for argument in frame.split(b" "))


@pytest.mark.parametrize("ticks", [(32768, 0), (0, -32768)])
def test_ticks_that_do_not_fit_the_firmware_are_an_error(ticks: tuple[int, int]) -> None:
    with pytest.raises(CommandRangeError, match="32767"):
        codec.encode_drive(*ticks)


def test_encoder_counts_may_be_negative() -> None:
    assert ReplyParser().feed(b"-12 34567\r\n") == [EncoderCounts(left=-12, right=34567)]


def test_the_fork_that_puts_a_space_before_its_baud_rate_is_understood() -> None:
    assert ReplyParser().feed(b" 57600\r\n") == [BaudRate(baud=57600)]


def test_replies_back_to_back_come_in_order() -> None:
    replies = ReplyParser().feed(b"OK\r\n1 2\r\nInvalid Command\r\n57600\r\nOK")
    assert replies == [Acknowledged(), EncoderCounts(left=1, right=2), Refused(), BaudRate(baud=57600)]


def test_a_reply_counts_only_when_its_line_has_ended() -> None:
    parser = ReplyParser()
    assert parser.feed(b"OK") == []
    assert parser.feed(b"\r") == [Acknowledged()]
    assert parser.feed(b"\n") == []


def test_a_number_behind_noise_is_not_trusted_because_digits_may_be_missing() -> None:
    parser = ReplyParser()
    assert parser.feed(b"\xff2 34\r\n") == [Garbage(size=5, text="2 34")]
    assert parser.dropped_bytes == 5


def test_a_line_that_means_nothing_is_garbage_and_the_next_is_understood() -> None:
    parser = ReplyParser()
    assert parser.feed(b"NOT OK\r\nOK\r\n") == [Garbage(size=6, text="NOT OK"), Acknowledged()]


@pytest.mark.parametrize("size", [63, 64, 65, 66, 1000])
def test_a_flood_without_an_end_is_dropped_and_counted(size: int) -> None:
    parser = ReplyParser()
    garbage, reply = parser.feed(b"x" * size + b"\r\nOK\r\n")
    assert isinstance(garbage, Garbage)
    assert garbage.size == size
    assert len(garbage.text) <= 64
    assert reply == Acknowledged()
    assert parser.dropped_bytes == size


line = st.sampled_from([b"OK\r\n", b"Invalid Command\r\n", b"57600\r\n", b"-5 17\r\n", b"hello\r\n", b"\r\n", b"\n"])
noise = st.binary(max_size=100)
streams = st.lists(line | noise, max_size=12).map(b"".join)


@given(streams, st.data())
def test_the_same_bytes_give_the_same_replies_however_they_are_split(stream: bytes, data: st.DataObject) -> None:
    whole, pieces = ReplyParser(), ReplyParser()
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    bounds = zip([0, *cuts], [*cuts, len(stream)], strict=True)
    assert [r for a, b in bounds for r in pieces.feed(stream[a:b])] == whole.feed(stream)
    assert pieces.dropped_bytes == whole.dropped_bytes


@given(st.binary(max_size=200).filter(lambda data: b"\r" not in data and b"\n" not in data))
def test_leading_noise_is_dropped_and_counted_and_hides_no_acknowledgement(data: bytes) -> None:
    stream = data + b"\x00"
    parser = ReplyParser()
    assert parser.feed(stream + b"OK\r\n") == [Garbage(size=len(stream)), Acknowledged()]
    assert parser.dropped_bytes == len(stream)


def test_dropped_bytes_add_up_over_lines() -> None:
    parser = ReplyParser()
    parser.feed(b"NOT OK\r\nhello\r\n")
    assert parser.dropped_bytes == 11


def test_of_a_line_that_is_too_long_the_end_is_kept() -> None:
    text = bytes(33 + number % 90 for number in range(100))
    (garbage,) = ReplyParser().feed(text + b"\r")
    assert isinstance(garbage, Garbage)
    assert (garbage.size, garbage.text) == (100, text[-64:].decode())


def test_a_delete_character_is_noise() -> None:
    assert ReplyParser().feed(b"1\x7f2 34\r") == [Garbage(size=6, text="2 34")]
