from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from stadimeter.bases.protocol import SpeedSteps, WheelSpeeds
from stadimeter.bases.sabertooth_base import SabertoothCodec, SabertoothOptions
from stadimeter.bases.serial_base import SerialBase
from stadimeter.errors import ProtocolError
from support.base_bench import BaseBench, base_bench, opened, vectors, wire
from support.firmware import SabertoothFirmware

SABERTOOTH = "sabertooth_packet_serial"
TABLE = {"full_speed": "1 m/s", "track_width": "16 cm"}


def codec(address: int = 128) -> SabertoothCodec:
    return SabertoothCodec(address=address, steps=SpeedSteps(step_mps=1.0), timeout_s=0.2)


def drive(left: int, right: int) -> bytes:
    return codec().encode(WheelSpeeds(left_mps=left, right_mps=right)).frame


SENT = {
    "m1_forward_64_manual": codec(130).packet(0, 64),
    "stop": drive(0, 0)[:4],
    "m2_forward_64": drive(0, 64)[4:8],
    "timeout_200ms": drive(0, 0)[8:],
    "m1_full": drive(127, 0)[:4],
}


@pytest.mark.parametrize("name", vectors(SABERTOOTH))
def test_a_command_is_these_bytes_exactly(name: str) -> None:
    assert SENT[name] == wire(SABERTOOTH, name)


def test_backwards_is_a_command_of_its_own() -> None:
    assert drive(-3, -4)[:8] == bytes([128, 1, 3, 4, 128, 5, 4, 9])


@given(before=st.binary(max_size=12), left=st.integers(-127, 127), right=st.integers(-127, 127))
def test_behind_any_bytes_a_command_is_understood(before: bytes, left: int, right: int) -> None:
    board = SabertoothFirmware()
    board.receive(before, 0.0)
    board.receive(drive(left, right), 0.0)
    assert board.left.driven_mps == pytest.approx(left / 127)
    assert board.right.driven_mps == pytest.approx(right / 127)


@pytest.fixture
def bench() -> Iterator[BaseBench]:
    with base_bench("sabertooth") as bench:
        yield bench


@pytest.fixture
def base(bench: BaseBench) -> Iterator[SerialBase]:
    with opened(bench, **TABLE) as base:
        yield base


def test_its_time_out_is_set_at_open_and_stops_the_wheels_when_the_host_dies(
    bench: BaseBench, base: SerialBase
) -> None:
    bench.drive(base, 0.3)
    assert bench.firmware.timeout_s == pytest.approx(0.3)
    last_s = bench.clock.now_s() - 0.05
    bench.clock.sleep_until_s(last_s + 0.28)
    assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)
    bench.clock.sleep_until_s(last_s + 1.2)
    assert bench.stands


def test_a_board_that_was_switched_off_and_on_gets_its_time_out_with_the_next_command(
    bench: BaseBench, base: SerialBase
) -> None:
    bench.drive(base, 0.3)
    bench.firmware.switch_off_and_on()
    assert bench.firmware.timeout_s > 1.0
    bench.drive(base, 0.3, seconds=0.05)
    assert bench.firmware.timeout_s == pytest.approx(0.3)


def test_a_stop_is_sent_more_than_once_because_nothing_says_that_it_came(bench: BaseBench, base: SerialBase) -> None:
    bench.drive(base, 0.3)
    bench.firmware.silent = True  # the first one is lost
    base.stop()
    bench.pass_time(base, 0.05)
    bench.firmware.silent = False
    bench.pass_time(base, 0.15)
    assert bench.firmware.left.driven_mps == 0.0


def test_a_port_where_something_talks_is_no_sabertooth(bench: BaseBench) -> None:
    bench.clock.call_every(0.05, lambda _: bench.board.port.say(b"OK\r\n"))
    with pytest.raises(ProtocolError, match=r"Sabertooth never does"):
        bench.base(**TABLE).open()
    assert bench.stands


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"max_wheel_speed": "2 m/s"}, "above full_speed"),
        ({"address": 127}, "address"),
        ({"auto_stop": "0 s"}, "500 ms"),
        ({"auto_stop": "2 s"}, "500 ms"),
        ({"track_width": "0 cm"}, "track_width"),
    ],
)
def test_a_table_that_cannot_be_meant_is_refused(table: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        SabertoothOptions.model_validate({"port": "emulated-sabertooth"} | TABLE | table)
