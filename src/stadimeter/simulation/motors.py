"""Motors and servos on pins and behind a PCA9685 on an I2C bus, which is emulated down to its registers.

What is as in the chip: registers and their values after power-up, the pointer that moves on only with AI, the prescaler
that is taken only asleep, pulses that stand still asleep and resume by RESTART, ``ALL_LED`` registers that are written
only, and that it goes on pulsing as before when the host is gone. Source: NXP's data sheet PCA9685, rev. 4.
"""

from __future__ import annotations

import errno
import math
from collections.abc import Callable, Sequence
from functools import partial

from gpiozero.pins.mock import MockFactory, MockPWMPin

from stadimeter.bases.protocol import MotorOutputs
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.core.clock import Clock
from stadimeter.simulation.emulated_base import SERVED_EVERY_S, EmulatedWheel
from stadimeter.simulation.motion import DifferentialRobot
from stadimeter.simulation.world import World, shared_world

_MODE1, _CHANNEL_0, _CHANNELS_END, _ALL_0, _PRESCALE = 0x00, 0x06, 0x46, 0xFA, 0xFE
_RESTART, _AUTO_INCREMENT, _SLEEP = 0x80, 0x20, 0x10
_POWER_UP = {0x00: 0x11, 0x01: 0x04, 0x02: 0xE2, 0x03: 0xE4, 0x04: 0xE8, 0x05: 0xE0, _PRESCALE: 0x1E}
_FULL = 0x1000
_OSCILLATOR_HZ = 25e6


class Pca9685Chip:
    """The chip's registers, as a function of what is written."""

    def __init__(self) -> None:
        self.power_up()

    def power_up(self) -> None:
        """Begin anew: asleep, every channel off."""
        self.registers = bytearray(256)
        for register, value in _POWER_UP.items():
            self.registers[register] = value
        for channel in range(16):
            self.registers[_CHANNEL_0 + 4 * channel + 3] = _FULL >> 8
        self._pointer = 0
        self._waits_for_restart = False

    def take(self, data: bytes) -> None:
        """Take a transfer: the number of a register, and what is written from there on."""
        if data:
            self._pointer = data[0]
        for value in data[1:]:
            self._write(self._pointer, value)
            self._move_on()

    def give(self, count: int) -> bytes:
        """Return the bytes a read transfer gets; the registers of all channels at once read as 0."""
        given = bytearray()
        for _ in range(count):
            is_readable = not _ALL_0 <= self._pointer < _PRESCALE
            given.append(self.registers[self._pointer] if is_readable else 0)
            self._move_on()
        return bytes(given)

    def duty(self, channel: int) -> float:
        """Return for which share of the time a channel is high."""
        at = _CHANNEL_0 + 4 * channel
        begins, ends = (int.from_bytes(self.registers[at + each : at + each + 2], "little") for each in (0, 2))
        if ends & _FULL or self.registers[_MODE1] & _SLEEP or self._waits_for_restart:
            return 0.0
        return 1.0 if begins & _FULL else ((ends - begins) % _FULL) / _FULL

    def pulse_s(self, channel: int) -> float:
        """Return for how long a channel is high in each period."""
        return self.duty(channel) * _FULL * (self.registers[_PRESCALE] + 1) / _OSCILLATOR_HZ

    def _move_on(self) -> None:
        if self.registers[_MODE1] & _AUTO_INCREMENT:
            self._pointer = 0 if self._pointer == _CHANNELS_END - 1 else (self._pointer + 1) % 256

    def _write(self, register: int, value: int) -> None:
        if register == _MODE1:
            self._set_mode(value)
        elif register == _PRESCALE:
            if self.registers[_MODE1] & _SLEEP:
                self.registers[_PRESCALE] = max(3, value)
        elif _ALL_0 <= register < _PRESCALE:
            for at in range(_CHANNEL_0 + register - _ALL_0, _CHANNELS_END, 4):
                self.registers[at] = value
            self._resume()
        else:
            self.registers[register] = value
            if _CHANNEL_0 <= register < _CHANNELS_END:
                self._resume()

    def _set_mode(self, value: int) -> None:
        before = self.registers[_MODE1]
        if value & _SLEEP and not before & _SLEEP and any(map(self.duty, range(16))):
            self._waits_for_restart = True
        elif value & _RESTART and not before & _SLEEP and not value & _SLEEP:
            self._waits_for_restart = False
        self.registers[_MODE1] = (value & ~_RESTART) | (_RESTART if self._waits_for_restart else 0)

    def _resume(self) -> None:
        self._waits_for_restart = False
        self.registers[_MODE1] &= ~_RESTART


class EmulatedPca9685:
    """The chip on a bus, its channels turning the wheels of the simulated robot, or the servos below its camera.

    Attributes:
        is_held: Fault: something holds the clock of the bus low, so that every transfer times out.
    """

    def __init__(self, world: World, clock: Clock) -> None:
        self.chip = Pca9685Chip()
        self.is_held = False
        self._world = world
        self._clock = clock
        self._driven: list[HBridgeMotors | EmulatedServo] = []

    def wire(self, left: Sequence[MotorOutputs], right: Sequence[MotorOutputs], enable: int | None = None) -> None:
        """Connect motors to channels."""
        self.unwire()
        motors = HBridgeMotors(self._world, self._clock, self.chip.duty)
        motors.wire(left, right, enable)
        self._driven = [motors]

    def wire_servos(self, servos: Sequence[tuple[int, Callable[[float], float]]]) -> None:
        """Connect the servo that turns the camera, and perhaps one that tilts it.

        Args:
            servos: The channel of each, and the angle for its pulses in seconds.
        """
        self.unwire()
        self._driven = [
            EmulatedServo(body, self._clock, partial(self.chip.pulse_s, channel), angle_rad)
            for body, (channel, angle_rad) in zip((self._world.robot, self._world.tilt_joint), servos, strict=False)
        ]

    def unwire(self) -> None:
        """Turn nothing any more."""
        for each in self._driven:
            each.close()
        self._driven = []

    def write(self, data: bytes) -> None:
        """Take a transfer, unless the cable is out."""
        self._reach()
        for each in self._driven:
            each.serve(self._clock.now_s())
        self.chip.take(data)

    def read(self, count: int) -> bytes:
        """Answer a read, unless the cable is out."""
        self._reach()
        return self.chip.give(count)

    def close(self) -> None:
        """Let the host go away: the chip goes on as before."""

    def _reach(self) -> None:
        if self._world.faults.base_unplugged:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        if self.is_held:
            raise OSError(errno.ETIMEDOUT, "Connection timed out")


class EmulatedPca9685Options(DriverOptions):
    """The emulated chip has no table in the configuration: a base names it as its port."""

    @classmethod
    def device(cls, context: DriverContext) -> EmulatedPca9685:
        """Return the run's emulated chip; the first to ask connects it to the world's robot."""

        def connect() -> EmulatedPca9685:
            device = EmulatedPca9685(shared_world(context), context.clock)
            context.at_end(device.unwire)
            return device

        return context.share("emulated PCA9685", connect)

    def build(self, context: DriverContext) -> EmulatedPca9685:
        """Return the emulated chip."""
        return self.device(context)


# A servo below the camera of the simulated robot: it turns the robot on the spot, which the camera sees alike ---
#
# One that tilts the camera turns the joint of the world that does so.


# Small servos turn 60° in 0.1 to 0.2 s without a load, and slow down over the last degrees.
FASTEST_RADPS = 5.0
SETTLES_S = 0.03


class EmulatedServo:
    """A servo. Without pulses friction holds it where it is.

    Args:
        body: What it turns, straight ahead as it was at the start.
        pulse_s: How long its pulses are now; 0 for none.
        angle_rad: Where a pulse, in seconds, makes it point, from straight ahead.
    """

    def __init__(
        self, body: DifferentialRobot, clock: Clock, pulse_s: Callable[[], float], angle_rad: Callable[[float], float]
    ) -> None:
        self._body = body
        self._pulse_s = pulse_s
        self._angle_rad = angle_rad
        self.close = clock.call_every(SERVED_EVERY_S, self.serve)

    def serve(self, now_s: float) -> None:  # noqa: ARG002 - the body has the same clock
        """Turn on towards where it shall point."""
        turn_radps = 0.0
        if pulse_s := self._pulse_s():
            left_rad = self._angle_rad(pulse_s) + self._body.start.heading_rad - self._body.pose.heading_rad
            turn_radps = min(max(left_rad / SETTLES_S, -FASTEST_RADPS), FASTEST_RADPS)
        side_mps = turn_radps * self._body.track_width_m / 2
        self._body.drive_wheels(-side_mps, side_mps)


# Motors behind H-bridges in the simulated world: the levels of outputs turn the wheels of the simulated robot ---
#
# A wheel approaches the speed that its motor is driven at with a time constant: slowly where the motor coasts, at
# once where it is short-circuited. The wiring is what the driver's configuration says, unless a test mixes up the
# wires.


# What an emulated car's motors do, as a small gear motor of 6 V with a wheel of 65 mm does on a fresh battery.
FULL_DUTY_MPS = 0.6
STARTS_AT_DUTY = 0.25
DRIVEN_S, BRAKED_S, COASTING_S = 0.1, 0.03, 0.15

_HIGH = 0.5


class HBridgeMotors:
    """The motors of a car, behind outputs whose level is asked for as time passes.

    Args:
        level: The level of an output, from 0, low, to 1, high; that of pulses is their duty.
    """

    def __init__(self, world: World, clock: Clock, level: Callable[[int], float]) -> None:
        self._world = world
        self._level = level
        self._sides: list[list[tuple[MotorOutputs, EmulatedWheel]]] = [[], []]
        self._enable: int | None = None
        self._now_s = clock.now_s()
        self.close = clock.call_every(SERVED_EVERY_S, self.serve)

    def wire(self, left: Sequence[MotorOutputs], right: Sequence[MotorOutputs], enable: int | None = None) -> None:
        """Connect the motors of each side, and an output that must be high for any of them to run."""
        self._sides = [[(motor, EmulatedWheel()) for motor in side] for side in (left, right)]
        self._enable = enable

    def serve(self, now_s: float) -> None:
        """Turn the wheels until now at the levels that there are. Call it before a level changes, too."""
        seconds, self._now_s = max(0.0, now_s - self._now_s), max(now_s, self._now_s)
        for side in self._sides:
            for motor, wheel in side:
                duty = self._duty(motor)
                turns = max(0.0, abs(duty) - STARTS_AT_DUTY) / (1 - STARTS_AT_DUTY)
                wheel.driven_mps = math.copysign(turns * FULL_DUTY_MPS, duty)
                wheel.turn(seconds, BRAKED_S if self._is_shorted(motor) else DRIVEN_S if duty else COASTING_S)
        speeds = [[wheel.speed_mps for _, wheel in side] or [0.0] for side in self._sides]
        left_mps, right_mps = (sum(each) / len(each) for each in speeds)
        self._world.robot.drive_wheels(left_mps, right_mps)

    def _is_enabled(self) -> bool:
        return self._enable is None or self._level(self._enable) > _HIGH

    def _duty(self, motor: MotorOutputs) -> float:
        """Return the strength at which a motor is driven, -1 to 1, as an average over the pulses."""
        if not self._is_enabled():
            return 0.0
        strength = 1.0 if motor.pwm is None else self._level(motor.pwm)
        if motor.backward is None:
            return strength if self._level(motor.forward) > _HIGH else -strength
        return strength * (self._level(motor.forward) - self._level(motor.backward))

    def _is_shorted(self, motor: MotorOutputs) -> bool:
        if not self._is_enabled() or (motor.pwm is not None and not self._level(motor.pwm)):
            return False
        inputs = [self._level(each) > _HIGH for each in (motor.forward, motor.backward) if each is not None]
        return len(inputs) == 2 and all(inputs)


class EmulatedMotorPins:
    """Pins in memory with motors on them."""

    def __init__(self, world: World, clock: Clock) -> None:
        self.factory = MockFactory(pin_class=MockPWMPin)
        self._motors = HBridgeMotors(world, clock, lambda pin: float(self.factory.pin(pin).state))
        self.wire = self._motors.wire

    def close(self) -> None:
        """Let the wheels roll no more, and give the pins back."""
        self._motors.close()
        self.factory.close()


class EmulatedMotorPinsOptions(DriverOptions):
    """The emulated pins have no table in the configuration: a base names them as its port."""

    def build(self, context: DriverContext) -> EmulatedMotorPins:
        """Return the run's emulated pins, which turn the wheels of the world's robot."""

        def connect() -> EmulatedMotorPins:
            pins = EmulatedMotorPins(shared_world(context), context.clock)
            context.at_end(pins.close)
            return pins

        return context.share("emulated motor pins", connect)
