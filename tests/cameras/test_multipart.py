from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stadimeter.cameras.mjpeg_stream import HEAD_MAX_BYTES, PART_MAX_BYTES, Multipart, StreamPart
from stadimeter.errors import LinkLostError
from support.each_case import each_case

JPEGS = tuple(
    cv2.imencode(".jpg", np.random.default_rng(seed).integers(0, 256, (40, 56, 3), dtype=np.uint8))[1].tobytes()
    for seed in range(3)
)


def stream(*, line_end: bytes = b"\r\n", has_length: bool = True, delimiter: bytes = b"--frame") -> bytes:
    parts = []
    for number, jpeg in enumerate(JPEGS):
        head = [delimiter, b"Content-Type: image/jpeg", b"X-Timestamp: %d.250000" % (1700 + number)]
        head += [b"Content-Length: %d" % len(jpeg)] if has_length else []
        parts.append(line_end.join([*head, b"", jpeg]))
    return line_end.join([b"", *parts, delimiter + b"--", b""])


def parts_of(boundary: str, data: bytes, size: int = 1 << 16) -> list[StreamPart]:
    parser = Multipart(boundary)
    found = []
    for at in range(0, len(data), size):
        parser.feed(data[at : at + size])
        while (part := parser.next_part()) is not None:
            found.append(part)
    return found


@each_case("has_length", [True, False])
@each_case("line_end", [b"\r\n", b"\n"])
@each_case(
    ("boundary", "delimiter"),
    [("frame", b"--frame"), ("--frame", b"--frame"), ("frame", b"frame"), ("", b"--anything"), ("f(x)+", b"--f(x)+")],
)
def test_senders_may_write_a_stream_in_their_own_ways(
    boundary: str, delimiter: bytes, line_end: bytes, has_length: bool
) -> None:
    data = stream(line_end=line_end, has_length=has_length, delimiter=delimiter)
    found = parts_of(boundary, data)
    assert [part.body.rstrip(b"\r\n") for part in found] == list(JPEGS)
    assert [part.stamp_s for part in found] == [1700.25, 1701.25, 1702.25]


@given(size=st.integers(1, 400), has_length=st.booleans())
@settings(max_examples=25, deadline=None)
def test_it_does_not_matter_in_which_pieces_the_bytes_come(size: int, has_length: bool) -> None:
    found = parts_of("frame", stream(has_length=has_length), size)
    assert [part.body.rstrip(b"\r\n") for part in found] == list(JPEGS)


@pytest.mark.parametrize("has_length", [True, False])
def test_a_picture_is_there_before_the_next_one_begins(has_length: bool) -> None:
    data = stream(has_length=has_length)
    parser = Multipart("frame")
    parser.feed(data[: data.index(JPEGS[0]) + len(JPEGS[0])])
    part = parser.next_part()
    assert part is not None
    assert part.body == JPEGS[0]


def test_a_part_that_was_cut_short_swallows_no_part_after_it() -> None:
    data = stream().replace(JPEGS[1], JPEGS[1][:300])
    first, cut, last = parts_of("frame", data)
    assert (first.body, last.body) == (JPEGS[0], JPEGS[2])
    assert len(cut.body) <= 302


def test_a_part_without_a_time_stamp_has_none() -> None:
    (part,) = parts_of("frame", b"\r\n--frame\r\nContent-Length: 3\r\nX-Timestamp: soon\r\n\r\nabc")
    assert part.body == b"abc"
    assert math.isnan(part.stamp_s)


@pytest.mark.parametrize(
    "endless",
    [b"--frame\r\n" + b"X-Filler: yes\r\n" * HEAD_MAX_BYTES, b"--frame\r\n\r\n" + b"\0" * (PART_MAX_BYTES + 1)],
    ids=["head", "body"],
)
def test_what_does_not_end_is_given_up(endless: bytes) -> None:
    with pytest.raises(LinkLostError):
        parts_of("frame", endless)


def test_what_is_no_stream_takes_no_memory() -> None:
    parser = Multipart("frame")
    for _ in range(300):
        parser.feed(b"\0" * 65536)
        assert parser.next_part() is None
    assert len(parser._data) < 200


@pytest.mark.parametrize("count", [300, pytest.param(20_000, marks=pytest.mark.long)])
def test_damaged_streams_do_no_harm(count: int) -> None:
    rng = np.random.default_rng(11)
    data = stream() + stream(has_length=False) + stream(line_end=b"\n")
    for _ in range(count):
        damaged = bytearray(data)
        for _ in range(int(rng.integers(1, 6))):
            at = int(rng.integers(len(damaged)))
            match rng.integers(3):
                case 0:
                    damaged[at] = int(rng.integers(256))
                case 1:
                    del damaged[at : at + int(rng.integers(1, 2000))]
                case _:
                    damaged[at:at] = damaged[: int(rng.integers(1, 300))]
        try:
            found = parts_of("frame", bytes(damaged), int(rng.integers(50, 5000)))
        except LinkLostError:
            continue
        assert sum(len(part.body) for part in found) <= len(damaged)
