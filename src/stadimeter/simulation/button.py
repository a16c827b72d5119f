"""A push button that is pressed by the clock."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Duration
from stadimeter.errors import DeviceClosedError


class PressTable(BaseModel):
    """A press."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    at: Duration
    """In seconds; when it goes down, after the button was first opened."""
    lasting: Duration = Field(default=0.2, alias="for")
    """In seconds; how long it stays down."""


class SimulatedButtonOptions(DriverOptions):
    """The table of a simulated button in the configuration."""

    presses: tuple[PressTable, ...] = ()
    """When it is pressed."""

    def build(self, context: DriverContext) -> SimulatedButton:
        """Return the button."""
        return SimulatedButton(self, context)

    def is_simulated(self) -> bool:
        """Return True."""
        return True


class SimulatedButton:
    """A button without hardware.

    Attributes:
        is_down: The knob: whether it is held down, besides the presses of its table.
    """

    def __init__(self, options: SimulatedButtonOptions, context: DriverContext) -> None:
        self.is_down = False
        self.is_open = False
        self._presses = options.presses
        self._name = context.name
        self._clock = context.clock
        self._began_s: float | None = None

    def open(self) -> None:
        """Be ready. The presses of its table count from the first time."""
        self.is_open = True
        if self._began_s is None:
            self._began_s = self._clock.now_s()

    def is_pressed(self) -> bool:
        """Check whether it is down."""
        if not self.is_open or self._began_s is None:
            raise DeviceClosedError(f"the simulated button '{self._name}' is not open")
        since_s = self._clock.now_s() - self._began_s
        return self.is_down or any(press.at <= since_s < press.at + press.lasting for press in self._presses)

    def close(self) -> None:
        """Be closed. May be called any number of times."""
        self.is_open = False
