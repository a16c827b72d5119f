"""Boards that drive motors through a PCA9685 over I2C: Freenove 4WD, Waveshare JetBot, Adafruit MotorKit, and others.

**This base does not stop by itself**: see `stadimeter.bases.pca9685`. Channels of the boards as in their makers'
code: ``Motor.py`` of Freenove_4WD_Smart_Car_Kit_for_Raspberry_Pi, ``motor.py`` of NVIDIA-AI-IOT/jetbot (the lines for
Waveshare's board), ``adafruit_motorkit.py``.
"""

from __future__ import annotations

import errno
import fcntl
import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Protocol, Self

from msgspec import Struct
from pydantic import Field, model_validator

from stadimeter.bases.gpio_motors import HBridgeBase, HBridgeOptions, MotorTable
from stadimeter.bases.protocol import MotorOutputs
from stadimeter.config.plugins import PORTS, DriverContext, I2cStop, driver_names, load_driver
from stadimeter.config.units import Frequency
from stadimeter.errors import DeviceClosedError, DeviceOpenError, LinkLostError

# The one way to a device on an I2C bus: the kernel's ``/dev/i2c-N``, with the standard library alone ------------------
#
# A write or a read is one transfer, which the device acknowledges byte by byte: one that is gone is noticed at
# once. A bus whose clock is held low is noticed after `TIMEOUT_S`, where the kernel would wait for a second.

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


# A PCA9685 on an I2C bus: sixteen channels that pulse as they were last written ---------------------------------------
#
# **The chip does not stop by itself.** It goes on pulsing as it was written last when the host dies, until it is
# written again or loses its power, and a chip that was put to sleep resumes when it is woken. So every channel is
# switched off when it is opened and let go, and `stop_writes` says how anybody else does it.
#
# Registers as in NXP's data sheet PCA9685 (rev. 4), section 7.3.

MODE1, MODE2, SUBADR1, CHANNEL_0, ALL_OFF_HIGH, PRESCALE = 0x00, 0x01, 0x02, 0x06, 0xFD, 0xFE
AUTO_INCREMENT, SLEEP = 0x20, 0x10
TOTEM_POLE = 0x04

# Written to the high byte of a channel's end of pulse: it is off, whatever else is written.
FULL_OFF = 0x10
ALL_OFF = bytes([ALL_OFF_HIGH, FULL_OFF])

# What SUBADR1 to ALLCALLADR hold from power-up on, and what nobody changes: the chip's signature.
SIGNATURE = bytes([0xE2, 0xE4, 0xE8, 0xE0])

# Levels of a channel: 12 bits, and 4096 for on all the time.
FULL = 4096

OSCILLATOR_HZ = 25e6
MIN_PRESCALE, MAX_PRESCALE = 3, 255
WAKING_S = 0.001  # the oscillator needs 0.5 ms

# How often the chip of a moving robot is asked whether it is still awake: gone, or without power, within 0.1 s.
ASKED_EVERY_S = 0.05

Channel = Annotated[int, Field(ge=0, le=15)]


class Pca9685:
    """The chip at an address of a bus.

    Args:
        port: Such as ``/dev/i2c-1``, or the name of an emulated chip.
        frequency_hz: Of the pulses of every channel.
    """

    def __init__(self, context: DriverContext, port: str, address: int, frequency_hz: float) -> None:
        self._context = context
        self._port = port
        self._address = address
        self._frequency_hz = frequency_hz
        self._link: I2cLink | None = None
        self._asked_s = -math.inf

    @property
    def is_open(self) -> bool:
        """True while the bus is taken."""
        return self._link is not None

    def open(self) -> Any:
        """Find the chip, switch every channel off, and set its frequency. Does nothing when open.

        Returns:
            The emulated chip, to wire what hangs on its channels; None for a real one.

        Raises:
            DeviceOpenError: There is no such bus, nothing answers there, or something that is no PCA9685.
        """
        if self.is_open:
            return None
        emulated = None
        if self._port in driver_names(PORTS):
            emulated = load_driver(PORTS, self._port)().build(self._context)
        link = I2cLink(self._port, self._address, emulated)
        link.open()
        try:
            _identify(link)
            self._set_up(link)
        except LinkLostError as error:
            link.close()
            raise DeviceOpenError(str(error)) from error
        except BaseException:
            link.close()
            raise
        self._asked_s = -math.inf
        self._link = link
        return emulated

    def _set_up(self, link: I2cLink) -> None:
        """Switch off what an earlier program left on, then set the frequency, which the chip takes only asleep."""
        prescale = round(OSCILLATOR_HZ / (4096 * self._frequency_hz)) - 1
        prescale = min(MAX_PRESCALE, max(MIN_PRESCALE, prescale))
        link.write(ALL_OFF)
        link.write(bytes([MODE1, SLEEP | AUTO_INCREMENT]))
        link.write(bytes([PRESCALE, prescale]))
        link.write(bytes([MODE2, TOTEM_POLE]))
        link.write(bytes([MODE1, AUTO_INCREMENT]))  # without the bit that resumes old pulses
        clock = self._context.clock
        clock.sleep_until_s(clock.now_s() + WAKING_S)
        if link.read(PRESCALE)[0] != prescale or link.read(MODE1)[0] != AUTO_INCREMENT:
            raise DeviceOpenError(f"{link.name} does not keep what is written to it; is its supply steady?")

    def check(self) -> None:
        """Ask the chip, now and then; a `LinkLostError` if it is gone, or lost its power and must be set up anew."""
        now_s = self._context.clock.now_s()
        if self._link is None or now_s - self._asked_s < ASKED_EVERY_S:
            return
        mode = self._link.read(MODE1)[0]
        if mode != AUTO_INCREMENT:
            raise LinkLostError(f"{self._link.name} was reset (MODE1 is {mode:#04x}): its power was interrupted")
        self._asked_s = now_s

    def write(self, levels: Mapping[int, int]) -> None:
        """Write channels, 0 to `FULL` of each period; neighbours in one transfer, so that they change together."""
        assert self._link is not None  # noqa: S101 - callers have looked
        runs: list[list[int]] = []
        for channel in sorted(levels):
            if not runs or runs[-1][-1] != channel - 1:
                runs.append([])
            runs[-1].append(channel)
        for run in sorted(runs, key=lambda run: max(levels[each] for each in run)):
            self._link.write(bytes([CHANNEL_0 + 4 * run[0]]) + b"".join(_pulse(levels[each]) for each in run))

    def let_go(self) -> None:
        """Switch every channel off, and let go of the bus even if that fails."""
        link, self._link = self._link, None
        if link is not None:
            try:
                link.write(ALL_OFF)
            finally:
                link.close()


def stop_writes(port: str, address: int) -> I2cStop | None:
    """Return the write that switches every channel off; None for an emulated chip."""
    bus = bus_number(port)
    return None if bus is None else I2cStop(bus=bus, address=address, writes=(ALL_OFF,))


def _identify(link: I2cLink) -> None:
    """Read what every such chip has, before anything is written to what may be a sensor."""
    found = b"".join(link.read(SUBADR1 + offset) for offset in range(len(SIGNATURE)))
    if found != SIGNATURE or link.read(PRESCALE)[0] < MIN_PRESCALE:
        raise DeviceOpenError(
            f"{link.name} is no PCA9685 (its registers 2 to 5 hold {found.hex(' ')}, not {SIGNATURE.hex(' ')}); "
            "check address: i2cdetect -y 1 lists what is there"
        )


def _pulse(level: int) -> bytes:
    """Return the four registers of a channel: where in 4096 steps its pulse begins and ends, low bytes first."""
    begins, ends = (FULL, 0) if level == FULL else (0, level or FULL)  # 4096 is the bit for always on, or always off
    return begins.to_bytes(2, "little") + ends.to_bytes(2, "little")


class MotorBoard(Struct, frozen=True, kw_only=True):
    """A board with this chip as it is sold."""

    address: int
    frequency_hz: float
    left: tuple[MotorOutputs, ...]
    right: tuple[MotorOutputs, ...]


BOARDS = {
    "freenove-4wd": MotorBoard(
        address=0x40,
        frequency_hz=50.0,  # the servos on channels 8 to 15 want it
        left=(MotorOutputs(forward=1, backward=0), MotorOutputs(forward=2, backward=3)),
        right=(MotorOutputs(forward=7, backward=6), MotorOutputs(forward=5, backward=4)),
    ),
    "jetbot": MotorBoard(
        address=0x60,
        frequency_hz=1500.0,
        left=(MotorOutputs(forward=1, backward=0),),
        right=(MotorOutputs(forward=2, backward=3),),
    ),
    "motorkit": MotorBoard(  # its M1 on the left, its M2 on the right
        address=0x60,
        frequency_hz=1500.0,
        left=(MotorOutputs(forward=10, backward=9, pwm=8),),
        right=(MotorOutputs(forward=11, backward=12, pwm=13),),
    ),
}


class MotorChannels(MotorTable):
    """The channels of one motor, 0 to 15: forward and backward, both and pwm, or direction and pwm."""

    forward: Channel | None = None
    """High drives forwards. It is pulsed, unless ``pwm`` is named."""
    backward: Channel | None = None
    """High drives backwards."""
    direction: Channel | None = None
    """For drivers with one input for the direction: high drives forwards, low backwards."""
    pwm: Channel | None = None
    """The channel for how strongly it drives."""


class Pca9685Options(HBridgeOptions):
    """The options of two motors on a board with a PCA9685."""

    title: ClassVar = "a motor board over I2C: Freenove 4WD, JetBot, Adafruit MotorKit"

    port: str = "/dev/i2c-1"
    """The I2C bus, or ``emulated-pca9685``."""
    board: Literal["freenove-4wd", "jetbot", "motorkit"] | None = Field(default=None, examples=["freenove-4wd"])
    """The board; left out where ``left`` and ``right`` name the channels."""
    address: int | None = Field(default=None, ge=0x08, le=0x77)
    """Of the chip, 7 bits; None for the board's, or 0x40."""
    left: tuple[MotorChannels, ...] = ()
    """The channels of each motor on the left."""
    right: tuple[MotorChannels, ...] = ()
    """The channels of each motor on the right."""
    frequency: Frequency | None = Field(default=None, ge=24.0, le=1526.0)
    """Of the pulses; None for the board's, or 1 kHz. Servos on the same chip want 50 Hz."""

    @model_validator(mode="after")
    def _check_motors(self) -> Self:
        if bool(self.left) != bool(self.right) or bool(self.left) == (self.board is not None):
            raise ValueError(f"name a board ({', '.join(BOARDS)}), or the channels of the motors as left and right")
        board = self.chosen_board()
        named = [each for motor in (*board.left, *board.right) for each in _channels(motor)]
        twice = sorted({each for each in named if named.count(each) > 1})
        if twice:
            raise ValueError(f"channel {twice[0]} is named twice; each input of a motor needs its own")
        if not self.is_simulated() and bus_number(self.port) is None:
            raise ValueError(f"{self.port!r} is not an I2C bus; write it such as '/dev/i2c-1'")
        return self

    def chosen_board(self) -> MotorBoard:
        """Return the board with what the configuration says otherwise."""
        sold = BOARDS.get(self.board or "", MotorBoard(address=0x40, frequency_hz=1000.0, left=(), right=()))
        return MotorBoard(
            address=sold.address if self.address is None else self.address,
            frequency_hz=self.frequency or sold.frequency_hz,
            left=sold.left or tuple(motor.outputs() for motor in self.left),
            right=sold.right or tuple(motor.outputs() for motor in self.right),
        )

    def build(self, context: DriverContext) -> Pca9685Base:
        """Return the base."""
        return Pca9685Base(self, context)

    def is_simulated(self) -> bool:
        """Check whether the chip is an emulated one."""
        return self.port in driver_names(PORTS)

    def lacks(self) -> tuple[str, ...]:
        """List the things that keep the bus from being opened."""
        return () if self.is_simulated() else i2c_lacks(self.port)

    def i2c_stop(self) -> I2cStop | None:
        """Return the write that switches every channel off."""
        return stop_writes(self.port, self.chosen_board().address)


class Pca9685Base(HBridgeBase):
    """A `MobileBase` whose motors hang on channels of a PCA9685."""

    def __init__(self, options: Pca9685Options, context: DriverContext) -> None:
        self._board = board = options.chosen_board()
        super().__init__(options, context, (board.left, board.right), full=FULL)
        self._chip = Pca9685(context, options.port, board.address, board.frequency_hz)

    @property
    def is_open(self) -> bool:
        """True while the bus is taken."""
        return self._chip.is_open

    def open(self) -> None:
        """Find the chip, switch every channel off, and set its frequency. Does nothing when open.

        Raises:
            DeviceOpenError: There is no such bus, nothing answers there, or something that is no PCA9685.
        """
        if self.is_open:
            return
        emulated = self._chip.open()
        if emulated is not None:
            emulated.wire(self._board.left, self._board.right)
        self._forget()

    def tick(self, now_s: float) -> None:
        """End the braking of a robot that stands, and look whether the chip is there and awake."""
        super().tick(now_s)
        self._chip.check()

    def _check_link(self) -> None:
        self._chip.check()

    def _send(self, levels: Mapping[int, int]) -> None:
        self._chip.write(levels)

    def _let_go(self) -> None:
        self._chip.let_go()


def _channels(motor: MotorOutputs) -> Sequence[int]:
    return [each for each in (motor.forward, motor.backward, motor.pwm) if each is not None]
