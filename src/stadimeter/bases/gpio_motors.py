"""A base of two motors behind H-bridges on GPIO pins: L298N, TB6612, DRV8833, L9110 and the like.

**This base does not stop by itself.** A Raspberry Pi keeps a pin at its last level when the program is killed, and a
pulsed pin stays low or high as it happens to be. What makes the pins low then is the watchdog process or
``safe-outputs``; what helps while the Pi boots, and once pins were let go, is a resistor to ground at each input.

An L298N that is enabled brakes while both of its inputs are low, and heats (gpiozero issue 1233: `gpiozero.Motor`
leaves it so). Here every output is low at rest, ``pwm`` and ``enable`` too.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from typing import Annotated, ClassVar, Self

from gpiozero.pins.pi import PiFactory
from msgspec.structs import replace
from pydantic import AfterValidator, Field, model_validator

from stadimeter.bases.protocol import DifferentialDrive, Motion, MotorOutputs, WheelSpeeds
from stadimeter.config.plugins import PORTS, DriverContext, DriverOptions, OptionsTable, driver_names, load_driver
from stadimeter.config.units import Duration, Frequency, Length, Pin, Speed
from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.errors import DeviceClosedError, DriverError, LinkLostError
from stadimeter.gpio.output_pin import FULL_PERCENT, MIN_PULSES_HZ, OutputPin, pins_lack, shared_pin_factory

# Bases whose motors hang on H-bridges: from wheel speeds to the levels of outputs. Pins and chips drive the
# outputs.
#
# The speed of a wheel is taken as linear in the duty: none at ``minimum_duty``, where the motor only just does not
# turn, and ``max_wheel_speed`` at full duty. Gear motors without encoders keep to that within a tenth or two while
# the battery does; what remains is corrected by the rule that follows, since it sees the target.
#
# **Nothing here stops by itself.** Outputs keep their level when this program is gone.


def _check_speed(speed_mps: float) -> float:
    if speed_mps == 0:
        raise ValueError("a base whose wheels cannot turn goes nowhere; measure their speed at full duty")
    return speed_mps


class MotorTable(OptionsTable):
    """The inputs of one motor; drivers declare them as pins or as channels."""

    forward: int | None = None
    backward: int | None = None
    direction: int | None = None
    pwm: int | None = None

    @model_validator(mode="after")
    def _check_inputs(self) -> Self:
        named = {name for name in ("forward", "backward", "direction", "pwm") if getattr(self, name) is not None}
        if named not in ({"forward", "backward"}, {"forward", "backward", "pwm"}, {"direction", "pwm"}):
            raise ValueError(
                f"{', '.join(sorted(named)) or 'nothing'} is named; a motor needs forward and backward, "
                "both and pwm, or direction and pwm"
            )
        return self

    def outputs(self) -> MotorOutputs:
        """Return the connections of the motor."""
        first = self.direction if self.forward is None else self.forward
        assert first is not None  # noqa: S101 - as checked above
        return MotorOutputs(forward=first, backward=self.backward, pwm=self.pwm)


class HBridgeOptions(DriverOptions):
    """The options that every base on H-bridges has in its table of the configuration."""

    track_width: Length = Field(examples=["15 cm"])
    """Distance between the middles of the driven wheels."""
    max_wheel_speed: Annotated[Speed, AfterValidator(_check_speed)] = Field(examples=["0.6 m/s"])
    """The speed of a wheel at full duty. Keep the example for now; ``stadimeter drive`` measures it."""
    minimum_duty: float = Field(default=0.25, ge=0.0, le=0.9)
    """The duty, 0 to 1, at which the wheels only just do not turn, measured."""
    brake: Duration = Field(default=0.3, le=2.0)
    """How long motors are short-circuited when the robot shall stand; then every output is low, as a motor driver heats
    while it brakes. 0 lets them coast. Has no effect on motors with ``direction``."""
    swap_sides: bool = False
    """Whether the left motor drives the right wheel."""
    invert_left: bool = False
    """Whether the left wheel turns backwards when commanded forwards."""
    invert_right: bool = False
    """The same for the right wheel."""

    @property
    def auto_stop_advice(self) -> str:
        """Advice for the case that nothing stops the motors."""
        return "put a switch in the supply of the motors: nothing else stops them then"

    def stops_by_itself_after_s(self) -> float:
        """Return infinity: outputs keep their level."""
        return math.inf


class HBridgeBase(ABC):
    """A `MobileBase` on H-bridges. Outputs have levels from 0, low, to `full`, high; those between are pulses.

    Args:
        left: The motors that the configuration calls left; what drives on which side is up to ``swap_sides``.
        enable: An output that is high while the robot moves or brakes.
    """

    def __init__(
        self,
        options: HBridgeOptions,
        context: DriverContext,
        sides: tuple[Sequence[MotorOutputs], Sequence[MotorOutputs]],
        *,
        full: int,
        enable: int | None = None,
    ) -> None:
        self._options = options
        self._context = context
        self._sides = sides
        self._full = full
        self._enabled = {} if enable is None else {enable: full}
        self._minimum = round(options.minimum_duty * full)
        self._step_mps = options.max_wheel_speed / (full - self._minimum)
        self._drive = DifferentialDrive(track_width_m=options.track_width, max_wheel_mps=options.max_wheel_speed)
        self._written: dict[int, int] = {}
        self._writes = 0
        self._forget()

    @abstractmethod
    def open(self) -> None:
        """Take the outputs, all low."""

    @property
    @abstractmethod
    def is_open(self) -> bool:
        """True while the outputs are taken."""

    @abstractmethod
    def _send(self, levels: Mapping[int, int]) -> None:
        """Drive outputs: those that become low first. Raises `LinkLostError` once all that can become low are."""

    @abstractmethod
    def _check_link(self) -> None:
        """Raise `LinkLostError` if the outputs of a moving robot can no longer be driven."""

    @abstractmethod
    def _let_go(self) -> None:
        """Make every output low, whatever was written before, and release what is taken."""

    def apply(self, command: TwistCommand) -> TwistCommand:
        """Move as commanded.

        The speeds returned are those sent: limited along the same curve, and rounded to whole steps of the duty.

        Raises:
            LinkLostError: An output cannot be driven.
        """
        self._check_open()
        wheels = self._drive.wheels(Motion(linear_mps=command.linear_mps, angular_radps=command.angular_radps))
        left, right = round(wheels.left_mps / self._step_mps), round(wheels.right_mps / self._step_mps)
        if left or right:
            self._check_link()
            self._is_moving = True  # noted first: a write that fails half way may have moved it
            self._write({**self._moving(left, right), **self._enabled})
        else:
            self._come_to_rest()
        sent = self._drive.motion(WheelSpeeds(left_mps=left * self._step_mps, right_mps=right * self._step_mps))
        return replace(command, linear_mps=sent.linear_mps, angular_radps=sent.angular_radps, tilt_radps=0.0)

    def tick(self, now_s: float) -> None:  # noqa: ARG002 - the context's clock is the same
        """End the braking of a robot that stands. Raises `LinkLostError` if an output cannot be driven."""
        self._check_open()
        if not self._is_moving:
            self._come_to_rest()

    def report(self) -> BaseReport | None:
        """Return None: it has no sensors."""
        return None

    def stop(self) -> None:
        """Stand still at once, whatever was written before. Does nothing when closed."""
        if self.is_open:
            self._written = {}
            self._come_to_rest()

    def close(self) -> None:
        """Make every output low and release it, even if that fails. May be called any number of times."""
        if self.is_open:
            self._forget()
            self._let_go()

    def _forget(self) -> None:
        self._written = {}
        self._is_moving = False
        self._brakes_until_s = -math.inf

    def _check_open(self) -> None:
        if not self.is_open:
            raise DeviceClosedError(f"the base '{self._context.name}' is not open")

    def _come_to_rest(self) -> None:
        """Brake for a while, then make every output low."""
        now_s = self._context.clock.now_s()
        if self._is_moving:
            self._brakes_until_s = now_s + self._options.brake
        self._is_moving = False
        resting = dict.fromkeys((*self._moving(0, 0), *self._enabled), 0)
        if now_s >= self._brakes_until_s:
            self._write(resting)
            return
        try:
            self._write({**resting, **self._braking(), **self._enabled})
        except DriverError:
            self._brakes_until_s = -math.inf
            self._write(resting)  # with one of two inputs still high, the motor would run
            raise

    def _write(self, levels: Mapping[int, int]) -> None:
        """Drive outputs to levels; those that have theirs already are left alone.

        A signal may stop the robot from within `_send`, which then goes on with what it was at: nothing is known then.
        """
        changed = {output: level for output, level in levels.items() if self._written.get(output) != level}
        if not changed:
            return
        self._writes += 1
        begun = self._writes
        known, self._written = self._written, {}  # not known while it may fail
        self._send(changed)
        if self._writes == begun:
            self._written = {**known, **changed}
        else:
            self._written = {}

    def _moving(self, left: int, right: int) -> dict[int, int]:
        """Return the levels for wheels that shall turn with these steps of the duty above the minimum."""
        left = -left if self._options.invert_left else left
        right = -right if self._options.invert_right else right
        steps = (right, left) if self._options.swap_sides else (left, right)
        levels: dict[int, int] = {}
        for motors, step in zip(self._sides, steps, strict=True):
            for motor in motors:
                levels |= self._motor_levels(motor, step)
        return levels

    def _motor_levels(self, motor: MotorOutputs, step: int) -> dict[int, int]:
        strength = self._minimum + abs(step) if step else 0
        chosen = strength if motor.pwm is None else self._full * bool(step)
        levels = {motor.forward: chosen if step > 0 else 0}
        if motor.backward is not None:
            levels[motor.backward] = chosen if step < 0 else 0
        if motor.pwm is not None:
            levels[motor.pwm] = strength
        return levels

    def _braking(self) -> dict[int, int]:
        motors = [motor for side in self._sides for motor in side if motor.backward is not None]
        inputs = [each for motor in motors for each in (motor.forward, motor.backward, motor.pwm)]
        return {each: self._full for each in inputs if each is not None}


HEADER = "header"


class MotorPins(MotorTable):
    """The pins of one motor, by their BCM numbers: forward and backward, both and pwm, or direction and pwm."""

    forward: Pin | None = None
    """High drives forwards. It is pulsed, unless ``pwm`` is named."""
    backward: Pin | None = None
    """High drives backwards."""
    direction: Pin | None = None
    """For drivers with one input for the direction: high drives forwards, low backwards."""
    pwm: Pin | None = None
    """How strongly: ENA and ENB of an L298N, PWMA and PWMB of a TB6612."""


class GpioMotorsOptions(HBridgeOptions):
    """The options of two motors on GPIO pins, by an H-bridge such as L298N or TB6612."""

    title: ClassVar = "two motors behind a motor driver (L298N, TB6612 …) on GPIO pins"
    circuit: ClassVar = "motor-driver"

    port: str = HEADER
    """The pins: of this computer, or ``emulated-gpio-motors``."""
    left: MotorPins = Field(examples=["{ forward = 17, backward = 27, pwm = 12 }"])
    """The pins of the left motor."""
    right: MotorPins = Field(examples=["{ forward = 16, backward = 20, pwm = 13 }"])
    """The pins of the right motor."""
    enable: Pin | None = None
    """A pin that is high only while the robot moves or brakes: STBY of a TB6612, SLEEP of a DRV8833."""
    frequency: Frequency = Field(default=100.0, ge=MIN_PULSES_HZ, le=10_000.0)
    """Of the pulses, which lgpio makes in software. A stop waits for the end of one: 10 ms at 100 Hz."""

    def build(self, context: DriverContext) -> GpioMotorsBase:
        """Return the base."""
        return GpioMotorsBase(self, context)

    def is_simulated(self) -> bool:
        """Check whether the pins are emulated ones."""
        return self.port in driver_names(PORTS)

    def lacks(self) -> tuple[str, ...]:
        """List the things this computer lacks to drive pins."""
        if self.is_simulated():
            return ()
        return pins_lack() if self.port == HEADER else (f"port = {self.port!r} names no pins; leave it out",)


class GpioMotorsBase(HBridgeBase):
    """A `MobileBase` of two motors on pins. Duties are whole percents, which is all that lgpio knows."""

    def __init__(self, options: GpioMotorsOptions, context: DriverContext) -> None:
        self._motors = ([options.left.outputs()], [options.right.outputs()])
        super().__init__(options, context, self._motors, full=FULL_PERCENT, enable=options.enable)
        self._port = options.port
        pulsed = [
            each
            for (motor,) in self._motors
            for each in ((motor.pwm,) if motor.pwm is not None else (motor.forward, motor.backward))
        ]
        self._frequencies_hz = {
            each: options.frequency if each in pulsed else None
            for (motor,) in self._motors
            for each in (motor.forward, motor.backward, motor.pwm)
            if each is not None
        }
        if options.enable is not None:
            self._frequencies_hz[options.enable] = None
        self._pins: dict[int, OutputPin] = {}

    @property
    def is_open(self) -> bool:
        """True while the pins are taken."""
        return bool(self._pins)

    def open(self) -> None:
        """Take the pins, all low. Does nothing when open; a `DeviceOpenError` names a pin that cannot be had."""
        if self.is_open:
            return
        factory = self._choose_factory()
        with ExitStack() as undo:
            pins = {}
            for number, frequency_hz in self._frequencies_hz.items():
                pin = OutputPin(self._context, number, frequency_hz=frequency_hz, factory=factory)
                undo.callback(_let_go_quietly, pin)
                pin.open()
                pins[number] = pin
            undo.pop_all()
        self._forget()
        self._pins = pins

    def _choose_factory(self) -> Callable[[], PiFactory]:
        if self._port not in driver_names(PORTS):
            return lambda: shared_pin_factory(self._context)
        emulated = load_driver(PORTS, self._port)().build(self._context)
        (left,), (right,) = self._motors
        emulated.wire([left], [right], next(iter(self._enabled), None))
        return lambda: emulated.factory

    def _check_link(self) -> None:
        """Write again what is steady: pulses would begin anew."""
        self._send({number: level for number, level in self._written.items() if level in {0, FULL_PERCENT}})

    def _send(self, levels: Mapping[int, int]) -> None:
        failed: DriverError | None = None
        for number in sorted(levels, key=lambda each: levels[each]):
            if failed and levels[number]:
                break
            try:
                self._pins[number].rewrite(levels[number])
            except DriverError as error:
                failed = failed or error
        if failed:
            raise LinkLostError(str(failed)) from failed

    def _let_go(self) -> None:
        pins, self._pins = self._pins, {}
        failed: DriverError | None = None
        for pin in pins.values():
            try:
                pin.close()
            except DriverError as error:
                failed = failed or error
        if failed:
            raise LinkLostError(str(failed)) from failed


def _let_go_quietly(pin: OutputPin) -> None:
    """Close a pin beside the error that opening another one has raised."""
    with suppress(DriverError):
        pin.close()
