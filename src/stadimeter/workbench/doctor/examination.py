"""The checks of the configuration, of its broker and of the service, and the table of all checks.

Sources: systemctl(1), systemd.service(5) and systemd-system.conf(5) for the properties of units; the kernel's
``/sys/class/watchdog``.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence

from msgspec import Struct

from stadimeter.config.extras import PACKAGE_AGAIN, PACKAGED, guide
from stadimeter.messaging.protocol import ReachesItsPeer
from stadimeter.workbench.doctor import board, devices
from stadimeter.workbench.doctor.computer import COMMAND_S, Computer, Diagnosis, fine, unknown, warning, wrong
from stadimeter.workbench.doctor.examined import INSTALLED, SUDO, UNIT, Examined


class Check(Struct, frozen=True):
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
    found = examined.configured
    if found.why_none is not None:
        yield found.why_none
        return
    if found.configuration is None:
        yield unknown(f"there is no {INSTALLED}", "name yours: `stadimeter doctor CONFIG`")
        return
    if examined.computer.is_root and examined.is_of_service and examined.computer.has(PROGRAM):
        yield _as_the_service(examined)
        return
    yield _judge(str(found.configuration.path), [(each.message, each.code) for each in found.find_warnings()])


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
    found = examined.configured.configuration
    messenger = found.messenger if found else None
    if messenger is None or not isinstance(messenger.options, ReachesItsPeer):
        return
    trouble = messenger.options.reach()
    if trouble:
        yield wrong(trouble, f'{guide("troubleshooting.md")}, section "MQTT and notifications"')
    else:
        yield fine("the broker takes the connection with the configuration's login")


STATE = ("LoadState", "ActiveState", "SubState", "Result", "NRestarts", "UnitFileState", "StatusText")
RESTARTS_MANY = 3
SAFE_OUTPUTS = "/run/stadimeter/safe-outputs.conf"
OF_HAND = "/etc/stadimeter/safe-outputs.conf"
SWITCHES_OFF = "/usr/lib/stadimeter/safe-outputs"
PAGE = "stadimeter-web.service"
OURS = ("/usr/bin", "/bin", f"{PACKAGED}/bin")


def service(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether the service is installed, enabled and running."""
    computer = examined.computer
    if not computer.has_systemd:
        yield unknown("the service: systemd does not run this computer")
        return
    state = computer.unit(UNIT, *STATE)
    if not state:
        yield unknown("the service: systemctl does not answer")
    elif state.get("LoadState") not in {"loaded", "masked"}:
        yield fine("stadimeter is not installed as a service on this computer")
    else:
        yield _judge_service(state)


def _judge_service(state: dict[str, str]) -> Diagnosis:
    if failure := _failure("the service", UNIT, state):
        return failure
    active, restarts, says = state.get("ActiveState", ""), _restarts(state), _says(state)
    if state.get("LoadState") == "masked":
        return _judge_masked(active)
    if active != "active":
        return _not_active(active, f"{restarts} restarts{says}")
    if restarts > RESTARTS_MANY:
        return warning(f"the service runs, after {restarts} restarts{says}", _log(UNIT))
    if state.get("UnitFileState") != "enabled":
        return warning("the service runs, and is not started at boot", "`sudo systemctl enable stadimeter`")
    return fine(f"the service runs, {restarts} restarts{says}")


def _judge_masked(active: str) -> Diagnosis:
    """Judge a masked unit: systemd knows none of its settings any more, what it runs after its end among them."""
    unmask = "`sudo systemctl unmask stadimeter`"
    if active == "active":
        seen = "if it is killed, nothing switches its outputs off or starts it again"
        return wrong(f"the service runs, and is masked: {seen}", f"{unmask}, or stop it")
    return warning("the service is masked: nothing starts it", unmask)


def _not_active(active: str, more: str) -> Diagnosis:
    if active == "activating":
        return warning(f"the service is starting, {more}", _log(UNIT))
    return warning(f"the service is {active or 'in no known state'}", "`sudo systemctl enable --now stadimeter`")


def _failure(what: str, unit: str, state: dict[str, str]) -> Diagnosis | None:
    if state.get("ActiveState") != "failed" and state.get("SubState") != "auto-restart":
        return None
    seen = f"{what} has failed ({state.get('Result', 'no result')}), {_restarts(state)} restarts{_says(state)}"
    return wrong(seen, _log(unit))


def _restarts(state: dict[str, str]) -> int:
    return int(state.get("NRestarts") or 0)


def _says(state: dict[str, str]) -> str:
    return f", and says: {state['StatusText']}" if state.get("StatusText") else ""


def _log(unit: str) -> str:
    return f"`sudo journalctl -eu {unit}`"


def page(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether the page's service runs, if it is enabled; by default it is not."""
    if not examined.computer.has_systemd:
        return
    state = examined.computer.unit(PAGE, *STATE)
    if failure := _failure("the page's service", PAGE, state):
        yield failure
    elif state.get("ActiveState") == "active":
        yield fine(f"the page's service runs, {_restarts(state)} restarts")
    elif state.get("UnitFileState") == "enabled":
        seen = f"the page's service is enabled, and is {state.get('ActiveState') or 'in no known state'}"
        yield warning(seen, "`sudo systemctl start stadimeter-web`")


def path(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether `stadimeter`, as it is typed, is another program than that of the service."""
    computer = examined.computer
    if not computer.has(f"{PACKAGED}/bin/stadimeter"):
        return
    folders = [folder for folder in computer.environment.get("PATH", "").split(":") if folder]
    if user := computer.environment.get("SUDO_USER"):  # the path of root, that sudo gives, is not theirs
        folders = [f"{computer.home(user)}/.local/bin", *folders]
    first = next((folder for folder in folders if computer.has(f"{folder}/stadimeter")), OURS[0])
    if first not in OURS:
        yield warning(
            f"`stadimeter` is {first}/stadimeter, and the service runs {PACKAGED}/bin/stadimeter",
            "type `/usr/bin/stadimeter`, or uninstall the other one as it was installed (pip, pipx, uv)",
        )


def safe_outputs(examined: Examined) -> Iterator[Diagnosis]:
    """Compare the outputs that are switched off after the service with those of the configuration, and try the way."""
    if not examined.is_of_service or not examined.computer.has(SWITCHES_OFF):
        return
    yield from _of_hand(examined.computer)
    wanted = examined.configured.safe_lines
    if wanted:
        way = _way(examined.computer, wanted)
        has_no_way = way in {"", "nothing"}
        yield _no_way(examined.computer, way) if has_no_way else _judge_list(examined.computer, wanted, way)


def _no_way(computer: Computer, way: str) -> Diagnosis:
    if not computer.is_root:
        return unknown("whether the pins can be switched off after the service", SUDO)
    remedy = "`sudo apt install raspi-utils`, which brings pinctrl" if computer.is_pi else "run it on a Raspberry Pi"
    return wrong(
        "the pins cannot be switched off after the service, so a killed service leaves them as they are",
        remedy if way else PACKAGE_AGAIN,
    )


def _judge_list(computer: Computer, wanted: Sequence[str], way: str) -> Diagnosis:
    if not computer.has(SAFE_OUTPUTS):
        return unknown("which outputs are switched off after the service: it lists them when it starts")
    if not computer.is_readable(SAFE_OUTPUTS):
        return unknown(f"{SAFE_OUTPUTS} is not yours to read", SUDO)
    lacking = set(wanted) - set(computer.text(SAFE_OUTPUTS).splitlines())
    if lacking:
        return wrong(
            f"after the service has ended, these are not switched off: {', '.join(sorted(lacking))}",
            "`sudo systemctl restart stadimeter`, which lists the outputs of /etc/stadimeter/appliance.toml",
        )
    outputs = "1 output is" if len(wanted) == 1 else f"{len(wanted)} outputs are"
    return fine(f"{outputs} switched off after the service{'' if way == 'no pins' else f', pins by {way}'}")


def _way(computer: Computer, wanted: Sequence[str]) -> str:
    """Name what would drive the pins of a list, found out by the program that does it; empty if it does not say."""
    with tempfile.NamedTemporaryFile("w", prefix="stadimeter-") as file:
        file.write("".join(f"{line}\n" for line in wanted))
        file.flush()
        answer = computer.run((SWITCHES_OFF, "--check", file.name), COMMAND_S)
    return answer.output.strip() if answer is not None and answer.code == 0 else ""


def _of_hand(computer: Computer) -> Iterator[Diagnosis]:
    """Tell which lines of a hand-made list switch nothing off."""
    if not computer.has(OF_HAND):
        return
    answer = computer.run((SWITCHES_OFF, "--check", OF_HAND), COMMAND_S)
    refused = [line.removeprefix("safe-outputs: ") for line in answer.error.splitlines()] if answer else []
    if refused:
        yield wrong(f"{OF_HAND}: {refused[0]}", f"mend it; `{SWITCHES_OFF} --check {OF_HAND}` shows all")


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


CHECKS = (
    Check("This computer", "system", "reading which system this is", board.system),
    Check("This computer", "supply", "asking for the supply", board.supply),
    Check("This computer", "temperature", "reading the temperature", board.temperature),
    Check("This computer", "speed", "measuring how fast it is", board.speed),
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
    Check("Service", "service", "asking for the service", service),
    Check("Service", "page", "asking for the page's service", page),
    Check("Service", "path", "looking for other programs of this name", path),
    Check("Service", "safe-outputs", "comparing the safe outputs", safe_outputs),
    Check("Service", "watchdogs", "asking for the watchdogs", watchdogs),
)
