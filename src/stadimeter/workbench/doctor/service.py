"""The service: its state, the outputs that are switched off after it, and the watchdogs.

Sources: systemctl(1), systemd.service(5) and systemd-system.conf(5) for the properties; the kernel's
``/sys/class/watchdog``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from stadimeter.workbench.doctor.computer import Computer
from stadimeter.workbench.doctor.diagnosis import Diagnosis, fine, unknown, warning, wrong
from stadimeter.workbench.doctor.examined import Examined

UNIT = "stadimeter.service"
RESTARTS_MANY = 3
SAFE_OUTPUTS = ("/run/stadimeter/safe-outputs.conf", "/etc/stadimeter/safe-outputs.conf")
LOG = f"`sudo journalctl -eu {UNIT}`"


def service(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether the service is installed, enabled and running."""
    computer = examined.computer
    if not computer.has_systemd:
        yield unknown("the service: systemd does not run this computer")
        return
    state = computer.unit(UNIT, "LoadState", "ActiveState", "SubState", "Result", "NRestarts", "UnitFileState")
    if not state:
        yield unknown("the service: systemctl does not answer")
    elif state.get("LoadState") != "loaded":
        yield fine("stadimeter is not installed as a service on this computer")
    else:
        yield _judged(state)


def _judged(state: dict[str, str]) -> Diagnosis:
    active, restarts = state.get("ActiveState", ""), int(state.get("NRestarts") or 0)
    if active == "failed" or state.get("SubState") == "auto-restart":
        return wrong(f"the service has failed ({state.get('Result', 'no result')}), {restarts} restarts", LOG)
    if active != "active":
        return warning(f"the service is {active or 'in no known state'}", "`sudo systemctl enable --now stadimeter`")
    if restarts > RESTARTS_MANY:
        return warning(f"the service runs, after {restarts} restarts", LOG)
    if state.get("UnitFileState") != "enabled":
        return warning("the service runs, and is not started at boot", "`sudo systemctl enable stadimeter`")
    return fine(f"the service runs, {restarts} restarts")


def safe_outputs(examined: Examined) -> Iterator[Diagnosis]:
    """Compare the outputs that are switched off after the service with those of the configuration."""
    computer = examined.computer
    if not examined.pins or not computer.has("/usr/lib/stadimeter/safe-outputs"):
        return
    listed = _listed(computer)
    wanted = {gpio: "low" if active_high else "high" for gpio, active_high in examined.pins.items()}
    lacking = [f"{gpio} {level}" for gpio, level in wanted.items() if listed.get(gpio) != level]
    if lacking:
        yield wrong(
            f"after the service has ended, these pins are not switched off: {', '.join(lacking)}",
            "`sudo systemctl restart stadimeter` writes their list from the configuration",
        )
    else:
        yield fine(f"after the service has ended, {len(wanted)} pins are switched off, as in the configuration")


def _listed(computer: Computer) -> dict[int, str]:
    """Return the GPIOs that are switched off, each with its safe level: lines ``pin 18`` or ``pin 5 high``."""
    lines = re.findall(r"^\s*pin\s+(\d+)(?:\s+(low|high))?", computer.text(*SAFE_OUTPUTS), re.MULTILINE)
    return {int(pin): level or "low" for pin, level in lines}


def watchdogs(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether a hung program, and a hung system, are restarted."""
    computer = examined.computer
    if not computer.has_systemd:
        return
    unit = computer.unit(UNIT, "LoadState", "WatchdogUSec")
    if unit.get("LoadState") == "loaded":
        if _is_set(unit.get("WatchdogUSec")):
            yield fine(f"the service is restarted when it hangs for {unit['WatchdogUSec']}")
        else:
            yield warning("the service has no watchdog", "`WatchdogSec=` is missing: install the package anew")
    if computer.is_pi:
        limit = computer.unit("", "RuntimeWatchdogUSec").get("RuntimeWatchdogUSec")
        if limit is None:
            yield unknown("the watchdog of the board: systemctl does not answer")
        elif _is_set(limit):
            yield fine(f"the board restarts when the system hangs for {limit}")
        else:
            yield warning(
                "the board does not restart when the system hangs",
                "`RuntimeWatchdogSec=15` below `[Manager]` in /etc/systemd/system.conf.d/watchdog.conf, and restart",
            )


def _is_set(duration: str | None) -> bool:
    return duration not in {None, "", "0", "infinity"}
