"""Boards with a PCA9685, and the I2C bus that they are on."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import ValidationError

from stadimeter.app.service import safe_lines
from stadimeter.bases.pca9685 import I2cLink, KernelI2cDevice, Pca9685Base, Pca9685Options
from stadimeter.config.plugins import DriverChoice, DriverContext
from stadimeter.core.command import TwistCommand
from stadimeter.errors import DeviceClosedError, DeviceOpenError, LinkLostError
from stadimeter.simulation.motors import EmulatedPca9685, EmulatedPca9685Options
from stadimeter.simulation.world import World, WorldOptions
from stadimeter.testing.rig import ManualClock
from support.each_case import each_case

# Boards with a PCA9685: what reaches which channel, what the chip is asked before it is written, and how it stops.

MODE1, SLEEP, ALLCALL = 0x00, 0x10, 0x01


def options(**changed: object) -> Pca9685Options:
    table = {"port": "emulated-pca9685", "track_width": "20 cm", "max_wheel_speed": "0.6 m/s", "minimum_duty": 0.25}
    return Pca9685Options.model_validate({**table, **changed})


class Bench:
    """A base on an emulated chip."""

    def __init__(self, **changed: object) -> None:
        self.clock = ManualClock()
        self.context = DriverContext(name="base", clock=self.clock)
        self.world = self.context.share("world", lambda: World(WorldOptions(track_width="20 cm"), self.clock))
        self.bus: EmulatedPca9685 = EmulatedPca9685Options.device(self.context)
        self.base = Pca9685Base(options(**({"board": "freenove-4wd"} | changed)), self.context)

    def drive(self, linear_mps: float, angular_radps: float = 0.0) -> None:
        self.base.apply(
            TwistCommand(output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=0.0)
        )

    def duties(self) -> dict[int, float]:
        return {channel: duty for channel in range(16) if (duty := self.bus.chip.duty(channel))}

    def is_standing(self) -> bool:
        self.clock.advance_s(1.0)
        return max(map(abs, self.world.robot.wheels_mps)) < 1e-3


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.context.shared.closers.pop()()


@pytest.mark.parametrize(
    ("board", "forwards", "to_the_left"),
    [
        ("freenove-4wd", {1, 2, 5, 7}, {0, 3, 5, 7}),
        ("jetbot", {1, 2}, {0, 2}),
        ("motorkit", {8, 10, 11, 13}, {8, 9, 11, 13}),
    ],
)
def test_each_board_has_its_own_channels(board: str, forwards: set[int], to_the_left: set[int]) -> None:
    bench = Bench(board=board)
    bench.base.open()
    bench.drive(0.3)
    assert set(bench.duties()) == forwards
    bench.drive(0.0, 2.0)
    assert set(bench.duties()) == to_the_left


def test_a_duty_has_twelve_bits(bench: Bench) -> None:
    bench.base.open()
    bench.drive(0.3)
    assert bench.duties()[1] == pytest.approx(0.25 + 0.75 / 2, abs=1 / 4096)
    bench.drive(0.6)
    assert bench.duties() == {1: 1.0, 2: 1.0, 5: 1.0, 7: 1.0}


def test_it_brakes_with_both_inputs_and_then_switches_them_off(bench: Bench) -> None:
    bench.base.open()
    bench.drive(0.3)
    bench.base.stop()
    assert set(bench.duties().values()) == {1.0}
    assert len(bench.duties()) == 8
    bench.clock.advance_s(0.3)
    bench.base.tick(bench.clock.now_s())
    assert bench.duties() == {}


def test_what_an_earlier_program_left_turning_stands_before_anything_else_is_written(bench: Bench) -> None:
    bench.base.open()
    bench.drive(0.3)
    late = Pca9685Base(options(board="freenove-4wd"), bench.context)  # the first one died
    late.open()
    assert bench.duties() == {}
    assert bench.is_standing()


def test_the_chip_goes_on_when_the_host_is_gone_and_the_stated_write_stops_it(bench: Bench) -> None:
    bench.base.open()
    bench.drive(0.3)
    bench.clock.advance_s(60.0)
    assert min(bench.world.robot.wheels_mps) > 0.29
    stop = options(board="freenove-4wd", port="/dev/i2c-1").i2c_stop()
    assert stop is not None
    for data in stop.writes:
        bench.bus.write(data)
    assert bench.is_standing()


def test_safe_outputs_gets_the_write() -> None:
    for changed, line in (
        ({"board": "motorkit", "port": "/dev/i2c-1"}, "i2c 1 0x60 fd10"),
        ({"board": "freenove-4wd", "port": "/dev/i2c-22", "address": 0x41}, "i2c 22 0x41 fd10"),
    ):
        choice = DriverChoice(name="base", driver="pca9685", options=options(**changed))
        assert list(safe_lines(choice)) == [line]
    assert list(safe_lines(DriverChoice(name="base", driver="pca9685", options=options(board="jetbot")))) == []


def test_a_power_cut_is_noticed_and_it_stands_until_it_is_opened_again(bench: Bench) -> None:
    bench.base.open()
    bench.drive(0.3)
    bench.bus.chip.power_up()
    bench.clock.advance_s(0.06)
    with pytest.raises(LinkLostError, match="power was interrupted"):
        bench.base.tick(bench.clock.now_s())
    assert bench.is_standing()
    bench.base.close()
    bench.base.open()
    assert bench.is_standing()


@pytest.mark.parametrize(
    ("register", "value"), [(0x02, 0x00), (0x05, 0xFF), (0xFE, 0x00)], ids=["another chip", "nothing", "no prescaler"]
)
def test_something_else_at_that_address_is_named_and_not_written(bench: Bench, register: int, value: int) -> None:
    bench.bus.chip.registers[register] = value
    before = bytes(bench.bus.chip.registers)
    with pytest.raises(DeviceOpenError, match=r"0x40 at emulated-pca9685 is no PCA9685.*i2cdetect"):
        bench.base.open()
    assert bytes(bench.bus.chip.registers) == before


def test_channels_that_belong_to_others_keep_what_they_have(bench: Bench) -> None:
    bench.base.open()
    bench.bus.write(bytes([0x06 + 4 * 8, 0, 0, 0x33, 0x01]))  # another program's servo
    for speed_mps in (0.3, -0.3, 0.0):
        bench.drive(speed_mps)
        bench.clock.advance_s(0.5)
        bench.base.tick(bench.clock.now_s())
        assert bench.duties()[8] == pytest.approx(0x133 / 4096)


@pytest.mark.parametrize(("frequency", "prescale"), [("50 Hz", 121), ("1 kHz", 5), ("1526 Hz", 3), ("24 Hz", 253)])
def test_the_frequency_is_that_of_the_data_sheet(frequency: str, prescale: int) -> None:
    bench = Bench(frequency=frequency)
    bench.base.open()
    assert bench.bus.chip.registers[0xFE] == prescale


@each_case(
    ("changed", "words"),
    [
        ({}, "name a board"),
        ({"board": "jetbot", "left": [{"forward": 0, "backward": 1}]}, "name a board"),
        ({"left": [{"forward": 0, "backward": 1}]}, "name a board"),
        ({"left": [{"forward": 0, "backward": 1}], "right": [{"forward": 1, "backward": 2}]}, "channel 1 is"),
        ({"left": [{"forward": 16, "backward": 1}], "right": [{"forward": 3, "backward": 2}]}, "15"),
        ({"board": "jetbot", "port": "/dev/ttyUSB0"}, "is not an I2C bus"),
        ({"board": "jetbot", "address": 0x80}, "119"),
        ({"board": "picar"}, "freenove-4wd"),
        ({"board": "jetbot", "frequency": "10 Hz"}, "24"),
    ],
)  # fmt: skip
def test_what_cannot_be_meant_is_refused(changed: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        options(**changed)


def test_a_bus_that_is_not_there_says_how_to_get_one() -> None:
    elsewhere = options(board="jetbot", port="/dev/i2c-99")
    assert "raspi-config" in elsewhere.lacks()[0]
    with pytest.raises(DeviceOpenError, match=r"no I2C bus /dev/i2c-99.*raspi-config"):
        Pca9685Base(elsewhere, DriverContext(name="base", clock=ManualClock())).open()


def test_nothing_stops_it_by_itself() -> None:
    assert options(board="jetbot").stops_by_itself_after_s() == float("inf")


# The kernel's side of an I2C bus: which calls it gets, and what becomes of its errors.


@pytest.fixture
def bus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a file that takes the calls of a bus, and keeps what is written to it."""
    path = tmp_path / "i2c"
    path.touch()
    monkeypatch.setattr(fcntl, "ioctl", lambda _descriptor, _request, _argument: 0)
    return path


def test_the_kernel_is_told_the_address_and_a_short_time_out_before_anything_is_sent(
    bus: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[int, int]] = []
    monkeypatch.setattr(fcntl, "ioctl", lambda _descriptor, request, argument: calls.append((request, argument)))
    link = I2cLink(str(bus), 0x40)
    link.open()
    assert calls == [(0x0703, 0x40), (0x0702, 3), (0x0701, 0)]  # I2C_SLAVE, I2C_TIMEOUT in 10 ms, I2C_RETRIES
    assert bus.read_bytes() == b""
    link.write(b"\xfd\x10")
    assert bus.read_bytes() == b"\xfd\x10"
    link.close()
    link.close()
    with pytest.raises(DeviceClosedError):
        link.write(b"\x00")


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENOENT, "raspi-config nonint do_i2c 0"),
        (errno.EACCES, "group i2c"),
        (errno.EBUSY, "driver of the kernel"),
        (errno.EIO, "cannot be opened"),
    ],
)
def test_a_bus_that_cannot_be_had_says_what_to_do(
    bus: Path, monkeypatch: pytest.MonkeyPatch, number: int, words: str
) -> None:
    def refuse(*_arguments: object) -> None:
        raise OSError(number, os.strerror(number))

    before = set(Path("/proc/self/fd").iterdir())
    monkeypatch.setattr(fcntl, "ioctl", refuse)
    with pytest.raises(DeviceOpenError, match=words):
        I2cLink(str(bus), 0x40).open()
    assert set(Path("/proc/self/fd").iterdir()) == before


@pytest.mark.parametrize(
    ("number", "words"), [(errno.EREMOTEIO, "does not answer"), (errno.ETIMEDOUT, "holds the bus")]
)
def test_a_device_that_is_gone_and_a_bus_that_hangs_are_told_apart(
    bus: Path, monkeypatch: pytest.MonkeyPatch, number: int, words: str
) -> None:
    def fail(*_arguments: object) -> bytes:
        raise OSError(number, os.strerror(number))

    link = I2cLink(str(bus), 0x40)
    link.open()
    monkeypatch.setattr(KernelI2cDevice, "write", fail)
    with pytest.raises(LinkLostError, match=words):
        link.write(b"\x00\x00")
    with pytest.raises(LinkLostError, match=words):
        link.read(0)
    link.close()


def test_a_read_that_is_too_short_is_no_answer(bus: Path) -> None:
    link = I2cLink(str(bus), 0x40)
    link.open()
    with pytest.raises(LinkLostError, match="gave 0 bytes of 1"):
        link.read(0xFE)  # behind the end of the file
    link.close()
