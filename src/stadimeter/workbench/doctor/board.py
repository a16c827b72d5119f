"""The board: its supply, heat, clock and disk.

Sources: Raspberry Pi's documentation ("Raspberry Pi OS": ``vcgencmd``), journald.conf(5) and proc(5). Raspberry Pi OS
keeps the log in memory since 2025, by a drop-in of journald.conf (raspberrypi-sys-mods #110).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from stadimeter.app.live.health import HOT_C, THROTTLED_C, is_under_voltage, temperature_c, throttling
from stadimeter.workbench.doctor.computer import Computer, Diagnosis, fine, python_command, unknown, warning, wrong
from stadimeter.workbench.doctor.examined import Examined

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
