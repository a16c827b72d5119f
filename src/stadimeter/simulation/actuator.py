"""An actuator without hardware."""

from __future__ import annotations

from collections import deque

from msgspec import Struct
from msgspec.structs import replace
from pydantic import Field

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.core.command import LevelCommand
from stadimeter.errors import DeviceClosedError


class SimulatedActuatorOptions(DriverOptions):
    """The table of a simulated actuator in the configuration."""

    steps: int | None = Field(default=None, ge=1)
    """How many levels above off the device can do; None for any. 1 makes it a switch."""
    history: int = Field(default=10_000, ge=1)
    """How many changes of level it remembers."""

    def build(self, context: DriverContext) -> SimulatedActuator:
        """Return the actuator."""
        return SimulatedActuator(self, context)

    def is_simulated(self) -> bool:
        """Return True."""
        return True


class LevelChange(Struct, frozen=True, kw_only=True):
    """A change of level."""

    at_s: float  # when, on the run's clock
    level: float  # the level from then on


class SimulatedActuator:
    """An actuator that remembers what it did."""

    def __init__(self, options: SimulatedActuatorOptions, context: DriverContext) -> None:
        self.level = 0.0  # the level that it acts with
        # When the level changed to what, oldest first. Bounded: the oldest are forgotten.
        self.changes: deque[LevelChange] = deque(maxlen=options.history)
        self._steps = options.steps
        self._name = context.name
        self._clock = context.clock
        self._is_open = False

    @property
    def is_open(self) -> bool:
        """True if it is open."""
        return self._is_open

    def open(self) -> None:
        """Be ready, switched off. Does nothing when open."""
        self._is_open = True

    def apply(self, command: LevelCommand) -> LevelCommand:
        """Act as commanded, and return the command with the level rounded to the nearest of the device's steps."""
        self._check_open()
        level = round(command.level * self._steps) / self._steps if self._steps else command.level
        self._set(level)
        return command if level == command.level else replace(command, level=level)

    def tick(self, now_s: float) -> None:  # noqa: ARG002 -- the protocol has it; this device has no patterns
        """Do nothing: it has no patterns."""
        self._check_open()

    def stop(self) -> None:
        """Switch off at once. Does nothing when closed."""
        if self._is_open:
            self._set(0.0)

    def close(self) -> None:
        """Switch off and be closed. May be called any number of times."""
        self.stop()
        self._is_open = False

    def _set(self, level: float) -> None:
        if level != self.level:
            self.level = level
            self.changes.append(LevelChange(at_s=self._clock.now_s(), level=level))

    def _check_open(self) -> None:
        if not self._is_open:
            raise DeviceClosedError(f"the simulated actuator '{self._name}' is not open")
