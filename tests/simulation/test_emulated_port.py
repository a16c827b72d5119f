from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from stadimeter.app.clock import MonotonicClock
from stadimeter.simulation.emulated_port import EmulatedPort
from stadimeter.simulation.ros_arduino_firmware import RosArduinoFirmware
from stadimeter.testing.rig import ManualClock


@dataclass
class Rig:
    """A port with a board behind it, whose cable a test can pull."""

    clock: ManualClock = field(default_factory=ManualClock)
    plugged: bool = True
    port: EmulatedPort = field(init=False)

    def __post_init__(self) -> None:
        self.port = EmulatedPort(RosArduinoFirmware(), self.clock, lambda: self.plugged)


@pytest.fixture
def rig() -> Iterator[Rig]:
    made = Rig()
    yield made
    made.port.close()


@pytest.fixture
def open_port() -> Iterator[Callable[[str], int]]:
    opened: list[int] = []

    def open_it(path: str) -> int:
        opened.append(os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK))
        return opened[-1]

    yield open_it
    for descriptor in opened:
        os.close(descriptor)


def test_the_board_answers_through_the_port(rig: Rig, open_port: Callable[[str], int]) -> None:
    host = open_port(rig.port.path)
    os.write(host, b"b\r")
    rig.clock.advance_s(0.02)
    assert os.read(host, 100) == b"57600\r\n"


def test_what_the_board_says_unasked_arrives_and_does_not_come_back(rig: Rig, open_port: Callable[[str], int]) -> None:
    rig.port.say(b"\x00boot\r\n")
    rig.clock.advance_s(0.1)
    host = open_port(rig.port.path)
    assert os.read(host, 100) == b"\x00boot\r\n"
    os.write(host, b"b\r")
    rig.clock.advance_s(0.02)
    assert os.read(host, 100) == b"57600\r\n"


def test_a_pulled_cable_hangs_up_and_leaves_no_port(rig: Rig, open_port: Callable[[str], int]) -> None:
    host = open_port(rig.port.path)
    rig.plugged = False
    rig.clock.advance_s(0.02)
    with pytest.raises(OSError, match="Input/output"):
        os.write(host, b"b\r")
    assert not Path(rig.port.path).exists()
    rig.port.say(b"lost")


def test_plugged_in_again_the_port_is_back_under_its_old_name(rig: Rig, open_port: Callable[[str], int]) -> None:
    rig.plugged = False
    rig.clock.advance_s(0.02)
    rig.plugged = True
    rig.clock.advance_s(0.02)
    host = open_port(rig.port.path)
    os.write(host, b"b\r")
    rig.clock.advance_s(0.02)
    assert os.read(host, 100) == b"57600\r\n"


def test_a_host_that_never_reads_loses_answers_and_does_not_stop_the_board(
    rig: Rig, open_port: Callable[[str], int]
) -> None:
    open_port(rig.port.path)
    for _ in range(100):
        rig.port.say(b"x" * 1000)
    rig.clock.advance_s(0.1)


def open_files() -> set[Path]:
    return set(Path("/proc/self/fd").iterdir())


def test_closing_gives_everything_back_and_may_be_done_twice() -> None:
    before = open_files()
    rig = Rig()
    folder = Path(rig.port.path).parent
    rig.port.close()
    rig.port.close()
    rig.clock.advance_s(1.0)
    assert open_files() == before
    assert not folder.exists()


def test_on_a_real_clock_the_port_is_served_from_a_thread(open_port: Callable[[str], int]) -> None:
    clock = MonotonicClock()
    port = EmulatedPort(RosArduinoFirmware(started_s=clock.now_s()), clock)
    host = open_port(port.path)
    os.set_blocking(host, True)
    os.write(host, b"b\r")
    answer = b""
    while not answer.endswith(b"\n"):
        answer += os.read(host, 100)
    port.close()
    assert answer == b"57600\r\n"
