"""A camera on a servo that turns it from side to side, on a channel of a PCA9685: a base that only turns.

A rule follows with it as with any base, and the camera turns with its target; without it, it searches by looking
around. The rate of turn that is commanded is added up to an angle here, and the angle is a pulse: a servo goes to an
angle and stays there. **It does not say where it is.** So the first command that turns it sends it straight ahead
first, from wherever it is, as fast as it can; after that it is where its last pulse put it.

It stops as soon as its angle no longer changes: when this computer dies too. Pulses end half a second later, and at
once when it is stopped: friction holds a small camera. Pulses from a pin of the Pi would do as well, but lgpio makes
them in whole percents of 20 ms, which are 18° each.
"""

from __future__ import annotations

import math
from typing import ClassVar, Self

from msgspec.structs import replace
from pydantic import Field, model_validator

from stadimeter.bases.i2c_link import bus_number, i2c_lacks
from stadimeter.bases.pca9685_chip import FULL, Channel, Pca9685, stop_writes
from stadimeter.config.plugins import PORTS, DriverContext, DriverOptions, I2cStop, driver_names
from stadimeter.config.units import Angle, Duration
from stadimeter.core.base_report import BaseReport
from stadimeter.core.command import TwistCommand
from stadimeter.core.ego_motion import MAX_TRACK_WIDTH_M
from stadimeter.errors import DeviceClosedError

# What every analogue servo is made for; digital ones take it too.
PULSES_HZ = 50.0

# From the end of its travel, at the 0.2 s for 60° of a slow servo, with some time to settle.
CENTRES_S = 0.8

# A servo that holds an angle hums and gets warm.
PULSES_END_AFTER_S = 0.5

# Of a longer time between two looks no more counts as turned.
MAX_STEP_S = 0.1

# Servos take pulses within this, 1 to 2 ms for sure.
MIN_PULSE_S, MAX_PULSE_S = 0.0004, 0.0026


class PanServoOptions(DriverOptions):
    """The table of such a base in the configuration."""

    title: ClassVar = "a camera on a pan servo (PCA9685): it turns, and drives nowhere"
    auto_stop_advice: ClassVar = "nothing is needed: it stands when nothing comes"
    only_turns: ClassVar[bool] = True

    port: str = "/dev/i2c-1"
    """The I2C bus, or ``emulated-pca9685``."""
    address: int = Field(default=0x40, ge=0x08, le=0x77)
    """Of the chip, 7 bits."""
    channel: Channel = Field(default=0, examples=[0])
    """The servo's."""
    left: Angle = math.pi / 4
    """How far it turns to the left of straight ahead."""
    right: Angle = math.pi / 4
    """The same to the right."""
    left_pulse: Duration = Field(default=0.002, ge=MIN_PULSE_S, le=MAX_PULSE_S)
    """The pulse that points it to the left end."""
    right_pulse: Duration = Field(default=0.001, ge=MIN_PULSE_S, le=MAX_PULSE_S)
    """The pulse for the right end; longer than the other where the servo is mounted the other way round."""

    @model_validator(mode="after")
    def _has_a_range(self) -> Self:
        if not (0 < self.left <= math.pi / 2 and 0 < self.right <= math.pi / 2):
            raise ValueError("left and right are angles from straight ahead, above 0 and up to 90 deg")
        if abs(self.left_pulse - self.right_pulse) < 1e-4:
            raise ValueError("left_pulse and right_pulse are the same: the servo would not turn")
        if not self.is_simulated() and bus_number(self.port) is None:
            raise ValueError(f"{self.port!r} is not an I2C bus; write it such as '/dev/i2c-1'")
        return self

    def pulse_s(self, heading_rad: float) -> float:
        """Return the pulse for an angle, positive to the left of straight ahead."""
        share = (heading_rad + self.right) / (self.left + self.right)
        return self.right_pulse + share * (self.left_pulse - self.right_pulse)

    def heading_rad(self, pulse_s: float) -> float:
        """Return where a pulse makes it point, positive to the left of straight ahead."""
        share = (pulse_s - self.right_pulse) / (self.left_pulse - self.right_pulse)
        return share * (self.left + self.right) - self.right

    def build(self, context: DriverContext) -> PanServoBase:
        """Return the base."""
        return PanServoBase(self, context)

    def is_simulated(self) -> bool:
        """Return whether the chip is an emulated one."""
        return self.port in driver_names(PORTS)

    def lacks(self) -> tuple[str, ...]:
        """Return what keeps the bus from being opened."""
        return () if self.is_simulated() else i2c_lacks(self.port)

    def stops_by_itself_after_s(self) -> float:
        """Return for how long it goes on to the angle of its last pulse."""
        return MAX_STEP_S

    def i2c_stop(self) -> I2cStop | None:
        """Return the write that ends its pulses."""
        return stop_writes(self.port, self.address)


class PanServoBase:
    """A `MobileBase` that turns a camera, and drives nowhere."""

    def __init__(self, options: PanServoOptions, context: DriverContext) -> None:
        self._options = options
        self._name = context.name
        self._clock = context.clock
        self._chip = Pca9685(context, options.port, options.address, PULSES_HZ)
        self._begin()

    def _begin(self) -> None:
        self._heading_rad: float | None = None  # not known before it was sent straight ahead
        self._centred_s = math.inf
        self._rate_radps = 0.0
        self._turned_s = -math.inf
        self._step_s = 0.0
        self._written = 0

    def open(self) -> None:
        """Find the chip and end every pulse: nothing turns. Does nothing when open; errors as of `Pca9685.open`."""
        if self._chip.is_open:
            return
        emulated = self._chip.open()
        if emulated is not None:
            emulated.wire_servo(self._options.channel, self._options.heading_rad)
        self._begin()

    def apply(self, command: TwistCommand) -> TwistCommand:
        """Turn at the commanded rate from now on.

        The rate returned is 0 while it goes straight ahead for the first time, and at an end of its travel; so is the
        speed. Raises `LinkLostError` if the chip is gone.
        """
        now_s = self._move_on()
        self._rate_radps = command.angular_radps
        if not self._rate_radps:
            self._break_off_centring(now_s)
        elif self._heading_rad is None:
            self._heading_rad = 0.0
            self._centred_s = now_s + CENTRES_S
            self._turned_s = self._centred_s
        return replace(command, linear_mps=0.0, angular_radps=self._turning_radps(now_s))

    def tick(self, now_s: float) -> None:
        """Turn on, end its pulses when it has stood for a while, and look whether the chip is there."""
        now_s = self._move_on()
        heading_rad = self._heading_rad
        if heading_rad is not None:
            holds = now_s - self._turned_s < PULSES_END_AFTER_S
            self._write(round(FULL * PULSES_HZ * self._options.pulse_s(heading_rad)) if holds else 0)
        self._chip.check()

    def report(self) -> BaseReport | None:
        """Return by how much it has turned, as the wheels of a base would that turns likewise; None before that."""
        if self._heading_rad is None:
            return None
        side_m = self._heading_rad * MAX_TRACK_WIDTH_M / 2
        return BaseReport(at_s=self._step_s, left_m=-side_m, right_m=side_m)

    def stop(self) -> None:
        """End its pulses at once: friction holds it where it is. Does nothing when closed."""
        self._rate_radps = 0.0
        if self._chip.is_open:
            self._break_off_centring(self._clock.now_s())
            self._turned_s = -math.inf
            self._written = FULL  # whatever was written before
            self._write(0)

    def close(self) -> None:
        """End its pulses and let go of the bus, even if that fails. May be called any number of times."""
        self._chip.let_go()

    def _break_off_centring(self, now_s: float) -> None:
        """Forget where it is unless it has arrived straight ahead: what shall stand does not go on there."""
        if now_s < self._centred_s < math.inf:
            self._heading_rad, self._centred_s, self._turned_s = None, math.inf, -math.inf
            self._write(0)

    def _turning_radps(self, now_s: float) -> float:
        """Return how fast it turns now, positive to the left."""
        if self._heading_rad is None or now_s < self._centred_s:
            return 0.0
        is_at_end = self._heading_rad == (self._options.left if self._rate_radps > 0 else -self._options.right)
        return 0.0 if is_at_end else self._rate_radps

    def _move_on(self) -> float:
        """Add up what it has turned since the last look; return the time."""
        if not self._chip.is_open:
            raise DeviceClosedError(f"the base '{self._name}' is not open")
        now_s = self._clock.now_s()
        step_s, self._step_s = min(now_s - self._step_s, MAX_STEP_S), now_s
        turned_rad = self._turning_radps(now_s) * step_s
        if self._heading_rad is not None and turned_rad:
            self._heading_rad = min(max(self._heading_rad + turned_rad, -self._options.right), self._options.left)
            self._turned_s = now_s
        return now_s

    def _write(self, level: int) -> None:
        if level != self._written:
            self._chip.write({self._options.channel: level})
            self._written = level
