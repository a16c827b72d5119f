"""The subject of the examination: a computer, and the configuration that is to run on it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from stadimeter.errors import ConfigError, StadimeterError
from stadimeter.workbench.doctor.computer import (
    Computer,
    Configured,
    Diagnosis,
    DiagnosisSeverity,
    Imports,
    import_libraries,
    libraries,
    unknown,
    wrong,
)

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
        """The outcome of importing the libraries."""
        return import_libraries(self.computer)

    @cached_property
    def libraries(self) -> tuple[Diagnosis, ...]:
        """The findings on the libraries."""
        return tuple(libraries(self.imports))

    @property
    def is_of_service(self) -> bool:
        """True if the configuration is that of the service."""
        return self.path is None or self.path.resolve() == Path(INSTALLED)

    @property
    def place(self) -> Path:
        """The place where the configuration is, or would be."""
        return self.path or self.computer.root / INSTALLED.lstrip("/")

    @cached_property
    def configured(self) -> Configured:
        """The configuration, or why it cannot be used."""
        path = self.place
        try:
            path.stat()
        except PermissionError:  # the folder of the service's is not for every eye
            return _not_yours(path)
        except OSError:
            return Configured()
        if not os.access(path, os.R_OK):
            return _not_yours(path)
        if any(each.severity is DiagnosisSeverity.WRONG for each in self.libraries):
            return Configured(unknown(f"{path} was not read, since libraries do not load", "mend those first"))
        from stadimeter.workbench.doctor.configured import read_configured  # noqa: PLC0415 - loads the libraries

        try:
            return read_configured(path)
        except StadimeterError as error:
            return Configured(wrong(f"{path} cannot be used: {_first(error)}", f"`stadimeter check {path}` shows all"))


def _not_yours(path: Path) -> Configured:
    return Configured(unknown(f"{path} is not yours to read", SUDO))


def _first(error: StadimeterError) -> str:
    """Return the first of several errors in one line, and how many more there are."""
    lines = [str(each) for each in error.problems] if isinstance(error, ConfigError) else [str(error)]
    more = f", and {len(lines) - 1} more" if len(lines) > 1 else ""
    return f"{' '.join(lines[0].split())}{more}"
