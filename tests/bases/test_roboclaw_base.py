from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from stadimeter.bases.protocol import SpeedSteps, WheelSpeeds
from stadimeter.bases.roboclaw_base import RoboclawCodec, RoboclawOptions
from stadimeter.bases.serial_base import BaseMessage, SerialBase
from stadimeter.errors import DeviceOpenError, LinkLostError, ProtocolError
from support.base_bench import BaseBench, base_bench, opened, vectors, wire
from support.each_case import each_case
from support.firmware import RoboclawFirmware

ROBOCLAW = "roboclaw_packet_serial"
ENCODERS = {"wheel_diameter": "65 mm", "ticks_per_turn": 1440, "track_width": "16 cm"}
DUTY = {"full_speed": "1 m/s", "track_width": "16 cm"}
DONE = BaseMessage(was_done=True)


def codec(*, has_encoders: bool = True, step_mps: float = 1.0, address: int = 0x80) -> RoboclawCodec:
    steps = SpeedSteps(step_mps=step_mps)
    return RoboclawCodec(address=address, steps=steps, has_encoders=has_encoders, timeout_s=0.2)


def wheels(left_mps: float, right_mps: float) -> WheelSpeeds:
    return WheelSpeeds(left_mps=left_mps, right_mps=right_mps)


def duty(left: float, right: float) -> bytes:
    return codec(has_encoders=False, step_mps=1 / 32767).encode(wheels(left, right)).frame


SENT = {
    "cmd28_pid": codec().command(28, bytes.fromhex("00000000000021b70000036e0003135a")),
    "read_encoders": codec().ask(78),
    "stop": codec().stop,
    "duty_50_50": duty(16384 / 32767, 16384 / 32767),
    "duty_25_-25": duty(8192 / 32767, -8192 / 32767),
    "serial_timeout_200ms": codec().opening[0],
    "speed_1000_-1000": codec().encode(wheels(1000, -1000)).frame,
    "m1_forward_64": codec().command(0, b"\x40"),
}


@each_case("name", vectors(ROBOCLAW, "tx"))
def test_a_command_is_these_bytes_exactly(name: str) -> None:
    assert SENT[name] == wire(ROBOCLAW, name)


def test_these_bytes_are_the_answer_to_what_was_asked() -> None:
    asked = codec()
    asked.note_sent(asked.stop)
    asked.note_sent(asked.ask(78))
    assert asked.feed(wire(ROBOCLAW, "ack") + wire(ROBOCLAW, "encoders")) == [
        DONE,
        BaseMessage(left_m=12528.0, right_m=53212.0),
    ]


@pytest.mark.parametrize("name", ["stop", "duty_25_-25", "speed_1000_-1000", "serial_timeout_200ms"])
def test_the_emulated_board_takes_these_bytes_and_answers_as_in_the_vectors(name: str) -> None:
    board = RoboclawFirmware(ticks_per_metre=10000)
    assert board.receive(wire(ROBOCLAW, name), 0.0) == wire(ROBOCLAW, "ack")
    driven_mps = {"duty_25_-25": 0.25, "speed_1000_-1000": 0.1}.get(name, 0.0)
    assert (board.left.driven_mps, board.right.driven_mps) == pytest.approx((driven_mps, -driven_mps), abs=1e-4)
    assert board.timeout_s == (0.2 if "timeout" in name else math.inf)


@pytest.mark.parametrize("data", [b"", b"\x12", b"\x12\x34\x56\x78\x9a", bytes(9), bytes.fromhex("ff00")])
def test_an_answer_behind_garbage_is_found(data: bytes) -> None:
    asked = codec()
    asked.note_sent(asked.ask(78))
    assert asked.feed(data + wire(ROBOCLAW, "encoders")) == [BaseMessage(left_m=12528.0, right_m=53212.0)]
    assert asked.dropped_bytes == len(data)


@each_case("spoiled", range(10))
def test_an_answer_with_a_wrong_bit_is_none(spoiled: int) -> None:
    asked = codec()
    asked.note_sent(asked.ask(78))
    answer = bytearray(wire(ROBOCLAW, "encoders"))
    answer[spoiled] ^= 1
    assert asked.feed(bytes(answer)) == []


def test_the_answer_to_another_question_is_none() -> None:
    asked = codec()
    asked.note_sent(asked.ask(24))
    assert asked.feed(RoboclawFirmware().receive(asked.ask(90), 0.0)) == []


def test_what_was_not_asked_for_is_dropped() -> None:
    unasked = codec()
    assert unasked.feed(wire(ROBOCLAW, "encoders") + b"\xff") == []
    assert unasked.dropped_bytes == 11


def test_a_lost_answer_holds_up_the_others_for_a_few_frames_only() -> None:
    asked = codec()
    asked.note_sent(asked.ask(78))
    heard = []
    for _ in range(6):
        asked.note_sent(asked.stop)
        heard += asked.feed(b"\xff")
    assert heard[-1:] == [DONE]


@each_case("is_old", [False, True])
@each_case(
    ("names", "bits"), [((), (0, 0)), (("emergency stop",), (1, 4)), (("too hot",), (2, 8)), ((), (0x03FF0000, 0xFC03))]
)
def test_both_widths_of_the_status_are_understood(*, is_old: bool, names: tuple[str, ...], bits: list[int]) -> None:
    board, asked = RoboclawFirmware(), codec()
    board.is_old, board.status = is_old, bits[is_old]
    asked.note_sent(asked.ask(90))
    assert asked.feed(board.receive(asked.ask(90), 0.0)) == [BaseMessage(errors=names)]


QUESTIONS = st.sampled_from([15, 24, 78, 90])


@given(questions=st.lists(QUESTIONS | st.just(34), max_size=4), data=st.data())
def test_answers_are_the_same_however_they_are_split(questions: list[int], data: st.DataObject) -> None:
    board, whole, pieces = RoboclawFirmware(), codec(), codec()
    stream = b""
    for question in questions:
        frame = whole.stop if question == 34 else whole.ask(question)
        whole.note_sent(frame)
        pieces.note_sent(frame)
        stream += board.receive(frame, 0.0)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    bounds = zip([0, *cuts], [*cuts, len(stream)], strict=True)
    heard = [message for begin, end in bounds for message in pieces.feed(stream[begin:end])]
    assert heard == whole.feed(stream)
    assert len(heard) == len(questions)
    assert not whole.dropped_bytes


@given(noise=st.binary(max_size=60))
def test_noise_hides_no_answer_for_ever(noise: bytes) -> None:
    asked, board = codec(), RoboclawFirmware()
    asked.note_sent(asked.ask(24))
    asked.feed(noise)
    heard = []
    for _ in range(10):
        asked.note_sent(asked.ask(24))
        heard += asked.feed(board.receive(asked.ask(24), 0.0))
    assert heard[-1].battery_v == 12.0


@each_case("address", range(0x80, 0x88))
@each_case("size", range(13))
def test_a_stop_behind_any_part_of_a_frame_stops(address: int, size: int) -> None:
    """It comes at once, while the board still takes bytes for the rest of what was cut short."""
    board, sender = RoboclawFirmware(ticks_per_metre=10000), codec(address=address)
    board.address = address
    moving = sender.encode(wheels(1000, -700)).frame
    board.receive(moving, 0.0)
    board.receive(moving[:size] + sender.ends_cut_frame + sender.stop, 0.001)
    assert (board.left.driven_mps, board.right.driven_mps) == (0.0, 0.0)


@pytest.fixture
def bench() -> Iterator[BaseBench]:
    with base_bench("roboclaw") as bench:
        yield bench


@pytest.fixture
def base(bench: BaseBench) -> Iterator[SerialBase]:
    with opened(bench, **ENCODERS) as base:
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


def test_questions_do_not_keep_wheels_turning_that_nobody_commands(bench: BaseBench, base: SerialBase) -> None:
    """Every byte feeds the time-out: a program whose loop hangs, and whose ticks go on, must not feed it."""
    bench.drive(base, 0.3)
    bench.pass_time(base, 0.5)
    assert max(map(abs, bench.wheels_mps)) < 0.1
    bench.pass_time(base, 0.5)
    assert bench.stands


def test_stops_that_are_spoilt_on_their_way_do_not_keep_the_wheels_turning(bench: BaseBench, base: SerialBase) -> None:
    """On a noisy line each stop that is sent again feeds the time-out, and so does everything else that is sent."""
    bench.drive(base, 0.3)
    bench.board.port.spoil = lambda sent: bytes(byte ^ 1 for byte in sent)
    for _ in range(9):
        bench.drive(base, 0.0, seconds=0.05)
        base.stop()
    assert max(map(abs, bench.wheels_mps)) < 0.2
    with pytest.raises(LinkLostError):
        bench.drive(base, 0.0, seconds=0.2)
    assert max(map(abs, bench.wheels_mps)) < 0.1
    bench.board.port.spoil = bytes
    base.close()
    base.open()
    bench.drive(base, 0.3)
    assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)


def test_a_board_that_was_switched_off_and_on_is_a_fault_until_it_is_opened_anew(
    bench: BaseBench, base: SerialBase
) -> None:
    bench.drive(base, 0.3)
    bench.firmware.switch_off_and_on()
    with pytest.raises(ProtocolError, match="forgotten its time-out"):
        bench.drive(base, 0.3, seconds=2.0)
    base.close()
    base.open()
    bench.drive(base, 0.3)
    assert bench.firmware.timeout_s == pytest.approx(0.3)
    assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)


def test_it_reports_battery_travel_and_errors(bench: BaseBench, base: SerialBase) -> None:
    bench.firmware.battery_v, bench.firmware.status = 11.3, 1 << 19 | 1 << 6
    bench.drive(base, 0.2, seconds=3.0)
    report = bench.report(base)
    assert report.battery_v == pytest.approx(11.3)
    assert report.errors == ("fault of driver 1",)  # and a warning, which is none
    assert (report.left_m, report.right_m) == pytest.approx((0.6, 0.6), abs=0.12)
    assert report.is_bumped is report.is_at_cliff is None


def test_a_robot_that_rolls_backwards_past_zero_reports_it_backwards(bench: BaseBench, base: SerialBase) -> None:
    bench.drive(base, -0.2, seconds=3.0)
    assert bench.report(base).left_m == pytest.approx(-0.6, abs=0.12)


def test_without_encoders_it_is_driven_by_duty_and_reports_no_travel(bench: BaseBench) -> None:
    with opened(bench, **DUTY) as base:
        bench.drive(base, 0.3)
        assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)
        assert bench.report(base).left_m is None


def test_a_port_where_something_else_talks_is_no_roboclaw(bench: BaseBench) -> None:
    bench.firmware.silent = True
    bench.clock.call_every(0.05, lambda _: bench.board.port.say(b"OK\r\n57600\r\n"))
    with pytest.raises(DeviceOpenError, match=r"no RoboClaw at .* bytes without meaning"):
        bench.base(**ENCODERS).open()
    assert bench.stands


@each_case(
    ("table", "message"),
    [
        (ENCODERS | DUTY, "or else full_speed"),
        ({"track_width": "16 cm"}, "or else full_speed"),
        (ENCODERS | {"wheel_diameter": None}, "belong together"),
        (DUTY | {"max_wheel_speed": "2 m/s"}, "beyond full_speed"),
        (DUTY | {"full_speed": "0 m/s"}, "beyond full_speed"),
        (DUTY | {"address": 0x88}, "address"),
        (DUTY | {"track_width": "0 cm"}, "track_width"),
        (DUTY | {"auto_stop": "0 s"}, "500 ms"),
        (DUTY | {"auto_stop": "250 ms"}, "500 ms"),
        (DUTY | {"auto_stop": "1 s"}, "500 ms"),
    ],
)
def test_a_table_that_cannot_be_meant_is_refused(table: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        RoboclawOptions.model_validate({"port": "emulated-roboclaw"} | table)
