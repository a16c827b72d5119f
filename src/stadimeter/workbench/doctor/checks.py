"""The checks of a computer, and their table: the board, its devices, the configuration, its broker and the service.

Sources: Raspberry Pi's documentation ("Raspberry Pi OS": ``vcgencmd``; "Configuration": ``config.txt``, UARTs; "Camera
software"), the kernel's drivers ``unicam`` and ``rp1-cfe`` of its two camera ports and its ``/sys/class/watchdog``,
gpiozero's choice of a gpiochip (``pins/lgpio.py``), systemctl(1), systemd.service(5), systemd-system.conf(5),
journald.conf(5) and proc(5). Raspberry Pi OS keeps the log in memory since 2025, by a drop-in of journald.conf
(raspberrypi-sys-mods #110).
"""

from __future__ import annotations

import json
import re
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from msgspec import Struct

from stadimeter.app.live.health import HOT_C, THROTTLED_C, is_under_voltage, temperature_c, throttling
from stadimeter.config.extras import (
    LIBRARIES,
    PACKAGE_AGAIN,
    PACKAGED,
    PICAMERA2,
    PICAMERA2_UNSEEN,
    SEE_SYSTEM,
    guide,
    install_line,
)
from stadimeter.messaging.protocol import ReachesItsPeer
from stadimeter.workbench.doctor.computer import (
    COMMAND_S,
    INSTALLED,
    SUDO,
    UNIT,
    Computer,
    Diagnosis,
    Examined,
    fine,
    python_command,
    unknown,
    warning,
    wrong,
)

# The board: its supply, heat, clock and disk -----------------------------------------------------------------------

SUPPLY = (
    "use the supply for the board (5 V and 3 A; 5 A for a Pi 5) and a short, thick cable, and another one for motors"
)
COOL = "a heat sink or a fan, and air around the board"
# To load the libraries takes a Zero 2 W some seconds.
SPEED_S = 30.0
SCARCE_BYTES = 100e6
LOW_BYTES = 500e6


def system(examined: Examined) -> Iterator[Diagnosis]:
    """Tell which board and system this is."""
    computer = examined.computer
    name = computer.settings("/etc/os-release").get("PRETTY_NAME", "an unknown system")
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
        yield _supply_by_kernel(is_under_voltage(computer.root))
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


def _supply_by_kernel(is_low: bool | None) -> Diagnosis:
    if is_low is None:
        return unknown("whether the supply suffices: neither vcgencmd nor the kernel says")
    if is_low:
        return wrong("under-voltage now, says the kernel", SUPPLY)
    return fine("no under-voltage now, says the kernel; vcgencmd, which knows the past, does not answer")


def temperature(examined: Examined) -> Iterator[Diagnosis]:
    """Tell how hot the processor is."""
    celsius = temperature_c(examined.computer.root)
    if celsius is None:
        yield unknown("the processor's temperature: the kernel does not say")
    elif celsius >= THROTTLED_C:
        yield wrong(f"the processor is at {celsius:.0f} °C, where it is slowed down", COOL)
    elif celsius >= HOT_C:
        yield warning(f"the processor is at {celsius:.0f} °C; from {THROTTLED_C:.0f} °C on it is slowed down", COOL)
    else:
        yield fine(f"the processor is at {celsius:.0f} °C")


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
    for place in ("/var/lib/stadimeter", "/var", "/"):
        if computer.has(place):
            break
    try:
        free = computer.free_bytes(computer.root / place.lstrip("/"))
    except OSError as error:
        yield unknown(f"the free space below {place}: {error.strerror}")
        return
    seen = f"{free / 1e9:.1f} GB are free below {place}"
    if mount := _read_only(computer, Path(place)):
        remedy = f"`sudo dmesg` says why; `sudo mount -o remount,rw {mount}` where nothing else is wrong"
        yield wrong(f"{seen}, and nothing can be written there: {mount} is mounted read-only", remedy)
        return
    remedy = "delete old journals and recordings (`sudo du -xh / | sort -h | tail` finds what is large)"
    if free < SCARCE_BYTES:
        yield wrong(seen, remedy)
    elif free < LOW_BYTES:
        yield warning(seen, remedy)
    else:
        yield fine(seen)


def _read_only(computer: Computer, place: Path) -> str:
    """Return the mount that a place is on if it is read-only, as after an error of a memory card; else nothing."""
    for folder in map(str, (place, *place.parents)):
        if mount := _mount(computer, folder):
            return folder if "ro" in mount[1].split(",") else ""
    return ""


def wear(examined: Examined) -> Iterator[Diagnosis]:
    """Tell what writes to a memory card that need not; nothing where the system is on another disk."""
    computer = examined.computer
    root = _mount(computer, "/")
    if root is None or "mmcblk" not in root[0]:
        return
    troubles = list(_wearing(computer, root[1]))
    yield from troubles
    if not troubles:
        yield fine("the memory card is spared: the system's log is in memory, noatime, no swap on it")


def _wearing(computer: Computer, options: str) -> Iterator[Diagnosis]:
    if _is_journal_kept(computer):
        yield warning(
            "the system's log is written to the memory card",
            "`Storage=volatile` below `[Journal]` in /etc/systemd/journald.conf.d/volatile.conf",
        )
    if not {"noatime", "ro"} & set(options.split(",")):
        yield warning("each reading of a file is noted on the memory card", "add `noatime` to / in /etc/fstab")
    swaps = [line.split()[0] for line in computer.text("/proc/swaps").splitlines()[1:]]
    on_card = [swap for swap in swaps if not re.match(r"/dev/(zram|sd|nvme)", swap)]
    if on_card:
        off = "sudo systemctl disable --now dphys-swapfile" if "/var/swap" in on_card else f"sudo swapoff {on_card[0]}"
        yield warning(f"memory is swapped to the card ({on_card[0]})", f"`{off}`, if 512 MB or more are free without")


def _mount(computer: Computer, place: str) -> tuple[str, str] | None:
    """Return the device and the options of what is mounted at a place; ``/dev/root`` is named as the kernel got it."""
    for line in reversed(computer.text("/proc/mounts").splitlines()):
        device, where, _kind, options, *_ = line.split()
        if where == place:
            return _real_root(computer) if device == "/dev/root" else device, options
    return None


def _real_root(computer: Computer) -> str:
    return "/dev/mmcblk0" if computer.has("/sys/block/mmcblk0") and not computer.paths("/sys/block/nvme*") else ""


def _is_journal_kept(computer: Computer) -> bool:
    """Check whether journald writes to the disk. Drop-ins win over the main file, by their names."""
    folders = ("/usr/lib/systemd/journald.conf.d", "/etc/systemd/journald.conf.d")
    parts = [part for folder in folders for part in computer.paths(f"{folder}/*.conf")]
    files = ["/etc/systemd/journald.conf", *sorted(parts, key=lambda path: Path(path).name)]
    storage = computer.settings(*files).get("Storage", "auto")
    return storage == "persistent" or (storage == "auto" and computer.has("/var/log/journal"))


# Groups, cameras, pins and serial ports ----------------------------------------------------------------------------

# The drivers of cameras that are plugged in.
GROUPS = {"video": "cameras", "dialout": "serial ports", "gpio": "pins"}
LIST_S = 20.0
IN_USE = "another program is using it"
ATTACHED = ("opencv", "picamera2")

# The serial ports of GPIO 14 and 15. The console of a Pi 5 is on a connector of its own, as ttyAMA10.
CONFIG_TXT = ("/boot/firmware/config.txt", "/boot/config.txt")
ON_HEADER = ("ttyAMA0", "ttyS0")


def groups(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether this user may use cameras, serial ports and pins: by the group file, and by this process."""
    computer = examined.computer
    ids = _ids(computer)
    if not ids["Uid"]:
        yield unknown("which user this is: the kernel does not say")
        return
    sudo = computer.environment.get("SUDO_USER", "") if ids["Uid"][0] == "0" else ""
    user = sudo or next((each[0] for each in computer.users() if each[2:3] == ids["Uid"][:1]), ids["Uid"][0])
    if user == "root":
        yield fine("root may use every device; other users need the groups video, dialout and gpio")
        return
    lines = [line.split(":") for line in computer.text("/etc/group").splitlines() if line.count(":") == 3]
    table = {name: (number, members.split(",")) for name, _password, number, members in lines}
    troubles = [
        trouble
        for group, what in GROUPS.items()
        if group in table and (group != "gpio" or computer.is_pi)
        for trouble in _lacking(examined, user, (group, what), table[group], set() if sudo else set(ids["Groups"]))
    ]
    yield from troubles
    if not troubles:
        yield fine(f"the user {user} may use cameras, serial ports{' and pins' if computer.is_pi else ''}")


def _lacking(
    examined: Examined, user: str, group: tuple[str, str], entry: tuple[str, list[str]], of_process: set[str]
) -> Iterator[Diagnosis]:
    (name, what), (number, members) = group, entry
    if number in of_process:
        return
    if user not in members:
        judged = wrong if name in _groups_needed(examined) else warning
        yield judged(
            f"the user {user} is not in the group {name}, which may use {what}",
            f"`sudo usermod -aG {name} {user}`, then log out and in again",
        )
    elif of_process:
        yield wrong(
            f"the user {user} is in the group {name} since the last login only, so this login may not use {what}",
            "log out and in again, or restart",
        )


def _groups_needed(examined: Examined) -> set[str]:
    found = examined.configured
    if found.configuration is None or examined.is_of_service:  # the service has the groups of its unit
        return set()
    needed = {"video": found.configuration.camera.driver in ATTACHED, "dialout": found.ports, "gpio": found.pins}
    return {group for group, why in needed.items() if why}


def _ids(computer: Computer) -> dict[str, list[str]]:
    """Return the user and the groups of this process, as the kernel knows them."""
    lines = dict(line.split(":", 1) for line in computer.text("/proc/self/status").splitlines() if ":" in line)
    return {key: lines.get(key, "").split() for key in ("Uid", "Groups")}


def cameras(examined: Examined) -> Iterator[Diagnosis]:
    """Tell which cameras are there, by which stack, and what keeps one from being used."""
    found = _list_cameras(examined.computer)
    if found is None:
        yield unknown("the cameras could not be listed", "`stadimeter cameras` says why")
        return
    for camera in found:
        stack = "libcamera" if camera["driver"] == "picamera2" else "V4L2"
        seen = f"{camera['name']}, by {stack}: {camera['device']}"
        if camera["trouble"].startswith(IN_USE) and examined.computer.is_active(UNIT):
            yield fine(f"{seen}; it is in use, and the service runs")
        elif camera["trouble"]:
            yield wrong(f"{seen}; it cannot be used", camera["trouble"])
        else:
            yield fine(seen)
    yield from _ribbon(examined, has_any=bool(found), has_ribbon=any(each["driver"] == "picamera2" for each in found))


def _list_cameras(computer: Computer) -> list[dict[str, Any]] | None:
    answer = computer.run((*python_command(), "-m", "stadimeter", "cameras", "--no-try", "--json"), LIST_S)
    try:
        found: list[dict[str, Any]] = json.loads(answer.output if answer is not None else "")
    except ValueError:
        return None
    return found


def _ribbon(examined: Examined, *, has_any: bool, has_ribbon: bool) -> Iterator[Diagnosis]:
    """Tell why there is no camera on a ribbon cable, or none at all."""
    computer, found = examined.computer, examined.configured.configuration
    driver = found.camera.driver if found is not None else ""
    if computer.is_pi and not has_ribbon:
        config = computer.text(*CONFIG_TXT)
        if re.search(r"^\s*start_x\s*=\s*1", config, re.MULTILINE):
            yield wrong(
                "config.txt asks for the legacy camera stack (start_x=1), which this system no longer has",
                f"remove that line in {CONFIG_TXT[0]}, write `camera_auto_detect=1`, and restart",
            )
            return
        if _has_sensor(computer):
            yield _why_unseen(examined)
            return
        if driver == "picamera2" or not (driver or has_any):
            yield _no_sensor(computer, config, has_any=has_any)
            return
    if has_any:
        return
    seen = "no camera is found on this computer"
    is_stream = found is not None and getattr(found.camera.options, "is_stream", False)
    if not driver or (driver in ATTACHED and not is_stream):
        yield wrong(seen, "plug one in; `ls /dev/video*` lists those that the kernel knows")
    else:
        yield fine(f"{seen}, and the configuration needs none")


def _has_sensor(computer: Computer) -> bool:
    """Check whether the kernel has found a sensor on a ribbon cable: only then it makes these nodes."""
    names = [computer.text(path) for path in computer.paths("/sys/class/video4linux/video*/name")]
    return any(name.startswith(("unicam", "rp1-cfe")) for name in names)


def _why_unseen(examined: Examined) -> Diagnosis:
    if not examined.imports.lacks("picamera2"):
        return unknown(
            "the kernel knows a ribbon camera, and libcamera does not list it",
            "`rpicam-hello --list-cameras`; mend the libraries first, if one does not load",
        )
    if sys.prefix.startswith(PACKAGED):  # it sees the system's packages
        return wrong("a ribbon camera is there, and the library picamera2 is not", PICAMERA2)
    if examined.computer.has(PICAMERA2_UNSEEN):
        return wrong("a ribbon camera is there, but this Python environment does not see picamera2", SEE_SYSTEM)
    return wrong("a ribbon camera is there, and the library picamera2 is not", f"{PICAMERA2}, and {SEE_SYSTEM}")


def _no_sensor(computer: Computer, config: str, *, has_any: bool) -> Diagnosis:
    seen = "no ribbon camera is found" if has_any else "no camera is found, on USB or on a ribbon cable"
    if not computer.paths("/dev/media*"):
        return wrong(
            f"{seen}: the system's kernel does not support ribbon cameras (there is no /dev/media0)",
            "use a USB camera, or Raspberry Pi OS, whose kernel does",
        )
    if re.search(r"^\s*camera_auto_detect\s*=\s*0", config, re.MULTILINE):
        return wrong(
            f"{seen}, and config.txt turns the detection of the latter off",
            f"`camera_auto_detect=1` in {CONFIG_TXT[0]}, and restart",
        )
    return wrong(
        f"{seen}: none is plugged in, or its cable is loose or the wrong way round",
        "switch off, plug the cable in anew (a Pi 5 and a Zero need the narrow one), `rpicam-hello --list-cameras`; "
        "a module that is not Raspberry Pi's own needs its `dtoverlay` in config.txt",
    )


def pins(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether pins can be driven, and through what."""
    computer = examined.computer
    if not computer.is_pi:
        if examined.configured.pins:
            yield wrong("the configuration drives pins, and this is no Raspberry Pi", "run it on one")
        return
    factory = computer.environment.get("GPIOZERO_PIN_FACTORY", "lgpio")
    chips = [Path(path).name for path in computer.paths("/dev/gpiochip*")]
    if factory == "mock":
        yield warning("GPIOZERO_PIN_FACTORY=mock: pins are driven in memory only", "`unset GPIOZERO_PIN_FACTORY`")
    elif factory != "lgpio":
        yield wrong(f"GPIOZERO_PIN_FACTORY={factory}: pins are driven through lgpio", "`unset GPIOZERO_PIN_FACTORY`")
    elif examined.imports.lacks(LIBRARIES["pi"]):
        judged = wrong if examined.configured.pins else warning
        yield judged("the library lgpio, which drives pins, is not installed", install_line("pi"))
    elif "gpiochip0" not in chips:
        yield wrong("there is no /dev/gpiochip0", "`sudo apt full-upgrade`, and restart: the kernel has no driver")
    else:
        is_pi_5 = "Raspberry Pi 5" in computer.model  # gpiozero takes chip 4 there, if there is one
        chip = "gpiochip4" if is_pi_5 and "gpiochip4" in chips else "gpiochip0"
        yield fine(f"pins are driven through lgpio, by /dev/{chip}")


def serial(examined: Examined) -> Iterator[Diagnosis]:
    """Tell whether the system's console, or a program that searches for modems, takes a serial port."""
    computer = examined.computer
    console = re.search(r"console=(ttyAMA\d+|ttyS\d+)", computer.text("/proc/cmdline"))
    if computer.is_pi and console:
        is_used = console[1] in map(computer.node, examined.configured.ports) or (
            console[1] in ON_HEADER and {14, 15} & examined.configured.pins
        )
        where = f"{console[1]} (GPIO 14 and 15)" if console[1] in ON_HEADER else console[1]
        if is_used:
            yield wrong(
                f"the system's console is on {where}, which the configuration uses",
                "`sudo raspi-config nonint do_serial_cons 1`, and restart",
            )
        else:
            yield fine(f"the system's console is on {where}; leave that free")
    if examined.configured.ports or computer.paths("/dev/tty[UA][SC][BM]*"):
        yield from _takers(computer)
    found = computer.paths("/dev/serial/by-id/*")
    if found:
        yield fine(f"serial ports, by the names that stay right: {', '.join(found)}")


def _takers(computer: Computer) -> Iterator[Diagnosis]:
    if computer.is_active("ModemManager.service"):
        yield warning(
            "ModemManager runs, and writes to serial ports that it does not know",
            "`sudo systemctl disable --now ModemManager`",
        )
    if computer.paths("/usr/lib/udev/rules.d/*brltty*"):
        yield warning("brltty is installed, and takes CH340 adapters for Braille displays", "`sudo apt remove brltty`")


# The configuration, its broker and the service ---------------------------------------------------------------------

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
    Check("This computer", "temperature", "reading the temperature", temperature),
    Check("This computer", "speed", "measuring how fast it is", speed),
    Check("This computer", "clock", "asking for the clock", clock),
    Check("This computer", "disk", "reading the free space", disk),
    Check("This computer", "wear", "reading what is written to the card", wear),
    Check("Python and libraries", "libraries", "loading the libraries", lambda examined: examined.libraries),
    Check("Cameras, pins and ports", "groups", "reading the groups", groups),
    Check("Cameras, pins and ports", "cameras", "listing the cameras", cameras),
    Check("Cameras, pins and ports", "pins", "looking for pins", pins),
    Check("Cameras, pins and ports", "serial", "looking for serial ports", serial),
    Check("Configuration", "configuration", "checking the configuration", configuration),
    Check("Configuration", "broker", "connecting to the broker", broker),
    Check("Service", "service", "asking for the service", service),
    Check("Service", "page", "asking for the page's service", page),
    Check("Service", "path", "looking for other programs of this name", path),
    Check("Service", "safe-outputs", "comparing the safe outputs", safe_outputs),
    Check("Service", "watchdogs", "asking for the watchdogs", watchdogs),
)
