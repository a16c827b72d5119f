"""The emulated firmwares of bases: what they do with bytes, and the traps of the real ones."""

from __future__ import annotations

import struct

import pytest

from stadimeter.simulation.hoverboard_firmware import HoverboardFirmware
from stadimeter.simulation.openbot_firmware import OpenBotFirmware
from stadimeter.simulation.waveshare_ugv_firmware import WaveshareUgvFirmware
from support.base_vectors import vectors, wire

WAVESHARE, HOVERBOARD, OPENBOT = "waveshare_ugv_json", "hoverboard_foc", "openbot_ascii"


class TestWaveshareUgv:
    @pytest.fixture
    def board(self) -> WaveshareUgvFirmware:
        return WaveshareUgvFirmware()

    def driven(self, board: WaveshareUgvFirmware, now_s: float) -> tuple[float, float]:
        board.step(now_s)
        return (board.left.driven_mps, board.right.driven_mps)

    @pytest.mark.parametrize(
        ("name", "driven_mps"),
        [
            ("wheels_zero", (0.0, 0.0)),
            ("wheels_0.5", (0.5, 0.5)),
            ("wheels_over_limit", (0.0, 0.0)),
            ("pwm_164", (164 / 255, 164 / 255)),
            ("twist_0.1_0.3", (0.1 - 0.3 * 0.086, 0.1 + 0.3 * 0.086)),
            ("zero_not_latched", (0.0, 0.0)),
            ("clear_estop", (0.0, 0.0)),
            ("chassis_type", (0.0, 0.0)),
        ],
    )
    def test_its_wheels_do_what_a_vector_says(
        self, board: WaveshareUgvFirmware, name: str, driven_mps: tuple[float, float]
    ) -> None:
        assert board.receive(wire(WAVESHARE, name), 0.1) == b""
        assert self.driven(board, 0.2) == pytest.approx(driven_mps)

    def test_it_reports_when_asked(self, board: WaveshareUgvFirmware) -> None:
        board.battery_v = 12.03
        board.left.rolled_m, board.right.rolled_m = 0.121, 0.131
        report = board.receive(wire(WAVESHARE, "feedback_once"), 1.0)
        assert report == b'{"T":1001,"L":0.0,"R":0.0,"odl":12,"odr":13,"v":1203}\r\n'

    def test_it_reports_by_itself_at_the_interval_that_was_set(self, board: WaveshareUgvFirmware) -> None:
        board.receive(wire(WAVESHARE, "feedback_interval") + wire(WAVESHARE, "feedback_continuous"), 0.0)
        reports = [board.receive(b"", hundredth / 100) for hundredth in range(1, 101)]
        assert 16 <= sum(map(bool, reports)) <= 20

    def test_commands_come_back_until_the_echo_is_off(self, board: WaveshareUgvFirmware) -> None:
        board.receive(b'{"T":143,"cmd":1}\n', 0.0)
        assert board.receive(b'{"T":0}\n', 0.1) == b'{"T":0}\n'
        board.receive(wire(WAVESHARE, "echo_off"), 0.2)
        assert board.receive(b'{"T":0}\n', 0.3) == b""

    def test_it_stops_three_seconds_after_the_last_wheel_command(self, board: WaveshareUgvFirmware) -> None:
        board.receive(wire(WAVESHARE, "wheels_0.5"), 1.0)
        board.receive(wire(WAVESHARE, "feedback_once"), 3.0)
        assert self.driven(board, 3.9) == (0.5, 0.5)
        assert self.driven(board, 4.1) == (0.0, 0.0)

    def test_or_as_soon_as_it_was_set_to(self, board: WaveshareUgvFirmware) -> None:
        board.receive(wire(WAVESHARE, "heartbeat_300ms") + wire(WAVESHARE, "wheels_0.5"), 1.0)
        assert self.driven(board, 1.29) == (0.5, 0.5)
        assert self.driven(board, 1.31) == (0.0, 0.0)

    def test_a_shorter_time_out_counts_for_wheels_that_turn_already(self, board: WaveshareUgvFirmware) -> None:
        board.receive(wire(WAVESHARE, "wheels_0.5"), 1.0)
        board.receive(wire(WAVESHARE, "heartbeat_300ms"), 2.0)
        assert self.driven(board, 2.01) == (0.0, 0.0)

    def test_trap_speed_and_turn_after_the_first_stop_drive_for_ever(self, board: WaveshareUgvFirmware) -> None:
        board.step(3.1)
        board.receive(b'{"T":13,"X":0.3,"Z":0}\n', 4.0)
        assert self.driven(board, 3600.0) == (0.3, 0.3)

    def test_trap_too_fast_a_command_keeps_the_old_speed_running(self, board: WaveshareUgvFirmware) -> None:
        board.receive(wire(WAVESHARE, "wheels_0.5"), 0.0)
        for second in range(1, 20):
            board.receive(wire(WAVESHARE, "wheels_over_limit"), second)
        assert self.driven(board, 20.0) == (0.5, 0.5)

    def test_trap_the_emergency_stop_does_not_last(self, board: WaveshareUgvFirmware) -> None:
        board.receive(wire(WAVESHARE, "wheels_0.5") + wire(WAVESHARE, "zero_not_latched"), 0.0)
        assert self.driven(board, 0.1) == (0.0, 0.0)
        board.receive(wire(WAVESHARE, "wheels_0.5"), 0.2)
        assert self.driven(board, 0.3) == (0.5, 0.5)

    @pytest.mark.parametrize(
        "line",
        [b'{"T":1,"L":0.5}\n', b'{"T":1,"L":"0.5","R":0.5}\n', b'{"T":1,"L":0.5,"R":\n', b"[1]\n", b"\xff\n", b"\n"],
    )
    def test_what_is_no_whole_command_moves_nothing(self, board: WaveshareUgvFirmware, line: bytes) -> None:
        board.receive(line, 0.0)
        assert self.driven(board, 0.1) == (0.0, 0.0)


def hoverboard_frame(steer: int, speed: int) -> bytes:
    words = struct.pack("<Hhh", 0xABCD, steer, speed)
    return words + struct.pack("<H", (0xABCD ^ (steer & 0xFFFF) ^ (speed & 0xFFFF)))


class TestHoverboard:
    @pytest.fixture
    def board(self) -> HoverboardFirmware:
        made = HoverboardFirmware()
        made.receive(wire(HOVERBOARD, "zero"), 0.0)
        return made

    @pytest.mark.parametrize(
        ("name", "driven"),
        [
            ("zero", (0, 0)),
            ("steer0_speed100", (100, 100)),
            ("steer0_speed-100", (-100, -100)),
            ("steer100_speed200", (250, 150)),
            ("steer-50_speed300", (275, 325)),
        ],
    )
    def test_it_mixes_speed_and_steering(self, board: HoverboardFirmware, name: str, driven: tuple[int, int]) -> None:
        board.receive(wire(HOVERBOARD, name), 0.1)
        assert (board.left.driven_mps * 1000, board.right.driven_mps * 1000) == pytest.approx(driven)

    @pytest.mark.parametrize(
        "burst",
        [
            wire(HOVERBOARD, "two_frames_one_burst"),
            wire(HOVERBOARD, "steer0_speed100")[:7],
            wire(HOVERBOARD, "steer0_speed100")[:7] + b"\x00",
            b"\x00" + wire(HOVERBOARD, "steer0_speed100"),
        ],
        ids=["two frames", "half a frame", "wrong checksum", "a byte before"],
    )
    def test_trap_a_burst_that_is_not_one_frame_is_dropped(self, board: HoverboardFirmware, burst: bytes) -> None:
        board.receive(wire(HOVERBOARD, "steer0_speed100"), 0.1)
        board.receive(burst, 0.2)
        assert board.left.driven_mps == pytest.approx(0.1)
        assert board.bursts_refused == 1

    def test_it_stops_when_nothing_came_for_0_8_s(self, board: HoverboardFirmware) -> None:
        board.receive(wire(HOVERBOARD, "steer0_speed100"), 1.0)
        board.step(1.79)
        assert board.left.driven_mps == pytest.approx(0.1)
        board.step(1.81)
        assert (board.left.driven_mps, board.right.driven_mps) == (0.0, 0.0)

    def test_trap_motors_stay_off_until_a_command_near_zero(self) -> None:
        board = HoverboardFirmware()
        board.receive(wire(HOVERBOARD, "steer0_speed100"), 0.0)
        assert board.left.driven_mps == 0.0
        board.receive(hoverboard_frame(0, 49), 0.1)
        board.receive(wire(HOVERBOARD, "steer0_speed100"), 0.2)
        assert board.left.driven_mps == pytest.approx(0.1)

    def test_steering_beyond_its_range_is_cut_before_it_is_mixed(self, board: HoverboardFirmware) -> None:
        board.receive(hoverboard_frame(2000, 0), 0.1)
        assert (board.left.driven_mps, board.right.driven_mps) == pytest.approx((0.5, -0.5))

    def test_it_reports_a_hundred_times_a_second_without_being_asked(self, board: HoverboardFirmware) -> None:
        reports = [board.receive(b"", 0.1 + step / 500) for step in range(500)]
        assert sum(map(bool, reports)) == pytest.approx(100, abs=1)
        assert {len(each) for each in reports} == {0, 18}


class TestOpenBot:
    @pytest.fixture
    def board(self) -> OpenBotFirmware:
        return OpenBotFirmware()

    @pytest.mark.parametrize("reply", [each for each in vectors(OPENBOT, "rx").values() if "reply_to" in each])
    def test_it_answers_the_vectors(self, board: OpenBotFirmware, reply: dict[str, str]) -> None:
        assert board.receive(wire(OPENBOT, reply["reply_to"]), 0.0) == bytes.fromhex(reply["bytes_hex"])

    def test_it_tells_its_voltage_every_second(self, board: OpenBotFirmware) -> None:
        board.battery_v = 12.03
        assert board.receive(b"", 1.0) == wire(OPENBOT, "voltage")
        assert board.receive(b"", 1.5) == b""

    def test_trap_without_a_time_out_it_drives_for_ever(self, board: OpenBotFirmware) -> None:
        board.receive(wire(OPENBOT, "control_128_128"), 0.0)
        board.step(3600.0)
        assert board.left.driven_mps == pytest.approx(128 / 255 * 0.8)

    def test_trap_commands_do_not_feed_its_time_out(self, board: OpenBotFirmware) -> None:
        board.receive(wire(OPENBOT, "heartbeat_750ms"), 0.0)
        for tenth in range(20):
            board.receive(wire(OPENBOT, "control_128_128"), tenth / 10)
        assert (board.left.driven_mps, board.right.driven_mps) == (0.0, 0.0)
        board.receive(wire(OPENBOT, "heartbeat_750ms") + wire(OPENBOT, "control_128_128"), 2.0)
        board.step(2.7)
        assert board.left.driven_mps > 0
        board.step(2.8)
        assert board.left.driven_mps == 0.0
