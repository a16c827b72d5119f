"""What is examined: a computer, and the configuration that is to run on it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from stadimeter.errors import ConfigError, StadimeterError
from stadimeter.workbench.doctor.computer import (
    Computer,
    Diagnosis,
    DiagnosisSeverity,
    Imports,
    import_libraries,
    libraries,
    unknown,
    wrong,
)

if TYPE_CHECKING:  # reading a configuration loads the libraries that may be broken
    from stadimeter.config.loader import Configuration
    from stadimeter.workbench.doctor.configured import Configured


# The configuration of the service, which is looked at if no other is named.
INSTALLED = "/etc/stadimeter/appliance.toml"

UNIT = "stadimeter.service"
SUDO = "call doctor with `sudo`"


@dataclass(frozen=True)
class Examined:
    """A computer and a configuration, which is read when it is first asked for.

    Attributes:
        path: The configuration; None for that of the service, if there is one.
    """

    computer: Computer
    path: Path | None = None

    @cached_property
    def imports(self) -> Imports:
        """How importing the libraries ended."""
        return import_libraries(self.computer)

    @cached_property
    def libraries(self) -> tuple[Diagnosis, ...]:
        """What was found out on the libraries."""
        return tuple(libraries(self.imports))

    @property
    def configured(self) -> Configured | None:
        """The configuration that was read; None where there is none that can be used."""
        return self._read[0]

    @property
    def configuration(self) -> Configuration | None:
        """The configuration; None where there is none that can be used."""
        return self.configured.configuration if self.configured else None

    @property
    def why_none(self) -> Diagnosis | None:
        """Why a configuration that is there, or was named, cannot be used."""
        return self._read[1]

    @property
    def is_of_service(self) -> bool:
        """Whether the configuration is that of the service."""
        return self.path is None or self.path.resolve() == Path(INSTALLED)

    @property
    def place(self) -> Path:
        """Where the configuration is, or would be."""
        return self.path or self.computer.root / INSTALLED.lstrip("/")

    @property
    def goes_by_the_clock(self) -> bool:
        """Whether any rule asks for the time of day."""
        return self.configured is not None and self.configured.is_scheduled

    @cached_property
    def pins(self) -> frozenset[int]:
        """The GPIOs of its outputs and buttons."""
        return self.configured.pins if self.configured else frozenset()

    @property
    def ports(self) -> tuple[str, ...]:
        """The serial ports that it names."""
        return self.configured.ports if self.configured else ()

    @cached_property
    def _read(self) -> tuple[Configured | None, Diagnosis | None]:
        path = self.place
        try:
            path.stat()
        except PermissionError:  # the folder of the service's is not for every eye
            return None, _not_yours(path)
        except OSError:
            return None, None
        if not os.access(path, os.R_OK):
            return None, _not_yours(path)
        if any(each.severity is DiagnosisSeverity.WRONG for each in self.libraries):
            return None, unknown(f"{path} was not read, since libraries do not load", "mend those first")
        from stadimeter.workbench.doctor.configured import Configured  # noqa: PLC0415 - loads the libraries

        try:
            return Configured.read(path), None
        except StadimeterError as error:
            return None, wrong(f"{path} cannot be used: {_first(error)}", f"`stadimeter check {path}` shows all")


def _not_yours(path: Path) -> Diagnosis:
    return unknown(f"{path} is not yours to read", SUDO)


def _first(error: StadimeterError) -> str:
    """Return the first of several errors in one line, and how many more there are."""
    lines = [str(each) for each in error.problems] if isinstance(error, ConfigError) else [str(error)]
    more = f", and {len(lines) - 1} more" if len(lines) > 1 else ""
    return f"{' '.join(lines[0].split())}{more}"
