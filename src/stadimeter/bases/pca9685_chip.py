"""A PCA9685 on an I2C bus: sixteen channels that pulse as they were last written.

**The chip does not stop by itself.** It goes on pulsing as it was written last when the host dies, until it is written
again or loses its power, and a chip that was put to sleep resumes when it is woken. So every channel is switched off
when it is opened and let go, and `stop_writes` says how anybody else does it.

Registers as in NXP's data sheet PCA9685 (rev. 4), section 7.3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from stadimeter.bases.i2c_link import I2cLink, bus_number
from stadimeter.config.plugins import PORTS, DriverContext, I2cStop, driver_names, load_driver
from stadimeter.errors import DeviceOpenError, LinkLostError

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
