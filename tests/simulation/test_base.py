"""Simulated bases, outputs and services, and emulated firmwares with the traps of the real ones."""

from __future__ import annotations

import gc
import struct
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stadimeter.config.plugins import ACTUATORS, BASES, MESSENGERS, DriverContext
from stadimeter.core.command import LevelCommand, TwistCommand
from stadimeter.core.message import Message
from stadimeter.errors import ConfigError
from stadimeter.simulation.emulated_base import EmulatedPort
from stadimeter.simulation.firmware import EmulatedRosArduinoOptions, RosArduinoFirmware
from stadimeter.testing.rig import ManualClock
from support.base_bench import vectors, wire
from support.firmware import HoverboardFirmware, OpenBotFirmware, WaveshareUgvFirmware


def twist(linear_mps: float, angular_radps: float = 0.0) -> TwistCommand:
    return TwistCommand(output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=1.0)


def opened(run, **options):
    base = run.build(BASES, **options)
    base.open()
    return base


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(linear=st.floats(-5, 5), angular=st.floats(-50, 50))
def test_no_wheel_runs_too_fast_and_the_curve_stays(make_run, linear: float, angular: float) -> None:
    run = make_run(track_width="20 cm")
    applied = opened(run, max_wheel_speed="0.5 m/s").apply(twist(linear, angular))
    wheels = run.world.robot.wheels_mps
    assert max(map(abs, wheels)) <= 0.5 + 1e-12
    assert wheels == pytest.approx(
        (applied.linear_mps - applied.angular_radps * 0.1, applied.linear_mps + applied.angular_radps * 0.1)
    )
    assert applied.linear_mps * angular == pytest.approx(linear * applied.angular_radps, abs=1e-9)
    if max(abs(linear - angular * 0.1), abs(linear + angular * 0.1)) <= 0.5:
        assert (applied.linear_mps, applied.angular_radps) == (linear, angular)


def test_it_stops_by_itself_when_nothing_comes(run) -> None:
    opened(run, auto_stop="500 ms").apply(twist(0.2))
    run.clock.advance_s(10.0)
    assert run.world.robot.pose.x_m == pytest.approx(0.1)
    assert run.world.robot.wheels_mps == (0.0, 0.0)


# The emulated firmwares of bases: what they do with bytes, and the traps of the real ones.

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


def test_wheels_take_time_to_follow(board: RosArduinoFirmware) -> None:
    board.receive(b"m 10 20\r", 0.0)
    assert speeds(board, 0.0) == (0.0, 0.0)
    early, late = speeds(board, 0.133), speeds(board, 1.0)
    assert early[0] == pytest.approx(10 / 0.033 * 0.632, rel=0.01)  # one time constant after the first frame
    assert late == (pytest.approx(10 / 0.033, rel=1e-3), pytest.approx(20 / 0.033, rel=1e-3))


def test_it_stops_by_itself_two_seconds_after_the_last_motor_command(board: RosArduinoFirmware) -> None:
    board.receive(b"m 10 10\r", 0.0)
    board.receive(b"m 10 10\r", 1.5)
    assert speeds(board, 3.49)[0] == pytest.approx(10 / 0.033, rel=1e-3)
    assert speeds(board, 3.6)[0] == pytest.approx(10 / 0.033 * 0.37, rel=0.01)
    assert speeds(board, 6.0) == (0.0, 0.0)


def test_without_a_world_it_says_that_it_needs_one() -> None:
    with pytest.raises(ConfigError, match=r"\[world\]"):
        EmulatedRosArduinoOptions.board(DriverContext(name="base", clock=ManualClock()))


def open_files() -> set[Path]:
    gc.collect()  # what other tests left is closed now, and not in between
    return set(Path("/proc/self/fd").iterdir())


def test_closing_gives_everything_back_and_may_be_done_twice() -> None:
    before, clock = open_files(), ManualClock()
    port = EmulatedPort(RosArduinoFirmware(), clock)
    folder = Path(port.path).parent
    port.close()
    port.close()
    clock.advance_s(1.0)
    assert open_files() == before
    assert not folder.exists()


def command(level: float) -> LevelCommand:
    return LevelCommand(output="it", level=level, captured_at_s=1.0)


@pytest.mark.parametrize(("steps", "asked", "done"), [(1, 0.4, 0.0), (1, 0.6, 1.0), (4, 0.3, 0.25), (None, 0.3, 0.3)])
def test_a_level_is_rounded_to_the_steps_that_it_can_do(run, steps: int | None, asked: float, done: float) -> None:
    actuator = run.build(ACTUATORS, steps=steps)
    actuator.open()
    assert actuator.apply(command(asked)).level == done
    assert actuator.level == done


def message(text: str, qos: int = 1) -> Message:
    return Message(topic="event", payload=text, qos=qos)


def opened_messenger(run, **options):
    messenger = run.build(MESSENGERS, **options)
    messenger.open()
    return messenger


def test_messages_are_kept_with_their_time(run) -> None:
    messenger = opened_messenger(run)
    messenger.publish(message("a", qos=0))
    run.clock.advance_s(2.0)
    messenger.publish(message("b"))
    assert [(sent.at_s, sent.item.payload) for sent in messenger.sent] == [(100.0, "a"), (102.0, "b")]
    assert messenger.trouble() == ""
