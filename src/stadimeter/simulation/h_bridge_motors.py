"""Motors behind H-bridges in the simulated world: the levels of outputs turn the wheels of the simulated robot.

A wheel approaches the speed that its motor is driven at with a time constant: slowly where the motor coasts, at once
where it is short-circuited. The wiring is what the driver's configuration says, unless a test mixes up the wires.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from gpiozero.pins.mock import MockFactory, MockPWMPin

from stadimeter.bases.protocol import MotorOutputs
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.core.clock import Clock
from stadimeter.simulation.emulated_base import EmulatedWheel
from stadimeter.simulation.emulated_port import SERVED_EVERY_S
from stadimeter.simulation.world import World, shared_world

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
