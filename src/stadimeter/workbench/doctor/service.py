"""The service: its state, the outputs that are switched off after it, and the watchdogs.

Sources: systemctl(1), systemd.service(5) and systemd-system.conf(5) for the properties; the kernel's
``/sys/class/watchdog``.
"""

from __future__ import annotations

from collections.abc import Iterator

from stadimeter.workbench.doctor.diagnosis import Diagnosis, fine, unknown, warning, wrong
from stadimeter.workbench.doctor.examined import SUDO, Examined

UNIT = "stadimeter.service"
STATE = ("LoadState", "ActiveState", "SubState", "Result", "NRestarts", "UnitFileState", "StatusText")
RESTARTS_MANY = 3
SAFE_OUTPUTS = "/run/stadimeter/safe-outputs.conf"
SWITCHES_OFF = "/usr/lib/stadimeter/safe-outputs"
LOG = f"`sudo journalctl -eu {UNIT}`"


def service(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether the service is installed, enabled and running."""
    computer = examined.computer
    if not computer.has_systemd:
        yield unknown("the service: systemd does not run this computer")
        return
    state = computer.unit(UNIT, *STATE)
    if not state:
        yield unknown("the service: systemctl does not answer")
    elif state.get("LoadState") != "loaded":
        yield fine("stadimeter is not installed as a service on this computer")
    else:
        yield _judged(state)


def _judged(state: dict[str, str]) -> Diagnosis:
    active, restarts = state.get("ActiveState", ""), int(state.get("NRestarts") or 0)
    says = f", and says: {state['StatusText']}" if state.get("StatusText") else ""
    if active == "failed" or state.get("SubState") == "auto-restart":
        return wrong(f"the service has failed ({state.get('Result', 'no result')}), {restarts} restarts{says}", LOG)
    if active == "activating":
        return warning(f"the service is starting, {restarts} restarts{says}", LOG)
    if active != "active":
        return warning(f"the service is {active or 'in no known state'}", "`sudo systemctl enable --now stadimeter`")
    if restarts > RESTARTS_MANY:
        return warning(f"the service runs, after {restarts} restarts{says}", LOG)
    if state.get("UnitFileState") != "enabled":
        return warning("the service runs, and is not started at boot", "`sudo systemctl enable stadimeter`")
    return fine(f"the service runs, {restarts} restarts{says}")


def safe_outputs(examined: Examined) -> Iterator[Diagnosis]:
    """Compare the outputs that are switched off after the service with those of the configuration."""
    computer = examined.computer
    if examined.configuration is None or not examined.is_of_service or not computer.has(SWITCHES_OFF):
        return
    from stadimeter.app.safe_outputs import safe_lines  # noqa: PLC0415 - loads the configuration's drivers

    driven = examined.configuration.driven
    wanted = [line for each in driven if not each.plugin.is_simulated(each.options) for line in safe_lines(each)]
    if not wanted:
        return
    if not computer.has(SAFE_OUTPUTS):
        yield unknown("which outputs are switched off after the service: it lists them when it starts")
        return
    if not computer.is_readable(SAFE_OUTPUTS):
        yield unknown(f"{SAFE_OUTPUTS} is not yours to read", SUDO)
        return
    lacking = set(wanted) - set(computer.text(SAFE_OUTPUTS).splitlines())
    if lacking:
        yield wrong(
            f"after the service has ended, these are not switched off: {', '.join(sorted(lacking))}",
            "`sudo systemctl restart stadimeter`, which lists the outputs of /etc/stadimeter/appliance.toml",
        )
    else:
        yield fine(f"{len(wanted)} {'output is' if len(wanted) == 1 else 'outputs are'} switched off after the service")


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
