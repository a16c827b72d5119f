"""Computers as texts: files and outputs of commands as their systems have them, for the checks of `doctor`.

They were put together from what threads and manuals show, not taken from boards of ours: supply and heat of
raspberrypi/linux #2367 and #2397, consoles of rpi-eeprom #673, gpiochips of raspberrypi/linux #6144 and gpiozero #1216,
nodes of cameras of camera-streamer #3.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.workbench.doctor.checks import CHECKS, CommandResult, Computer, Diagnosis, Examined

GROUP = "root:x:0:\ndialout:x:20:{dialout}\nvideo:x:44:{video}\ngpio:x:986:{gpio}\n"
STATUS = "Name:\tpython\nUid:\t{uid}\t{uid}\t{uid}\t{uid}\nGroups:\t{groups} \n"
OF_UNIT = (
    "LoadState,ActiveState,SubState,Result,NRestarts,UnitFileState,StatusText,FragmentPath,DropInPaths,NeedDaemonReload"
)
SAFE_CHECK = "/usr/lib/stadimeter/safe-outputs --check"
RUNNING = "LoadState=loaded\nActiveState=active\nSubState=running\nResult=success\nNRestarts=0\nUnitFileState=enabled\n"
IMX219 = {
    "name": "imx219", "driver": "picamera2", "device": "/base/soc/i2c0mux/i2c@1/imx219@10", "node": "camera 0",
    "trouble": "",
}  # fmt: skip
WEBCAM = {
    "name": "HD Webcam C615", "driver": "opencv", "device": "/dev/v4l/by-id/usb-046d_HD_Webcam_C615-video-index0",
    "node": "/dev/video0", "trouble": "",
}  # fmt: skip
VENV, APT = "/home/maker/st/lib/python3.11/site-packages", "/usr/lib/python3/dist-packages"


def library(name: str, version: str = "", folder: str = VENV, *, error: str = "", missing: bool = False) -> Any:
    """Return the line of a library, as a Python prints it that imports it."""
    file = "None" if missing else f"{folder}/{name}/__init__.py"
    return {"name": name, "version": version, "file": file, "error": error, "missing": missing}


LOADED = (
    library("numpy", "1.26.4"),
    library("cv2", "4.11.0"),
    library("simplejpeg", "1.8.2"),
    library("pydantic", "2.10.6"),
    library("picamera2", "0.3.30", APT),
    library("lgpio", "", APT),
)


class Captured(Struct, frozen=True, kw_only=True):
    """A computer as texts.

    Attributes:
        files: The text of each file.
        links: Where each link leads to.
        commands: What a command prints that ends well, by its words. Any other command is not installed.
        imports: The lines of the Python that imports the libraries; how it ended.
        complaint: What commands print beside.
        cameras: What `stadimeter cameras --json` prints; None if it crashes.
        holders: What holds each pin that is held.
    """

    files: Mapping[str, str] = field(default_factory=dict)
    links: Mapping[str, str] = field(default_factory=dict)
    commands: Mapping[str, str] = field(default_factory=dict)
    complaint: str = ""
    imports: Sequence[Any] = LOADED
    imports_code: int | None = 0
    cameras: Sequence[Any] | None = ()
    is_clock_right: bool = True
    free_bytes: float = 20e9
    holders: Mapping[int, str] = {}

    def with_files(self, **files: str) -> Captured:
        """Return it with other texts, by names of files as in this module."""
        return replace(self, files={**self.files, **{PLACES[name]: text for name, text in files.items()}})

    def without(self, *paths: str) -> Captured:
        """Return it without some files."""
        return replace(self, files={path: text for path, text in self.files.items() if path not in paths})

    def printing(self, words: str, output: str) -> Captured:
        """Return it with another output of a command."""
        return replace(self, commands={**self.commands, words: output})

    def computer(self, root: Path) -> Computer:
        """Write its files below a root, and return what the checks ask."""
        for path, text in self.files.items():
            file = root / path.lstrip("/")
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
        for path, target in self.links.items():
            link = root / path.lstrip("/")
            link.parent.mkdir(parents=True, exist_ok=True)
            link.symlink_to(target)
        return Computer(
            root=root,
            run=self._run,
            is_clock_right=lambda: self.is_clock_right,
            free_bytes=lambda _path: int(self.free_bytes),
            find_holder=lambda _chip, gpio: self.holders.get(gpio, ""),
        )

    def _run(self, words: Sequence[str], limit_s: float) -> CommandResult | None:
        if "-c" in words:
            return CommandResult(self.imports_code, "".join(f"{json.dumps(line)}\n" for line in self.imports))
        if "cameras" in words:
            return CommandResult(-11, "") if self.cameras is None else CommandResult(0, json.dumps(self.cameras))
        output = self.commands.get(" ".join(words))
        return None if output is None else CommandResult(0, output, self.complaint)


PLACES = {
    "cmdline": "/proc/cmdline",
    "config_txt": "/boot/firmware/config.txt",
    "group": "/etc/group",
    "safe_conf": "/run/stadimeter/safe-outputs.conf",
    "status": "/proc/self/status",
    "video0": "/sys/class/video4linux/video0/name",
}


def _pi(model: str, name: str, cmdline: str, **files: str) -> Captured:
    texts = {
        "/proc/device-tree/model": f"{model}\0",
        "/etc/os-release": f'PRETTY_NAME="{name}"\nNAME="Debian GNU/Linux"\n',
        PLACES["cmdline"]: cmdline,
        PLACES["group"]: GROUP.format(dialout="maker", video="maker", gpio="maker"),
        PLACES["status"]: STATUS.format(uid=1000, groups="20 44 986 1000"),
        "/usr/lib/stadimeter/safe-outputs": "",
        "/dev/gpiochip0": "",
    }
    commands = {
        "vcgencmd get_throttled": "throttled=0x0\n",
        f"systemctl show stadimeter.service --property={OF_UNIT}": RUNNING,
        "systemctl show stadimeter.service --property=LoadState,WatchdogUSec": "LoadState=loaded\nWatchdogUSec=2s\n",
        "systemctl show --property=RuntimeWatchdogUSec": "RuntimeWatchdogUSec=1min\n",
        SAFE_CHECK: "pinctrl\n",
    }
    return Captured(files={**texts, **files}, commands=commands, cameras=(IMX219,))


PI_4 = _pi(
    "Raspberry Pi 4 Model B Rev 1.5",
    "Debian GNU/Linux 12 (bookworm)",
    "coherent_pool=1M 8250.nr_uarts=1 bcm2708_fb.fbwidth=0 vc_mem.mem_base=0x3eb00000 console=ttyS0,115200"
    " console=tty1 root=PARTUUID=51a4c5a1-02 rootfstype=ext4 fsck.repair=yes rootwait\n",
    **{PLACES["video0"]: "unicam-image\n"},
)
"""A Pi 4 with Raspberry Pi OS 12, a ribbon camera, and the service running: nothing is wrong with it."""

PI_5 = replace(
    _pi(
        "Raspberry Pi 5 Model B Rev 1.0",
        "Debian GNU/Linux 13 (trixie)",
        "reboot=w coherent_pool=1M 8250.nr_uarts=1 pci=pcie_bus_safe console=ttyAMA10,115200 console=tty1"
        " root=PARTUUID=a02f18e8-02 rootfstype=ext4 fsck.repair=yes rootwait\n",
        **{PLACES["video0"]: "rp1-cfe-csi2_ch0\n"},
    ),
    links={"/dev/serial0": "ttyAMA10"},
)
"""A Pi 5 with Raspberry Pi OS 13, likewise."""

ZERO_2 = replace(
    _pi(
        "Raspberry Pi Zero 2 W Rev 1.0",
        "Debian GNU/Linux 12 (bookworm)",
        "coherent_pool=1M 8250.nr_uarts=0 console=ttyS0,115200 console=tty1 root=PARTUUID=4e639091-02 rootwait\n",
        **{
            PLACES["status"]: STATUS.format(uid=1000, groups="1000"),
            PLACES["group"]: GROUP.format(dialout="", video="maker", gpio=""),
        },
    ),
    commands={
        "vcgencmd get_throttled": "throttled=0x50005\n",
        f"systemctl show stadimeter.service --property={OF_UNIT}": "LoadState=not-found\nActiveState=inactive\n",
        "systemctl show stadimeter.service --property=LoadState,WatchdogUSec": "LoadState=not-found\nWatchdogUSec=0\n",
        "systemctl show --property=RuntimeWatchdogUSec": "RuntimeWatchdogUSec=0\n",
    },
    cameras=(),
    imports=(*LOADED[:4], library("picamera2", missing=True), library("lgpio", missing=True)),
)
"""A Zero 2 W as its first owner made it: everything that can be forgotten was."""

PC = Captured(
    files={
        "/etc/os-release": 'PRETTY_NAME="Debian GNU/Linux 13 (trixie)"\n',
        PLACES["cmdline"]: "BOOT_IMAGE=/boot/vmlinuz-6.12 root=UUID=9d1c ro quiet\n",
        PLACES["group"]: "root:x:0:\ndialout:x:20:maker\nvideo:x:44:maker\n",
        PLACES["status"]: STATUS.format(uid=1000, groups="20 44 1000"),
    },
    commands={f"systemctl show stadimeter.service --property={OF_UNIT}": "LoadState=not-found\n"},
    imports=(*LOADED[:4], library("picamera2", missing=True), library("lgpio", missing=True)),
    cameras=(WEBCAM,),
)
"""A computer with a webcam that is no Raspberry Pi."""


def examine(captured: Captured, root: Path, *names: str, config: Path | None = None) -> list[Diagnosis]:
    """Return what checks find: those that are named, or all."""
    examined = Examined(captured.computer(root), config)
    return [each for check in CHECKS if check.name in names or not names for each in check.find(examined)]


def only(captured: Captured, root: Path, name: str, config: Path | None = None) -> Diagnosis:
    """Return the one thing that a check finds."""
    (found,) = examine(captured, root, name, config=config)
    return found
