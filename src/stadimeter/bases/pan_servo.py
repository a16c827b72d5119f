"""A camera on a servo that turns it from side to side, on a channel of a PCA9685: a base that only turns.

A second servo may tilt it up and down: the same in every way, for the other axis.

A rule follows with it as with any base, and the camera turns with its target; without it, it searches by looking
around. The rate of turn that is commanded is added up to an angle here, and the angle is a pulse: a servo goes to an
angle and stays there. **It does not say where it is.** So the first command that turns either sends both straight ahead
first, from wherever they are, as fast as they can; after that they are where their last pulses put them, also when the
bus was gone meanwhile.

It stops as soon as its angle no longer changes: when this computer dies too. Pulses end half a second later, and at
once when it is stopped: friction holds a small camera. Pulses from a pin of the Pi would do as well, but lgpio makes
them in whole percents of 20 ms, which are 18° each.
"""

from __future__ import annotations

import math
from typing import ClassVar, Self

from msgspec import Struct
from msgspec.structs import replace
from pydantic import Field, model_validator

from stadimeter.bases.pca9685 import FULL, Channel, Pca9685, bus_number, i2c_lacks, stop_writes
from stadimeter.config.plugins import PORTS, DriverContext, DriverOptions, I2cStop, OptionsTable, driver_names
from stadimeter.config.units import Angle, Duration
from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.core.liveness import MAX_TRACK_WIDTH_M
from stadimeter.errors import DeviceClosedError

# What every analogue servo is made for; digital ones take it too.
PULSES_HZ = 50.0

# From the end of its travel, at the 0.2 s for 60° of a slow servo, with some time to settle.
CENTRES_S = 0.8

# A servo that holds an angle hums and gets warm.
PULSES_END_AFTER_S = 0.5

# After a longer time without a look it goes on from where it stood: nothing was sent, and the frames are old.
MAX_STEP_S = 0.1

# Servos take pulses within this, 1 to 2 ms for sure.
MIN_PULSE_S, MAX_PULSE_S = 0.0004, 0.0026

# Of what is straight above or below, no turn brings it to the middle; beyond this and half a view it may be.
MAX_TILT_RAD = math.radians(60)


class ServoTravel(Struct, frozen=True, kw_only=True):
    """The travel of a servo by its pulses. Angles are from straight ahead, positive to the left and upwards.

    Attributes:
        ends_rad: The lowest angle and the highest.
        pulses_s: The pulses there.
    """

    channel: int
    ends_rad: tuple[float, float]
    pulses_s: tuple[float, float]

    def wrong(self, names: str, most_rad: float) -> str:
        """Describe the fault in its figures, in words; empty for none."""
        low_rad, high_rad = self.ends_rad
        if not (0 < -low_rad <= most_rad and 0 < high_rad <= most_rad):
            return f"{names} are angles from straight ahead, above 0 and up to {math.degrees(most_rad):.0f} deg"
        if abs(self.pulses_s[0] - self.pulses_s[1]) < 1e-4:
            return f"the pulses for {names} are the same: the servo would not turn"
        return ""

    def pulse_s(self, angle_rad: float) -> float:
        """Return the pulse for an angle."""
        (low_rad, high_rad), (low_s, high_s) = self.ends_rad, self.pulses_s
        return low_s + (angle_rad - low_rad) / (high_rad - low_rad) * (high_s - low_s)

    def angle_rad(self, pulse_s: float) -> float:
        """Return where a pulse makes it point."""
        (low_rad, high_rad), (low_s, high_s) = self.ends_rad, self.pulses_s
        return low_rad + (pulse_s - low_s) / (high_s - low_s) * (high_rad - low_rad)

    def within(self, angle_rad: float) -> float:
        """Return an angle, or the end of the travel before it."""
        return min(max(angle_rad, self.ends_rad[0]), self.ends_rad[1])


class TiltServoOptions(OptionsTable):
    """A second servo, which tilts the camera."""

    channel: Channel = 1
    """The channel of the servo on the board."""
    up: Angle = math.pi / 4
    """How far it tilts up from level."""
    down: Angle = math.pi / 4
    """The same down."""
    up_pulse: Duration = Field(default=0.002, ge=MIN_PULSE_S, le=MAX_PULSE_S)
    """The pulse that points it to the upper end."""
    down_pulse: Duration = Field(default=0.001, ge=MIN_PULSE_S, le=MAX_PULSE_S)
    """The pulse for the lower end; longer than the other where the servo is mounted the other way round."""

    @model_validator(mode="after")
    def _has_a_range(self) -> Self:
        if words := self.travel().wrong("up and down", MAX_TILT_RAD):
            raise ValueError(words)
        return self

    def travel(self) -> ServoTravel:
        """Return its travel."""
        return ServoTravel(
            channel=self.channel, ends_rad=(-self.down, self.up), pulses_s=(self.down_pulse, self.up_pulse)
        )


class PanServoOptions(DriverOptions):
    """The options of a camera on one servo, or on two, on a PCA9685 board. Such a base turns and drives nowhere."""

    title: ClassVar = "a camera on a pan servo, or on two that tilt it too (PCA9685): it drives nowhere"
    emulator: ClassVar = "emulated-pca9685"
    auto_stop_advice: ClassVar = "nothing is needed: it stands when nothing comes"
    only_turns: ClassVar[bool] = True

    port: str = "/dev/i2c-1"
    """The I2C bus, or ``emulated-pca9685``."""
    address: int = Field(default=0x40, ge=0x08, le=0x77)
    """Of the chip, 7 bits."""
    channel: Channel = Field(default=0, examples=[0])
    """The channel of the servo on the board."""
    left: Angle = math.pi / 4
    """How far it turns to the left of straight ahead."""
    right: Angle = math.pi / 4
    """The same to the right."""
    left_pulse: Duration = Field(default=0.002, ge=MIN_PULSE_S, le=MAX_PULSE_S)
    """The pulse that points it to the left end."""
    right_pulse: Duration = Field(default=0.001, ge=MIN_PULSE_S, le=MAX_PULSE_S)
    """The pulse for the right end; longer than the other where the servo is mounted the other way round."""
    tilt: TiltServoOptions | None = None
    """A second servo, which tilts the camera; left out where there is none."""

    @model_validator(mode="after")
    def _has_a_range(self) -> Self:
        if words := self.travels()[0].wrong("left and right", math.pi / 2):
            raise ValueError(words)
        if self.tilt is not None and self.tilt.channel == self.channel:
            raise ValueError(f"channel {self.channel} is named twice; each servo needs its own")
        if not self.is_simulated() and bus_number(self.port) is None:
            raise ValueError(f"{self.port!r} is not an I2C bus; write it such as '/dev/i2c-1'")
        return self

    def travels(self) -> tuple[ServoTravel, ...]:
        """Return the travel of the servo that turns it, and of the one that tilts it, if there is one."""
        pan = ServoTravel(
            channel=self.channel, ends_rad=(-self.right, self.left), pulses_s=(self.right_pulse, self.left_pulse)
        )
        return (pan,) if self.tilt is None else (pan, self.tilt.travel())

    def build(self, context: DriverContext) -> PanServoBase:
        """Return the base."""
        return PanServoBase(self, context)

    def is_simulated(self) -> bool:
        """Check whether the chip is an emulated one."""
        return self.port in driver_names(PORTS)

    def lacks(self) -> tuple[str, ...]:
        """List the things that keep the bus from being opened."""
        return () if self.is_simulated() else i2c_lacks(self.port)

    def stops_by_itself_after_s(self) -> float:
        """Return for how long it goes on to the angle of its last pulse."""
        return MAX_STEP_S

    def i2c_stop(self) -> I2cStop | None:
        """Return the write that ends its pulses."""
        return stop_writes(self.port, self.address)


class PanServoBase:
    """A `MobileBase` that turns a camera, and tilts it where it can, and drives nowhere."""

    def __init__(self, options: PanServoOptions, context: DriverContext) -> None:
        self._travels = options.travels()
        self._name = context.name
        self._clock = context.clock
        self._chip = Pca9685(context, options.port, options.address, PULSES_HZ)
        # Where the last pulses put its servos; None while that is not known.
        self._sent_rad: list[float] | None = None
        self._begin()

    def _begin(self) -> None:
        self._angles_rad = self._sent_rad
        self._centred_s = math.inf if self._sent_rad is None else -math.inf
        self._rates_radps = [0.0] * len(self._travels)
        self._turned_s = -math.inf
        self._step_s = 0.0
        self._written = self._levels(holds=False)

    def open(self) -> None:
        """Find the chip and end every pulse: nothing turns. Does nothing when open; errors as of `Pca9685.open`."""
        if self._chip.is_open:
            return
        emulated = self._chip.open()
        if emulated is not None:
            emulated.wire_servos([(each.channel, each.angle_rad) for each in self._travels])
        self._begin()

    def apply(self, command: TwistCommand) -> TwistCommand:
        """Turn and tilt at the commanded rates from now on.

        The rates returned are 0 while it goes straight ahead for the first time, and at an end of its travel; so is the
        speed. Raises `LinkLostError` if the chip is gone.
        """
        now_s = self._move_on()
        self._rates_radps = [command.angular_radps, command.tilt_radps][: len(self._travels)]
        if not any(self._rates_radps):
            self._break_off_centring(now_s)
        elif self._angles_rad is None:
            self._angles_rad = [0.0] * len(self._travels)
            self._centred_s = self._turned_s = now_s + CENTRES_S
        pan_radps, tilt_radps = [*self._turning_radps(now_s), 0.0][:2]
        return replace(command, linear_mps=0.0, angular_radps=pan_radps, tilt_radps=tilt_radps)

    def tick(self, now_s: float) -> None:
        """Turn on, end its pulses when it has stood for a while, and look whether the chip is there."""
        now_s = self._move_on()
        if self._angles_rad is not None:
            holds = now_s - self._turned_s < PULSES_END_AFTER_S
            self._write(self._levels(holds=holds))
            if holds and now_s >= self._centred_s:
                self._sent_rad = self._angles_rad
        self._chip.check()

    def report(self) -> BaseReport | None:
        """Return by how much it has turned, as the wheels of a base would that turns likewise; None before that."""
        if self._angles_rad is None:
            return None
        side_m = self._angles_rad[0] * MAX_TRACK_WIDTH_M / 2
        tilt_rad = self._angles_rad[1] if len(self._travels) > 1 else None
        return BaseReport(at_s=self._step_s, left_m=-side_m, right_m=side_m, camera_tilt_rad=tilt_rad)

    def stop(self) -> None:
        """End its pulses at once: friction holds it where it is. Does nothing when closed."""
        self._rates_radps = [0.0] * len(self._travels)
        if self._chip.is_open:
            self._break_off_centring(self._clock.now_s())
            self._turned_s = -math.inf
            self._written = {}  # whatever was written before
            self._write(self._levels(holds=False))

    def close(self) -> None:
        """End its pulses and let go of the bus, even if that fails. May be called any number of times."""
        self._chip.let_go()

    def _break_off_centring(self, now_s: float) -> None:
        """Forget where it is unless it has arrived straight ahead: what shall stand does not go on there."""
        if now_s < self._centred_s < math.inf:
            self._angles_rad, self._centred_s, self._turned_s = None, math.inf, -math.inf
            self._write(self._levels(holds=False))

    def _turning_radps(self, now_s: float) -> list[float]:
        """Return the speed at which it turns now, positive to the left, and tilts, positive upwards."""
        if self._angles_rad is None or now_s < self._centred_s:
            return [0.0] * len(self._travels)
        each = zip(self._travels, self._angles_rad, self._rates_radps, strict=True)
        return [0.0 if angle_rad == travel.ends_rad[radps > 0] else radps for travel, angle_rad, radps in each]

    def _move_on(self) -> float:
        """Add up what it has turned since the last look; return the time."""
        if not self._chip.is_open:
            raise DeviceClosedError(f"the base '{self._name}' is not open")
        now_s = self._clock.now_s()
        step_s, self._step_s = now_s - self._step_s, now_s
        turning_radps = self._turning_radps(now_s)
        if self._angles_rad is not None and any(turning_radps) and step_s <= MAX_STEP_S:
            each = zip(self._travels, self._angles_rad, turning_radps, strict=True)
            self._angles_rad = [travel.within(angle_rad + radps * step_s) for travel, angle_rad, radps in each]
            self._turned_s = now_s
        return now_s

    def _levels(self, *, holds: bool) -> dict[int, int]:
        """Return the levels that the channels shall have: the pulses for where it shall point, or none."""
        if not holds or self._angles_rad is None:
            return {travel.channel: 0 for travel in self._travels}
        each = zip(self._travels, self._angles_rad, strict=True)
        return {travel.channel: round(FULL * PULSES_HZ * travel.pulse_s(angle_rad)) for travel, angle_rad in each}

    def _write(self, levels: dict[int, int]) -> None:
        if levels != self._written:
            self._chip.write(levels)
            self._written = levels
