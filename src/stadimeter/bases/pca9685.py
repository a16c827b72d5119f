"""Boards that drive motors through a PCA9685 over I2C: Freenove 4WD, Waveshare JetBot, Adafruit MotorKit, and others.

**This base does not stop by itself**: see `stadimeter.bases.pca9685_chip`. Channels of the boards as in their makers'
code: ``Motor.py`` of Freenove_4WD_Smart_Car_Kit_for_Raspberry_Pi, ``motor.py`` of NVIDIA-AI-IOT/jetbot (the lines for
Waveshare's board), ``adafruit_motorkit.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal, Protocol, Self

from msgspec import Struct
from pydantic import Field, model_validator

from stadimeter.bases.h_bridge import HBridgeBase, HBridgeOptions, MotorTable
from stadimeter.bases.i2c_link import I2cDevice, bus_number, i2c_lacks
from stadimeter.bases.pca9685_chip import FULL, Channel, Pca9685, stop_writes
from stadimeter.bases.protocol import MotorOutputs, WiresMotors
from stadimeter.config.plugins import PORTS, DriverContext, I2cStop, driver_names
from stadimeter.config.units import Frequency


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


class EmulatedChip(I2cDevice, WiresMotors, Protocol):
    """A chip in memory that turns the wheels of the simulated robot."""


class MotorChannels(MotorTable):
    """The channels of one motor, 0 to 15: forward and backward, both and pwm, or direction and pwm."""

    forward: Channel | None = None
    """High drives forwards. It is pulsed, unless ``pwm`` is named."""
    backward: Channel | None = None
    """High drives backwards."""
    direction: Channel | None = None
    """For drivers with one input for the direction: high drives forwards, low backwards."""
    pwm: Channel | None = None
    """How strongly."""


class Pca9685Options(HBridgeOptions):
    """The table of a board with a PCA9685 in the configuration."""

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
        emulated: EmulatedChip | None = self._chip.open()
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
