"""I2C devices that are pretended, and ports that are real pseudo-terminals."""

from __future__ import annotations

import errno
import os
import select

import pytest

from stadimeter.watchdog import stops
from stadimeter.watchdog.plan import SafePlan


class Buses:
    """A kernel with I2C buses: /dev/null stands in for their files, and every write is remembered."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *buses: str) -> None:
        self.written: list[tuple[str, int, bytes]] = []
        self.silent: set[int] = set()
        self.held_for_writes = 0  # something holds the bus for so many
        self._open: dict[int, str] = {}
        self._address: dict[int, int] = {}
        self._buses = buses
        self._real = os.open, os.write
        monkeypatch.setattr(stops.os, "open", self.open)
        monkeypatch.setattr(stops.os, "write", self.write)
        monkeypatch.setattr(stops.fcntl, "ioctl", self.ioctl)

    def open(self, path: str, flags: int) -> int:
        if not path.startswith("/dev/i2c-"):
            return self._real[0](path, flags)
        if path not in self._buses:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), path)
        descriptor = self._real[0]("/dev/null", flags)
        self._open[descriptor] = path
        return descriptor

    def ioctl(self, descriptor: int, request: int, address: int) -> int:
        if request == 0x0703:
            self._address[descriptor] = address
        return 0

    def write(self, descriptor: int, data: bytes) -> int:
        if descriptor not in self._open:
            return self._real[1](descriptor, data)
        address = self._address[descriptor]
        if self.held_for_writes:
            self.held_for_writes -= 1
            raise TimeoutError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))
        if address in self.silent:
            raise OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO))
        self.written.append((self._open[descriptor], address, data))
        return len(data)


def test_each_device_gets_its_writes_and_one_that_is_silent_keeps_no_other_from_its(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    buses = Buses(monkeypatch, "/dev/i2c-1")
    monkeypatch.setattr(stops, "TRIED_FOR_S", 0.1)
    buses.silent = {0x60}
    lines = ["i2c 1 0x60 fd10", "i2c 1 0x40 fd10,0001", "i2c 7 0x40 00"]
    said = stops.make_safe(SafePlan(lines))
    assert buses.written == [("/dev/i2c-1", 0x40, b"\xfd\x10"), ("/dev/i2c-1", 0x40, b"\0\x01")]
    assert sorted(said) == [
        "i2c 1 0x60: not stopped: Remote I/O error",
        "i2c 7 0x40: not stopped: No such file or directory",
    ]


def test_a_device_on_a_bus_that_is_held_for_a_moment_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    buses = Buses(monkeypatch, "/dev/i2c-1")
    monkeypatch.setattr(stops, "TRIED_EVERY_S", 0.0)
    buses.held_for_writes = 5
    assert stops.make_safe(SafePlan(["i2c 1 0x60 fd10", "i2c 1 0x40 fd10"])) == []
    assert {address for _, address, _ in buses.written} == {0x60, 0x40}


def test_a_part_that_hangs_or_has_a_defect_is_named_and_the_others_are_made_safe(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ours, theirs = os.openpty()
    free = os.pipe()
    monkeypatch.setattr(stops, "stop_bus", lambda *_: os.read(free[0], 1))
    monkeypatch.setattr(stops, "drive_pins", lambda *_: {}["no"])
    said = stops.make_safe(SafePlan(["i2c 1 0x40 00", "pin 4", f"serial {os.ttyname(theirs)} 115200 00ff"]), 1.0)
    assert said == ["pins: KeyError: 'no'", "i2c 1: hangs"]
    assert select.select([ours], [], [], 60)[0]
    assert os.read(ours, 100) == b"\0\xff"
    os.write(free[1], b"x")
    for each in (ours, theirs, free[1]):
        os.close(each)


@pytest.mark.parametrize("baud", [57600, 115200, 460800])
def test_the_speeds_of_bases_are_set(baud: int) -> None:
    ours, theirs = os.openpty()
    assert stops.make_safe(SafePlan([f"serial {os.ttyname(theirs)} {baud} 00"])) == []
    assert stops.termios.tcgetattr(theirs)[5] == getattr(stops.termios, f"B{baud}")
    os.close(ours)
    os.close(theirs)
