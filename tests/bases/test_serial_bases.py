"""What is so of every base on a serial port, over a pseudo-terminal to its emulated firmware; then what is special."""

from __future__ import annotations

import contextlib
import itertools
import json
import re
import tomllib
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from stadimeter.bases.protocol import Motion
from stadimeter.bases.serial_base import SerialBase
from stadimeter.config.plugins import BASES, load_driver
from stadimeter.errors import DeviceOpenError, LinkLostError
from support.base_bench import BaseBench, base_bench
from support.each_case import each_case

COMMON = {"track_width": "16 cm", "max_wheel_speed": "0.5 m/s"}

# The table [base] of the page on `ascii`, which is for OpenBot.
PAGE = (Path(__file__).parents[2] / "docs" / "robots" / "ascii.md").read_text("utf-8")
(SHOWN,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
NOT_OF_ITS_PROTOCOL = {"driver", "port", "track_width"}
OPENBOT = {key: value for key, value in tomllib.loads(SHOWN)["base"].items() if key not in NOT_OF_ITS_PROTOCOL}

# For each base: its driver, its emulated port, its options.
KINDS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "ros-arduino-bridge": (
        "ros-arduino-bridge",
        "emulated-ros-arduino-bridge",
        {"wheel_diameter": "65 mm", "ticks_per_turn": 1440},
    ),
    "waveshare-ugv": ("waveshare-ugv", "emulated-waveshare-ugv", {}),
    "hoverboard": ("hoverboard", "emulated-hoverboard", {"full_speed": "1 m/s"}),
    "openbot": ("ascii", "emulated-openbot", OPENBOT),
}
WITH_BATTERY = ("waveshare-ugv", "hoverboard", "openbot")
WITH_TRAVEL = ("ros-arduino-bridge", "waveshare-ugv", "hoverboard")


class Bench:
    """A base and an emulated board in a simulated world, with what was sent to the board."""

    def __init__(self, bench: BaseBench, base: SerialBase) -> None:
        self.bench, self.base, self.sent = bench, base, bytearray()
        self.clock, self.world, self.board = bench.clock, bench.world, bench.board
        receive = bench.firmware.receive
        bench.firmware.receive = lambda data, now_s: [self.sent.extend(data), receive(data, now_s)][1]

    def command(self, linear_mps: float, angular_radps: float = 0.0) -> None:
        self.bench.command(self.base, linear_mps, angular_radps)

    def drive(self, linear_mps: float, angular_radps: float = 0.0, seconds: float = 1.0) -> None:
        self.bench.drive(self.base, linear_mps, angular_radps, seconds)

    def pass_time(self, seconds: float) -> None:
        self.bench.pass_time(self.base, seconds)

    @property
    def speed_mps(self) -> float:
        """The faster wheel's."""
        return max(map(abs, self.world.robot.wheels_mps))

    @property
    def driven_mps(self) -> float:
        """What the faster motor is driven at: it has no inertia, as a wheel has."""
        return max(abs(self.board.firmware.left.driven_mps), abs(self.board.firmware.right.driven_mps))


MakeBench = Callable[..., Bench]


@pytest.fixture
def make_bench(closing: ExitStack) -> MakeBench:
    def make(kind: str, port: str | None = None, **more: Any) -> Bench:
        driver, own_port, options = KINDS[kind]
        port = port or own_port
        bench = closing.enter_context(base_bench(port.removeprefix("emulated-")))
        model = load_driver(BASES, driver)
        return Bench(bench, model.model_validate({"port": port} | COMMON | options | more).build(bench.context))

    return make


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def bench(make_bench: MakeBench, kind: str) -> Bench:
    made = make_bench(kind)
    made.base.open()
    return made


# Every base --------------------------------------------------------------------------------------


def test_when_the_host_dies_the_wheels_stop_after_the_time_that_the_driver_says(bench: Bench, kind: str) -> None:
    driver, port, options = KINDS[kind]
    after_s = load_driver(BASES, driver).model_validate({"port": port} | COMMON | options).stops_by_itself_after_s()
    bench.drive(0.3)
    bench.command(0.3)
    bench.clock.advance_s(after_s - 0.05)
    assert bench.driven_mps == pytest.approx(0.3, rel=0.02)
    bench.clock.advance_s(0.1)
    assert bench.driven_mps == 0.0
    bench.clock.advance_s(1.0)
    assert bench.speed_mps < 1e-3


def test_ticks_alone_never_keep_wheels_turning(bench: Bench) -> None:
    """Nothing that is sent from a timer feeds the firmware's time-out with a speed."""
    bench.drive(0.3)
    with contextlib.suppress(LinkLostError):  # of a base that is not asked any more, because nobody commands it
        bench.pass_time(2.5)
    bench.clock.advance_s(2.5)
    assert bench.driven_mps == 0.0


def test_a_stop_right_behind_a_command_is_obeyed(bench: Bench) -> None:
    bench.drive(0.3)
    bench.command(0.3)
    bench.base.stop()
    bench.clock.advance_s(0.03)
    assert bench.driven_mps == 0.0


def test_a_command_that_has_to_wait_goes_out_once_the_line_is_free(bench: Bench) -> None:
    bench.drive(0.3)
    bench.command(0.3)
    bench.command(0.2)
    accepted = bench.bench.command(bench.base, 0.1)
    assert accepted.linear_mps == pytest.approx(0.1, rel=0.02)
    bench.pass_time(0.05)
    assert bench.driven_mps == pytest.approx(0.1, rel=0.02)


@pytest.mark.parametrize("stop", ["by command", "at once"])
def test_a_stop_takes_back_a_command_that_waits(bench: Bench, stop: str) -> None:
    bench.command(0.3)
    bench.command(0.2)
    bench.command(0.0) if stop == "by command" else bench.base.stop()
    bench.pass_time(0.2)
    assert bench.driven_mps == 0.0


def test_closing_right_behind_a_command_stops_it(bench: Bench) -> None:
    bench.drive(0.3)
    bench.command(0.3)
    bench.base.close()
    bench.clock.advance_s(0.03)
    assert bench.driven_mps == 0.0


def test_a_stop_that_the_line_lost_is_sent_again(bench: Bench) -> None:
    bench.drive(0.3)
    bench.board.firmware.silent = True
    bench.base.stop()
    bench.pass_time(0.05)
    bench.board.firmware.silent = False
    assert bench.driven_mps > 0.29
    bench.pass_time(0.1)
    assert bench.driven_mps == 0.0


@pytest.mark.parametrize("part", range(1, 25, 3))
def test_a_stop_behind_half_a_frame_is_obeyed(make_bench: MakeBench, kind: str, part: int) -> None:
    bench = make_bench(kind)
    bench.base.open()
    bench.drive(0.3)
    bench.sent.clear()
    bench.command(0.31)
    bench.clock.advance_s(0.02)
    half = bytes(bench.sent[: min(part, len(bench.sent) - 1)])
    bench.base._frame_cut_short = True
    bench.board.firmware.receive(half, bench.clock.now_s())  # what the port took of the next frame
    bench.base.stop()
    bench.pass_time(0.05)
    assert bench.driven_mps == 0.0


def test_a_robot_that_an_earlier_program_left_driving_is_stopped_by_opening(make_bench: MakeBench, kind: str) -> None:
    first = make_bench(kind)
    first.base.open()
    first.drive(0.3)
    again = load_driver(BASES, KINDS[kind][0]).model_validate({"port": KINDS[kind][1]} | COMMON | KINDS[kind][2])
    first.base._link.close()
    again.build(first.bench.context).open()
    assert first.driven_mps == 0.0


@pytest.mark.parametrize(("driver", "port"), [*itertools.permutations(KINDS, 2)])
def test_a_port_with_another_base_is_refused_and_that_base_stays_at_rest(
    make_bench: MakeBench, driver: str, port: str
) -> None:
    bench = make_bench(driver, port=KINDS[port][1])
    speeds_mps: list[float] = []
    bench.clock.call_every(0.02, lambda _now_s: speeds_mps.append(bench.speed_mps))
    with pytest.raises(DeviceOpenError, match=r"nothing answers|without meaning"):
        bench.base.open()
    assert max(speeds_mps) == 0.0


@pytest.mark.parametrize(
    "garbage", [b"\xff\x00\xa5" * 40, b"$GPGGA,,,,,,0\r\n", b"\xcd\xab" * 30, b'{"T":1001', b"512\r\n"]
)
def test_a_port_with_something_that_talks_is_refused(make_bench: MakeBench, kind: str, garbage: bytes) -> None:
    bench = make_bench(kind)
    bench.board.firmware.silent = True
    bench.clock.call_every(0.1, lambda _now_s: bench.board.port.say(garbage))
    with pytest.raises(DeviceOpenError):
        bench.base.open()


@pytest.mark.parametrize(
    "garbage", [b"\xff\x00\xa5" * 40, b"\xcd\xab\r\n", b'{"T":1001,"v":1e999}\r\n', b"hello\r\n", b"v1e999\r\n"]
)
def test_garbage_between_reports_does_no_harm(bench: Bench, garbage: bytes) -> None:
    for _ in range(20):
        bench.board.port.say(garbage)
        bench.drive(0.3, seconds=0.05)
    assert bench.speed_mps == pytest.approx(0.3, rel=0.02)
    bench.base.stop()
    bench.pass_time(1.0)
    assert bench.speed_mps < 1e-3


@pytest.mark.parametrize("kind", WITH_BATTERY)
@pytest.mark.parametrize("volts", [0.0, 9.5, 36.5])
def test_the_battery_is_reported(make_bench: MakeBench, kind: str, volts: float) -> None:
    bench = make_bench(kind)
    bench.board.firmware.battery_v = volts
    bench.base.open()
    bench.pass_time(1.2)
    report = bench.base.report()
    assert report is not None
    assert report.battery_v == pytest.approx(volts, abs=0.01)
    assert bench.clock.now_s() - report.at_s < 1.1


@pytest.mark.parametrize("kind", WITH_BATTERY)
def test_a_battery_of_a_thousand_volts_is_not_believed(make_bench: MakeBench, kind: str) -> None:
    bench = make_bench(kind)
    bench.board.firmware.battery_v = 1.5e4 if kind == "waveshare-ugv" else 150.0
    bench.base.open()
    bench.pass_time(1.2)
    report = bench.base.report()
    assert report is None or report.battery_v is None


@pytest.mark.parametrize("kind", WITH_TRAVEL)
def test_the_way_of_each_wheel_is_reported(make_bench: MakeBench, kind: str) -> None:
    bench = make_bench(kind)
    bench.base.open()
    bench.drive(0.2, 1.0, seconds=2.0)
    bench.drive(0.0, seconds=1.0)
    report = bench.base.report()
    assert report is not None
    assert report.left_m == pytest.approx(0.12 * 2, abs=0.02)
    assert report.right_m == pytest.approx(0.28 * 2, abs=0.02)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"track_width": "0 cm"}, "above zero"),
        ({"max_wheel_speed": "0 m/s"}, "goes nowhere"),
        ({"max_wheel_speed": "-1 m/s"}, "max_wheel_speed"),
        ({"max_wheel_speed": "nan m/s"}, "max_wheel_speed"),
        ({"baud": 0}, "set the base to 2400 baud or more"),
        ({"baud": 1200}, "set the base to 2400 baud or more"),
    ],
)
def test_options_that_make_no_robot_are_errors(kind: str, wrong: dict[str, Any], says: str) -> None:
    driver, port, options = KINDS[kind]
    with pytest.raises(ValidationError, match=says):
        load_driver(BASES, driver).model_validate({"port": port} | COMMON | options | wrong)


# Waveshare UGV -----------------------------------------------------------------------------------


def test_a_waveshare_base_is_driven_by_wheel_speeds_only(make_bench: MakeBench) -> None:
    bench = make_bench("waveshare-ugv")
    bench.base.open()
    bench.drive(0.3, 1.0)
    bench.drive(-0.3, -1.0)
    bench.base.close()
    bench.clock.advance_s(0.1)
    kinds = [json.loads(line)["T"] for line in bench.sent.split(b"\n") if line]
    assert {*kinds} == {1, 130, 131, 136, 142, 143}
    assert kinds[-1] == 1


def test_opening_a_waveshare_base_sets_its_time_out(make_bench: MakeBench) -> None:
    bench = make_bench("waveshare-ugv", auto_stop="300 ms")
    bench.base.open()
    assert bench.board.firmware.timeout_s == 0.3


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"max_wheel_speed": "2.1 m/s"}, "ignores commands above 2 m/s"),
        ({"auto_stop": "0 s"}, r"write 0.2 to 3 s"),
        ({"auto_stop": "5 s"}, r"write 0.2 to 3 s"),
    ],
)
def test_a_waveshare_base_cannot_be_told_otherwise(wrong: dict[str, Any], says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        load_driver(BASES, "waveshare-ugv").model_validate({"port": "/dev/serial0"} | COMMON | wrong)


def test_older_waveshare_firmware_reports_volts(make_bench: MakeBench) -> None:
    bench = make_bench("waveshare-ugv")
    bench.base.open()
    bench.board.firmware.silent = True
    bench.board.port.say(b'{"T":1001,"L":0,"R":0,"r":0.1,"p":0.2,"v":11.8}\r\n')
    bench.pass_time(0.02)
    assert bench.base.report().battery_v == 11.8


# Hoverboard --------------------------------------------------------------------------------------


def test_no_two_frames_to_a_hoverboard_run_together(make_bench: MakeBench) -> None:
    bench = make_bench("hoverboard")
    bench.base.open()
    for _ in range(50):
        bench.command(0.3)
        bench.command(0.2)
        bench.base.stop()
        bench.pass_time(0.02)
    bench.base.close()
    bench.clock.advance_s(0.1)
    assert bench.board.firmware.bursts_refused == 0


def test_a_hoverboard_at_rest_is_kept_from_beeping_by_zeros(make_bench: MakeBench) -> None:
    bench = make_bench("hoverboard")
    bench.base.open()
    bench.drive(0.3)
    bench.base.stop()
    bench.pass_time(3.0)
    bench.sent.clear()
    bench.pass_time(1.0)
    assert 8 <= bench.sent.count(bytes.fromhex("cdab00000000cdab")) <= 11
    assert len(bench.sent) % 8 == 0


def test_a_hot_hoverboard_says_so(make_bench: MakeBench) -> None:
    bench = make_bench("hoverboard")
    bench.base.open()
    bench.pass_time(0.05)
    assert bench.base.report().errors == ()
    bench.board.firmware.temperature_c = 61.5
    bench.pass_time(0.05)
    assert bench.base.report().errors == ("the board is 61.5 °C hot, and switches itself off at 65 °C",)


def test_on_the_spot_a_hoverboard_turns_no_faster_than_its_protocol_can_say(make_bench: MakeBench) -> None:
    bench = make_bench("hoverboard", max_wheel_speed="1 m/s")
    bench.base.open()
    bench.drive(0.0, 100.0)
    left_mps, right_mps = bench.world.robot.wheels_mps
    assert (left_mps, right_mps) == pytest.approx((-0.5, 0.5), rel=0.01)


def test_a_limit_above_what_a_hoverboard_does_is_an_error() -> None:
    with pytest.raises(ValidationError, match="measure full_speed"):
        load_driver(BASES, "hoverboard").model_validate({"port": "/dev/serial0", "full_speed": "0.4 m/s"} | COMMON)


# A protocol of one's own -------------------------------------------------------------------------


def test_a_time_out_that_only_the_opening_sets_is_found_out_by_wheels_that_stop(make_bench: MakeBench) -> None:
    """The trap of OpenBot: its time-out is fed by ``h`` alone. With ``h500`` in ``opening``, it drives for 0.5 s."""
    bench = make_bench("openbot", drive="c{left:d},{right:d}\n", opening=["h500\n"])
    bench.base.open()
    bench.drive(0.3, seconds=2.0)
    assert bench.speed_mps < 1e-3


@each_case(
    ("wrong", "says"),
    [
        ({"drive": "c{left:d},{right:d}"}, "does not end its line"),
        ({"drive": "c{left:d}\n"}, r"has the fields left; write"),
        ({"drive": "c1,1\n"}, "has the fields none"),
        ({"drive": "c{left:d},{rigth:d}\n"}, "has the fields left, rigth"),
        ({"drive": "c{left:d},{right:d},{linear:d}\n"}, "has the fields"),
        ({"drive": "c{left:d},{right\n"}, "is no template"),
        ({"drive": "c{left:x},{right:d}\n"}, "'x' does not write {left} as a number"),
        ({"drive": "c{left:.0e},{right:d}\n"}, "writes {left}"),
        ({"drive": "c{left!r:d},{right.real:d}\n"}, "has the fields"),
        ({"drive": "ü{left:d},{right:d}\n"}, "ASCII"),
        ({"drive": "c{left:030d},{right:040d}\n"}, "longer than 63 bytes when"),
        ({"stop": "c0,0"}, "does not end its line"),
        ({"stop": None}, "stop"),
        ({"opening": ["h500"]}, "does not end its line"),
        ({"answers": None}, "question has no answer"),
        ({"answers": {"battery": "v(.*)"}}, "write identity"),
        ({"answers": {"identity": "f("}}, "no regular expression"),
        ({"answers": {"identity": "f", "battery": "v.*"}}, "needs 1 group"),
        ({"answers": {"identity": "f", "travel": "w(.*)"}}, "needs 2 groups"),
        ({"answers": {"identity": "f", "sonar": "s(.*)"}}, "Extra inputs"),
        ({"max_wheel_speed": "1 m/s"}, "above full_speed"),
        ({"full_units": 0}, "greater than 0"),
    ],
)
def test_a_protocol_that_cannot_be_spoken_is_an_error(wrong: dict[str, Any], says: str) -> None:
    options = {"port": "/dev/ttyUSB0"} | COMMON | OPENBOT | wrong
    with pytest.raises(ValidationError, match=says):
        load_driver(BASES, "ascii").model_validate({key: value for key, value in options.items() if value is not None})


def test_speed_and_rate_of_turn_can_be_written_too(make_bench: MakeBench) -> None:
    bench = make_bench(
        "openbot", drive="v {linear:d} {angular:.2f}\r", stop="v 0 0\r", full_speed="1 m/s", full_units=1000
    )
    command = bench.base._codec.encode(bench.base._drive.wheels(Motion(linear_mps=0.2, angular_radps=0.55)))
    assert command.frame == b"v 200 0.55\r"
    assert command.sent.right_mps - command.sent.left_mps == pytest.approx(0.55 * 0.16)
