"""The one way to a device on an I2C bus: the kernel's ``/dev/i2c-N``, with the standard library alone.

A write or a read is one transfer, which the device acknowledges byte by byte: one that is gone is noticed at once. A
bus whose clock is held low is noticed after `TIMEOUT_S`, where the kernel would wait for a second.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
from pathlib import Path
from typing import Protocol

from stadimeter.errors import DeviceClosedError, DeviceOpenError, LinkLostError

TIMEOUT_S = 0.03

# Of linux/i2c-dev.h.
_I2C_RETRIES, _I2C_TIMEOUT, _I2C_SLAVE = 0x0701, 0x0702, 0x0703
_TIMEOUT_UNIT_S = 0.01

_PATH = re.compile(r"/dev/i2c-(\d{1,3})")


class I2cDevice(Protocol):
    """A device on a bus as the kernel offers it. Whatever goes wrong is an `OSError`."""

    def write(self, data: bytes) -> None:
        """Write in one transfer."""
        ...

    def read(self, count: int) -> bytes:
        """Read in one transfer."""
        ...

    def close(self) -> None:
        """Let go of the bus."""
        ...


class KernelI2cDevice:
    """A device behind ``/dev/i2c-N``. Opening it sends nothing; EBUSY says that a driver of the kernel has it."""

    def __init__(self, path: str, address: int) -> None:
        self._descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        try:
            fcntl.ioctl(self._descriptor, _I2C_SLAVE, address)
            fcntl.ioctl(self._descriptor, _I2C_TIMEOUT, round(TIMEOUT_S / _TIMEOUT_UNIT_S))
            fcntl.ioctl(self._descriptor, _I2C_RETRIES, 0)
        except OSError:
            os.close(self._descriptor)
            raise

    def write(self, data: bytes) -> None:
        """Write in one transfer."""
        os.write(self._descriptor, data)

    def read(self, count: int) -> bytes:
        """Read in one transfer."""
        return os.read(self._descriptor, count)

    def close(self) -> None:
        """Let go of the bus."""
        os.close(self._descriptor)


class I2cLink:
    """A device with registers, at an address of a bus.

    Args:
        emulated: Stands for the device on the bus, which then needs no kernel.
    """

    def __init__(self, path: str, address: int, emulated: I2cDevice | None = None) -> None:
        self.name = f"the I2C device {address:#04x} at {path}"
        self._path = path
        self._address = address
        self._emulated = emulated
        self._device: I2cDevice | None = None

    def open(self) -> None:
        """Reach for the bus; nothing is sent. A `DeviceOpenError` says why it cannot be had."""
        try:
            self._device = self._emulated or KernelI2cDevice(self._path, self._address)
        except OSError as error:
            raise DeviceOpenError(_open_trouble(self._path, self.name, error)) from error

    def write(self, data: bytes) -> None:
        """Write a register's number and what comes into it; a `LinkLostError` if the device does not take it."""
        try:
            self._opened().write(data)
        except OSError as error:
            raise self._lost(error) from error

    def read(self, register: int, count: int = 1) -> bytes:
        """Read from a register on; a `LinkLostError` if the device does not answer."""
        try:
            self._opened().write(bytes([register]))
            data = self._opened().read(count)
        except OSError as error:
            raise self._lost(error) from error
        if len(data) != count:
            raise LinkLostError(f"{self.name} gave {len(data)} bytes of {count}")
        return data

    def close(self) -> None:
        """Let go of the bus. May be called any number of times."""
        device, self._device = self._device, None
        if device is not None:
            device.close()

    def _opened(self) -> I2cDevice:
        if self._device is None:
            raise DeviceClosedError(f"{self.name} is not open")
        return self._device

    def _lost(self, error: OSError) -> LinkLostError:
        if error.errno in {errno.ETIMEDOUT, errno.EAGAIN}:
            return LinkLostError(f"{self.name} cannot be reached: something holds the bus ({error.strerror})")
        return LinkLostError(f"{self.name} does not answer; check its cable, its power and its address ({error})")


def bus_number(path: str) -> int | None:
    """Return N of ``/dev/i2c-N``; None for another path."""
    found = _PATH.fullmatch(path)
    return int(found[1]) if found else None


def i2c_lacks(path: str) -> tuple[str, ...]:
    """Return why a bus cannot be had, as far as that shows without opening it."""
    if not Path(path).exists():
        return (_open_trouble(path, path, FileNotFoundError(errno.ENOENT, path)),)
    if not os.access(path, os.R_OK | os.W_OK):
        return (_open_trouble(path, path, PermissionError(errno.EACCES, path)),)
    return ()


def _open_trouble(path: str, name: str, error: OSError) -> str:
    if error.errno in {errno.ENOENT, errno.ENODEV, errno.ENXIO}:
        return f"there is no I2C bus {path}; switch I2C on: sudo raspi-config nonint do_i2c 0"
    if error.errno in {errno.EACCES, errno.EPERM}:
        return (
            f"this user may not use the I2C bus {path}; "
            "add yourself to the group i2c (sudo usermod -aG i2c $USER), then log in again"
        )
    if error.errno == errno.EBUSY:
        return f"{name} belongs to a driver of the kernel; remove its dtoverlay from config.txt"
    return f"{name} cannot be opened: {error.strerror or error}"
