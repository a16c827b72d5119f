"""A base of two motors behind H-bridges on GPIO pins: L298N, TB6612, DRV8833, L9110 and the like.

**This base does not stop by itself.** A Raspberry Pi keeps a pin at its last level when the program is killed, and a
pulsed pin stays low or high as it happens to be. What makes the pins low then is the watchdog process or
``safe-outputs``; what helps while the Pi boots, and once pins were let go, is a resistor to ground at each input.

An L298N that is enabled brakes while both of its inputs are low, and heats (gpiozero issue 1233: `gpiozero.Motor`
leaves it so). Here every output is low at rest, ``pwm`` and ``enable`` too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from typing import ClassVar, Protocol

from gpiozero.pins.pi import PiFactory
from pydantic import Field

from stadimeter.bases.h_bridge import HBridgeBase, HBridgeOptions, MotorTable
from stadimeter.bases.protocol import WiresMotors
from stadimeter.config.plugins import PORTS, DriverContext, driver_names, load_driver
from stadimeter.config.units import Frequency, Pin
from stadimeter.errors import DriverError, LinkLostError
from stadimeter.gpio.output_pin import FULL_PERCENT, MIN_PULSES_HZ, OutputPin, pins_lack, shared_pin_factory

HEADER = "header"


class EmulatedPins(WiresMotors, Protocol):
    """Pins in memory that turn the wheels of the simulated robot."""

    @property
    def factory(self) -> PiFactory:
        """Makes the pins."""
        ...


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
    """The table of two motors on GPIO pins in the configuration."""

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
        emulated: EmulatedPins = load_driver(PORTS, self._port)().build(self._context)
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
