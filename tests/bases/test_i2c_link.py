"""The kernel's side of an I2C bus: which calls it gets, and what becomes of its errors."""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path

import pytest

from stadimeter.bases.pca9685 import I2cLink, KernelI2cDevice
from stadimeter.errors import DeviceClosedError, DeviceOpenError, LinkLostError


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
