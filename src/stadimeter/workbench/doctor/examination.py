"""The table of checks."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from stadimeter.workbench.doctor import board, configured, devices, service
from stadimeter.workbench.doctor.computer import Diagnosis
from stadimeter.workbench.doctor.examined import Examined


@dataclass(frozen=True, slots=True)
class Check:
    """A check.

    Attributes:
        group: The heading that its lines stand under, which is a heading of ``docs/doctor.md``, too.
        name: Its name for programs.
        doing: What it does, for people who wait for it.
        find: Yields what it finds; nothing where it does not apply.
    """

    group: str
    name: str
    doing: str
    find: Callable[[Examined], Iterable[Diagnosis]]


CHECKS = (
    Check("This computer", "system", "reading which system this is", board.system),
    Check("This computer", "supply", "asking for the supply", board.supply),
    Check("This computer", "temperature", "reading the temperature", board.temperature),
    Check("This computer", "clock", "asking for the clock", board.clock),
    Check("This computer", "disk", "reading the free space", board.disk),
    Check("This computer", "wear", "reading what is written to the card", board.wear),
    Check("Python and libraries", "libraries", "loading the libraries", lambda examined: examined.libraries),
    Check("Cameras, pins and ports", "groups", "reading the groups", devices.groups),
    Check("Cameras, pins and ports", "cameras", "listing the cameras", devices.cameras),
    Check("Cameras, pins and ports", "pins", "looking for pins", devices.pins),
    Check("Cameras, pins and ports", "serial", "looking for serial ports", devices.serial),
    Check("Configuration", "configuration", "checking the configuration", configured.configuration),
    Check("Configuration", "broker", "connecting to the broker", configured.broker),
    Check("Service", "service", "asking for the service", service.service),
    Check("Service", "page", "asking for the page's service", service.page),
    Check("Service", "path", "looking for other programs of this name", service.path),
    Check("Service", "safe-outputs", "comparing the safe outputs", service.safe_outputs),
    Check("Service", "watchdogs", "asking for the watchdogs", service.watchdogs),
)
