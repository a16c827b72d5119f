"""The checks of a computer, and their table: the board, its devices, the configuration, its broker and the service.

Sources: Raspberry Pi's documentation ("Raspberry Pi OS": ``vcgencmd``; "Configuration": ``config.txt``, UARTs; "Camera
software"), the kernel's drivers ``unicam`` and ``rp1-cfe`` of its two camera ports, systemctl(1), systemd.service(5),
systemd-system.conf(5) and proc(5).
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from msgspec import Struct

from stadimeter.app.live.health import throttling
from stadimeter.config.extras import LIBRARIES, PACKAGE_AGAIN, guide, install_line
from stadimeter.messaging.protocol import ReachesItsPeer
from stadimeter.workbench.doctor.computer import (
    COMMAND_S,
    INSTALLED,
    SUDO,
    UNIT,
    Diagnosis,
    Examined,
    fine,
    picamera2_remedy,
    python_command,
    unknown,
    warning,
    wrong,
)

# The board: its supply, clock and disk -----------------------------------------------------------------------------

SUPPLY = (
    "use the supply for the board (5 V and 3 A; 5 A for a Pi 5) and a short, thick cable, and another one for motors"
)
COOL = "a heat sink or a fan, and air around the board"
# To load the libraries takes a Zero 2 W some seconds.
SPEED_S = 30.0
LOW_BYTES = 500e6


def system(examined: Examined) -> Iterator[Diagnosis]:
    """Tell which board and system this is."""
    computer = examined.computer
    release = re.search(r'^PRETTY_NAME="?([^"\n]*)', computer.text("/etc/os-release"), re.MULTILINE)
    name = release[1] if release else "an unknown system"
    if computer.is_pi:
        yield fine(f"{computer.model}, {name}")
    else:
        yield fine(f"{computer.model or 'no Raspberry Pi'}, {name}; pins, supply and ribbon cameras are left out")


def supply(examined: Examined) -> Iterator[Diagnosis]:
    """Tell of too low a voltage and of a processor that is slowed, at this moment or since the start."""
    computer = examined.computer
    if not computer.is_pi:
        return
    found = re.search(r"throttled=0x([0-9a-fA-F]+)", computer.prints("vcgencmd", "get_throttled"))
    if found is None:
        yield unknown("whether the supply suffices: vcgencmd does not say")
        return
    state = throttling(int(found[1], 16))
    words = f"vcgencmd get_throttled: 0x{found[1]}"
    remedy = SUPPLY if "under-voltage" in (*state.now, *state.before) else COOL
    if state.now:
        yield wrong(f"{' and '.join(state.now)} now ({words})", remedy)
    elif state.before:
        yield warning(f"{' and '.join(state.before)} since the start, not now ({words})", remedy)
    else:
        yield fine(f"no under-voltage and no throttling since the start ({words})")


def speed(examined: Examined) -> Iterator[Diagnosis]:
    """Tell how many pictures a second it can look through for a ball."""
    answer = examined.computer.run((*python_command(), "-m", "stadimeter.workbench.doctor.speed"), SPEED_S)
    if answer is not None and answer.code == 0:
        many = answer.output.strip()
        yield fine(f"it looks through {many} pictures of 640x480 a second for a ball of one colour")
    elif answer is not None:
        yield unknown("how fast it is: the libraries do not work together")


def clock(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether the clock is synchronised: schedules wait for that, and times in logs are wrong without it."""
    if examined.computer.is_clock_right():
        yield fine("the clock is synchronised")
        return
    remedy = "`sudo timedatectl set-ntp true`, and a network; a Pi 5 keeps time with a battery on its clock"
    seen = "the clock is not synchronised"
    if examined.configured.is_scheduled:
        yield wrong(f"{seen}, and rules with a schedule wait for it", remedy)
    else:
        yield warning(f"{seen}: times in logs and messages may be wrong", remedy)


def disk(examined: Examined) -> Iterator[Diagnosis]:
    """Tell how much is free where state and logs go."""
    computer = examined.computer
    try:
        free = computer.free_bytes(computer.root / "var")
    except OSError as error:
        yield unknown(f"the free space below /var: {error.strerror}")
        return
    seen = f"{free / 1e9:.1f} GB are free below /var"
    remedy = "delete old journals and recordings (`sudo du -xh / | sort -h | tail` finds what is large)"
    yield fine(seen) if free >= LOW_BYTES else warning(seen, remedy)


# Groups, cameras, pins and serial ports ----------------------------------------------------------------------------

GROUPS = {"video": "cameras", "dialout": "serial ports", "gpio": "pins"}
LIST_S = 20.0
IN_USE = "another program is using it"

# The serial ports of GPIO 14 and 15. The console of a Pi 5 is on a connector of its own, as ttyAMA10.
CONFIG_TXT = "/boot/firmware/config.txt"
ON_HEADER = ("ttyAMA0", "ttyS0")

ATTACH = "plug one in, or try another socket and cable; `ls /dev/video*` lists those that the kernel knows"
ATTACH_TO_PI = (
    "another socket for a webcam. A ribbon camera: switch off, plug the cable in anew (a Pi 5 and a Zero need the"
    f" narrow one), `rpicam-hello --list-cameras`; `camera_auto_detect=1` in {CONFIG_TXT}, and the `dtoverlay` of a"
    " module that is not Raspberry Pi's own"
)


def groups(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether this process may use cameras, serial ports and pins."""
    computer = examined.computer
    if computer.is_root:
        yield fine("root may use every device; other users need the groups video, dialout and gpio")
        return
    status = re.search(r"^Groups:(.*)", computer.text("/proc/self/status"), re.MULTILINE)
    ours = status[1].split() if status else ()
    entries = [line.split(":") for line in computer.text("/etc/group").splitlines() if line.count(":") == 3]
    lacking = [group for group, _password, number, _members in entries if group in GROUPS and number not in ours]
    for group in lacking:
        remedy = f"`sudo usermod -aG {group} $USER`, then log out and in again, or restart"
        yield warning(f"this user is not in the group {group}, which may use {GROUPS[group]}", remedy)
    if not lacking:
        yield fine("this user may use cameras, serial ports and pins")


def cameras(examined: Examined) -> Iterator[Diagnosis]:
    """Tell which cameras are there, by which stack, and what keeps one from being used."""
    computer = examined.computer
    answer = computer.run((*python_command(), "-m", "stadimeter", "cameras", "--no-try", "--json"), LIST_S)
    try:
        found: list[dict[str, Any]] = json.loads(answer.output if answer is not None else "")
    except ValueError:
        yield unknown("the cameras could not be listed", "`stadimeter cameras` says why")
        return
    for camera in found:
        stack = "libcamera" if camera["driver"] == "picamera2" else "V4L2"
        seen = f"{camera['name']}, by {stack}: {camera['device']}"
        if camera["trouble"].startswith(IN_USE) and computer.is_active(UNIT):
            yield fine(f"{seen}; it is in use, and the service runs")
        elif camera["trouble"]:
            yield wrong(f"{seen}; it cannot be used", camera["trouble"])
        else:
            yield fine(seen)
    if not any(each["driver"] == "picamera2" for each in found):
        yield from _absent(examined, has_any=bool(found))


def _absent(examined: Examined, *, has_any: bool) -> Iterator[Diagnosis]:
    """Tell why there is no camera on a ribbon cable, or none at all."""
    computer, configured = examined.computer, examined.configured.configuration
    driver = configured.camera.driver if configured is not None else ""
    is_stream = configured is not None and getattr(configured.camera.options, "is_stream", False)
    # The kernel makes these nodes when it has found a sensor on a ribbon cable.
    nodes = [computer.text(path) for path in computer.paths("/sys/class/video4linux/video*/name")]
    if any(name.startswith(("unicam", "rp1-cfe")) for name in nodes):
        yield _unread_ribbon(examined)
    elif driver == "picamera2" or (not has_any and driver in {"", "opencv"} and not is_stream):
        seen = "no ribbon camera is found" if has_any else "no camera is found"
        yield wrong(seen, ATTACH_TO_PI if computer.is_pi else ATTACH)
    elif not has_any:
        yield fine("no camera is found, and the configuration needs none")


def _unread_ribbon(examined: Examined) -> Diagnosis:
    if not examined.imports.lacks("picamera2"):
        return unknown(
            "the kernel knows a ribbon camera, and libcamera does not list it",
            "`rpicam-hello --list-cameras`; mend the libraries first, if one does not load",
        )
    return wrong("a ribbon camera is there, and this Python does not see the library picamera2", picamera2_remedy())


def pins(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether pins can be driven."""
    computer, are_needed = examined.computer, bool(examined.configured.pins)
    if not computer.is_pi:
        if are_needed:
            yield wrong("the configuration drives pins, and this is no Raspberry Pi", "run it on one")
    elif examined.imports.lacks(LIBRARIES["pi"]):
        judged = wrong if are_needed else warning
        yield judged("the library lgpio, which drives pins, is not installed", install_line("pi"))
    elif not computer.has("/dev/gpiochip0"):
        yield wrong("there is no /dev/gpiochip0", "`sudo apt full-upgrade`, and restart: the kernel has no driver")
    else:
        yield fine("pins are driven through lgpio")


def serial(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether the system's console, or a program that searches for modems, takes a serial port."""
    computer, configured = examined.computer, examined.configured
    console = re.search(r"console=(ttyAMA\d+|ttyS\d+)", computer.text("/proc/cmdline"))
    if computer.is_pi and console:
        is_on_header = console[1] in ON_HEADER
        where = f"{console[1]} (GPIO 14 and 15)" if is_on_header else console[1]
        if console[1] in map(computer.node, configured.ports) or (is_on_header and {14, 15} & configured.pins):
            yield wrong(
                f"the system's console is on {where}, which the configuration uses",
                "`sudo raspi-config nonint do_serial_cons 1`, and restart",
            )
        else:
            yield fine(f"the system's console is on {where}; leave that free")
    if configured.ports or computer.paths("/dev/tty[UA][SC][BM]*"):
        if computer.is_active("ModemManager.service"):
            seen = "ModemManager runs, and writes to serial ports that it does not know"
            yield warning(seen, "`sudo systemctl disable --now ModemManager`")
        if computer.paths("/usr/lib/udev/rules.d/*brltty*"):
            seen = "brltty is installed, and takes CH340 adapters for Braille displays"
            yield warning(seen, "`sudo apt remove brltty`")
    if found := computer.paths("/dev/serial/by-id/*"):
        yield fine(f"serial ports, by the names that stay right: {', '.join(found)}")


# The configuration, its broker and the service ---------------------------------------------------------------------

# The findings of ``check`` that keep a configuration from running on this computer.
ELSEWHERE = frozenset({"driver-lacks", "will-not-run"})


def configuration(examined: Examined) -> Iterator[Diagnosis]:
    """Tell in a line what ``check`` finds."""
    found = examined.configured
    if found.why_none is not None:
        yield found.why_none
        return
    if found.configuration is None:
        yield unknown(f"there is no {INSTALLED}", "name yours: `stadimeter doctor CONFIG`")
        return
    path, problems = found.configuration.path, found.find_warnings()
    if not problems:
        yield fine(f"{path} can be used, and `check` finds nothing")
        return
    more = f"; and {len(problems) - 1} more" if len(problems) > 1 else ""
    judged = wrong if any(each.code in ELSEWHERE for each in problems) else warning
    yield judged(f"{path}: {problems[0].message}{more}", f"`stadimeter check {path}` shows all")


def broker(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether the broker that the configuration names takes its login."""
    found = examined.configured.configuration
    messenger = found.messenger if found else None
    if messenger is None or not isinstance(messenger.options, ReachesItsPeer):
        return
    if trouble := messenger.options.reach():
        yield wrong(trouble, f'{guide("troubleshooting.md")}, section "MQTT and notifications"')
    else:
        yield fine("the broker takes the connection with the configuration's login")


STATE = ("LoadState", "ActiveState", "SubState", "Result", "NRestarts", "UnitFileState", "StatusText")
RESTARTS_MANY = 3
PAGE = "stadimeter-web.service"


def service(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether the service is installed, enabled and running, and the page's if it is used."""
    state, page = (examined.computer.unit(unit, *STATE) for unit in (UNIT, PAGE))
    if not state:
        yield unknown("the service: systemctl does not answer")
    elif state.get("LoadState") not in {"loaded", "masked"}:
        yield fine("stadimeter is not installed as a service on this computer")
    else:
        yield _judge_unit("the service", UNIT, state)
    if page.get("UnitFileState") == "enabled" or page.get("ActiveState", "inactive") != "inactive":
        yield _judge_unit("the page's service", PAGE, page)


def _judge_unit(what: str, unit: str, state: dict[str, str]) -> Diagnosis:
    active, restarts = state.get("ActiveState"), int(state.get("NRestarts") or 0)
    more = f"{restarts} restarts" + (f", and says: {state['StatusText']}" if state.get("StatusText") else "")
    log = f"`sudo journalctl -eu {unit}`"
    if active == "failed" or state.get("SubState") == "auto-restart":
        return wrong(f"{what} has failed ({state.get('Result', 'no result')}), {more}", log)
    if state.get("LoadState") == "masked":  # systemd knows none of its settings, what it runs after its end among them
        seen = f"{what} is masked: nothing starts it, and nothing switches outputs off if one that runs is killed"
        return wrong(seen, f"`sudo systemctl unmask {unit}`")
    if active != "active":
        return warning(f"{what} is {active or 'in no known state'}", f"`sudo systemctl enable --now {unit}`")
    if restarts > RESTARTS_MANY:
        return warning(f"{what} runs, after {more}", log)
    if state.get("UnitFileState") != "enabled":
        return warning(f"{what} runs, and is not started at boot", f"`sudo systemctl enable {unit}`")
    return fine(f"{what} runs, {more}")


SAFE_OUTPUTS = "/run/stadimeter/safe-outputs.conf"
SWITCHES_OFF = "/usr/lib/stadimeter/safe-outputs"


def safe_outputs(examined: Examined) -> Iterator[Diagnosis]:
    """Compare the outputs that are switched off after the service with those of the configuration, and try the way."""
    computer, wanted = examined.computer, examined.configured.safe_lines
    if not wanted or not examined.is_of_service or not computer.has(SWITCHES_OFF):
        return
    if not computer.is_root:
        yield unknown("whether all outputs can be switched off after the service", SUDO)
        return
    if not computer.has(SAFE_OUTPUTS):
        yield unknown("which outputs are switched off after the service: it lists them when it starts")
        return
    if lacking := set(wanted) - set(computer.text(SAFE_OUTPUTS).splitlines()):
        seen = f"after the service has ended, these are not switched off: {', '.join(sorted(lacking))}"
        yield wrong(seen, f"`sudo systemctl restart stadimeter`, which lists the outputs of {INSTALLED}")
    answer = computer.run((SWITCHES_OFF, "--check"), COMMAND_S)
    way = answer.output.strip() if answer is not None else ""
    if answer is not None and answer.error.strip():
        seen = f"of what is switched off after the service: {answer.error.splitlines()[0]}"
        yield wrong(seen, f"`sudo {SWITCHES_OFF} --check` shows all; mend its file")
    if way in {"", "nothing"}:
        seen = "the pins cannot be switched off after the service, so a killed service leaves them as they are"
        yield wrong(seen, "`sudo apt install raspi-utils`, which brings pinctrl" if way else PACKAGE_AGAIN)
    elif not lacking:
        yield fine(f"outputs are switched off after the service{'' if way == 'no pins' else f', pins by {way}'}")


def watchdogs(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether a hung program, and a hung system, are restarted."""
    computer = examined.computer
    unit = computer.unit(UNIT, "LoadState", "WatchdogUSec")
    if unit.get("LoadState") == "loaded":
        if _is_set(unit.get("WatchdogUSec")):
            yield fine(f"the service is restarted when it hangs for {unit['WatchdogUSec']}")
        else:
            yield warning("the service has no watchdog", "`WatchdogSec=` is missing: install the package anew")
    if computer.is_pi:
        limit = computer.unit("", "RuntimeWatchdogUSec").get("RuntimeWatchdogUSec")
        if _is_set(limit):
            yield fine(f"the board restarts when the system hangs for {limit}")
        else:
            yield warning(
                "the board does not restart when the system hangs",
                "`RuntimeWatchdogSec=15` below `[Manager]` in /etc/systemd/system.conf.d/watchdog.conf, and restart",
            )


def _is_set(duration: str | None) -> bool:
    return duration not in {None, "", "0", "infinity"}


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


CHECKS = (
    Check("This computer", "system", "reading which system this is", system),
    Check("This computer", "supply", "asking for the supply", supply),
    Check("This computer", "speed", "measuring how fast it is", speed),
    Check("This computer", "clock", "asking for the clock", clock),
    Check("This computer", "disk", "reading the free space", disk),
    Check("Python and libraries", "libraries", "loading the libraries", lambda examined: examined.libraries),
    Check("Cameras, pins and ports", "groups", "reading the groups", groups),
    Check("Cameras, pins and ports", "cameras", "listing the cameras", cameras),
    Check("Cameras, pins and ports", "pins", "looking for pins", pins),
    Check("Cameras, pins and ports", "serial", "looking for serial ports", serial),
    Check("Configuration", "configuration", "checking the configuration", configuration),
    Check("Configuration", "broker", "connecting to the broker", broker),
    Check("Service", "service", "asking for the service", service),
    Check("Service", "safe-outputs", "comparing the safe outputs", safe_outputs),
    Check("Service", "watchdogs", "asking for the watchdogs", watchdogs),
)
