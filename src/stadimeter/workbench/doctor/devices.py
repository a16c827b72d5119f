"""Groups, cameras, pins and serial ports.

Sources: Raspberry Pi's documentation ("Configuration": ``config.txt``, UARTs; "Camera software"), the kernel's drivers
``unicam`` and ``rp1-cfe`` of its two camera ports, and gpiozero's choice of a gpiochip (``pins/lgpio.py``).
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from stadimeter.config.extras import LIBRARIES, PACKAGED, PICAMERA2, PICAMERA2_UNSEEN, SEE_SYSTEM, install_line
from stadimeter.workbench.doctor.computer import Computer, Diagnosis, fine, python_command, unknown, warning, wrong
from stadimeter.workbench.doctor.examined import UNIT, Examined

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
