"""What the checks ask of a configuration. Loading this loads numpy, pydantic and the drivers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Self

from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.app.safe_outputs import safe_lines
from stadimeter.app.this_computer import warnings_here
from stadimeter.app.wall_time import goes_by_the_clock
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.plugins import marked_options
from stadimeter.config.units import PortMark
from stadimeter.errors import Problem
from stadimeter.workbench.wiring.circuits import find_outputs, parts_of


@dataclass(frozen=True, slots=True)
class Configured:
    """A configuration that was read."""

    configuration: Configuration

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a configuration; raises `StadimeterError` if it cannot be used."""
        return cls(load_configuration(path))

    @property
    def is_scheduled(self) -> bool:
        """Whether any rule asks for the time of day."""
        return goes_by_the_clock(self.configuration.plan)

    @property
    def pins(self) -> frozenset[int]:
        """The GPIOs of its outputs and buttons."""
        return frozenset(output.gpio for output in find_outputs(parts_of(self.configuration)))

    @property
    def ports(self) -> tuple[str, ...]:
        """The serial ports that its base names."""
        base = self.configuration.base
        found = marked_options(base.options, PortMark) if base is not None else ()
        return tuple(str(port) for _key, port in found if str(port).startswith("/"))

    @property
    def safe_lines(self) -> list[str]:
        """The lines of the list of safe outputs; none for simulated outputs."""
        driven = self.configuration.driven
        return [line for each in driven if not each.is_simulated for line in safe_lines(each)]

    def warnings(self) -> tuple[Problem, ...]:
        """Return what `check` finds, what this computer lacks first."""
        found = self.configuration
        return (*warnings_here(found), *found.warnings, *feasibility_warnings(found))
