"""The checks of the configuration and of the broker that it names, and the table of all checks."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from stadimeter.config.extras import PACKAGED
from stadimeter.config.guides import guide
from stadimeter.messaging.protocol import ReachesItsPeer
from stadimeter.workbench.doctor import board, devices, service
from stadimeter.workbench.doctor.computer import Diagnosis, fine, unknown, warning, wrong
from stadimeter.workbench.doctor.examined import INSTALLED, Examined


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


# The findings of ``check`` that keep a configuration from running on this computer.
ELSEWHERE = frozenset({"driver-lacks", "will-not-run"})

# What the service runs; ``check`` of it goes on as the service's user.
PROGRAM = f"{PACKAGED}/bin/stadimeter"
CHECK_S = 30.0


def configuration(examined: Examined) -> Iterator[Diagnosis]:
    """Tell in a line what ``check`` finds."""
    if examined.why_none is not None:
        yield examined.why_none
        return
    found = examined.configured
    if found is None:
        yield unknown(f"there is no {INSTALLED}", "name yours: `stadimeter doctor CONFIG`")
        return
    if examined.computer.is_root and examined.is_of_service and examined.computer.has(PROGRAM):
        yield _as_the_service(examined)
        return
    yield _judge(str(found.configuration.path), [(each.message, each.code) for each in found.warnings()])


def _judge(path: str, problems: list[tuple[str, str]], who: str = "") -> Diagnosis:
    """Judge what `check` found: the message and the code of each."""
    if not problems:
        return fine(f"{path} can be used{who}, and `check` finds nothing")
    more = f"; and {len(problems) - 1} more" if len(problems) > 1 else ""
    judged = wrong if any(code in ELSEWHERE for _, code in problems) else warning
    return judged(f"{path}: {problems[0][0]}{more}", f"`{'sudo ' if who else ''}stadimeter check {path}` shows all")


def _as_the_service(examined: Examined) -> Diagnosis:
    """Judge what the service's user may read and open; to root, who asks, everything is open."""
    answer = examined.computer.run((PROGRAM, "check", "--json", INSTALLED), CHECK_S)
    try:
        said = json.loads(answer.output if answer else "")
        problems, warnings = said["problems"], [(each["message"], each["code"]) for each in said["warnings"]]
    except (ValueError, KeyError):
        return unknown(f"whether the service can use {INSTALLED}", f"`sudo stadimeter check {INSTALLED}` says why")
    if problems:
        more = f", and {len(problems) - 1} more" if len(problems) > 1 else ""
        seen = f"the service cannot use {INSTALLED}: {' '.join(problems[0]['message'].split())}{more}"
        return wrong(seen, f"`sudo stadimeter check {INSTALLED}` shows all")
    return _judge(INSTALLED, warnings, " by the service")


def broker(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether the broker that the configuration names takes its login."""
    messenger = examined.configuration.messenger if examined.configuration else None
    if messenger is None or not isinstance(messenger.options, ReachesItsPeer):
        return
    trouble = messenger.options.reach()
    if trouble:
        yield wrong(trouble, f'{guide("troubleshooting.md")}, section "MQTT and notifications"')
    else:
        yield fine("the broker takes the connection with the configuration's login")


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
    Check("Configuration", "configuration", "checking the configuration", configuration),
    Check("Configuration", "broker", "connecting to the broker", broker),
    Check("Service", "service", "asking for the service", service.service),
    Check("Service", "page", "asking for the page's service", service.page),
    Check("Service", "path", "looking for other programs of this name", service.path),
    Check("Service", "safe-outputs", "comparing the safe outputs", service.safe_outputs),
    Check("Service", "watchdogs", "asking for the watchdogs", service.watchdogs),
)
