"""The emulated firmwares of bases: what they do with bytes, and the traps of the real ones."""

from __future__ import annotations

import struct

import pytest

from stadimeter.simulation.firmware import HoverboardFirmware, OpenBotFirmware, WaveshareUgvFirmware
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

    def test_trap_motors_stay_off_until_a_command_near_zero(self) -> None:
        board = HoverboardFirmware()
        board.receive(wire(HOVERBOARD, "steer0_speed100"), 0.0)
        assert board.left.driven_mps == 0.0
        board.receive(hoverboard_frame(0, 49), 0.1)
        board.receive(wire(HOVERBOARD, "steer0_speed100"), 0.2)
        assert board.left.driven_mps == pytest.approx(0.1)


class TestOpenBot:
    @pytest.fixture
    def board(self) -> OpenBotFirmware:
        return OpenBotFirmware()

    @pytest.mark.parametrize("reply", [each for each in vectors(OPENBOT, "rx").values() if "reply_to" in each])
    def test_it_answers_the_vectors(self, board: OpenBotFirmware, reply: dict[str, str]) -> None:
        assert board.receive(wire(OPENBOT, reply["reply_to"]), 0.0) == bytes.fromhex(reply["bytes_hex"])

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
