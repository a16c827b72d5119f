"""A Debian root with a systemd of its own that runs as process 1 of a namespace: a computer in all that a service sees.

Cgroups are those of version 1 or 2, whichever this computer has; the namespace has a part of its own in them.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from msgspec import Struct

from stadimeter.testing.rig import eventually

MASKED = ("systemd-sysctl.service", "systemd-binfmt.service", "systemd-modules-load.service", "getty.target")
"""What would change this computer, or wants its console."""

BOOT = """
set -e
mount --make-rprivate /
mount --rbind {root} {root}
cd {root}
mount -t proc proc proc
mount -t sysfs -o ro sysfs sys
mount -t tmpfs tmpfs run
mount -t tmpfs tmpfs tmp
mount --rbind /dev dev
for folder in {folders}; do mkdir -p .$folder; mount --bind $folder .$folder; mount -o remount,ro,bind .$folder; done
if [ -e /sys/fs/cgroup/cgroup.controllers ]; then
    mount -t cgroup2 cgroup2 sys/fs/cgroup
else
    mount -t tmpfs -o mode=755 tmpfs sys/fs/cgroup
    for each in systemd devices; do mkdir sys/fs/cgroup/$each; done
    mount --bind /sys/fs/cgroup/systemd/{name} sys/fs/cgroup/systemd
    mount --bind /sys/fs/cgroup/devices/{name} sys/fs/cgroup/devices
fi
exec env -i container=lxc PATH=/usr/sbin:/usr/bin:/sbin:/bin chroot . /lib/systemd/systemd --system
"""

BOOTED_WITHIN_S = 60.0


class Booted(Struct, frozen=True):
    """A root whose systemd runs."""

    root: Path
    process_1: int

    def run(self, script: str, *, timeout_s: float = 60.0) -> str:
        """Run a shell script inside, and return what it printed."""
        enter = ["nsenter", "-t", str(self.process_1), "-p", "-m", "-u", "-i", "-r", "-w", "sh", "-c", script]
        done = subprocess.run(enter, capture_output=True, text=True, timeout=timeout_s, check=False)
        return done.stdout + done.stderr


@contextmanager
def booted(root: Path, folders: tuple[Path, ...]) -> Iterator[Booted]:
    """Boot a root in which systemd and dbus are installed.

    Args:
        folders: Of this computer, seen inside at the same place, read-only.

    Raises `RuntimeError` where that is not possible.
    """
    name = f"booted-{os.getpid()}"
    for unit in MASKED:
        link = root / "etc/systemd/system" / unit
        link.unlink(missing_ok=True)
        link.symlink_to("/dev/null")
    parts = [Path("/sys/fs/cgroup") / each / name for each in ("systemd", "devices")]
    for part in parts:
        if part.parent.is_dir():
            part.mkdir()
    script = BOOT.format(root=shlex.quote(str(root)), folders=" ".join(map(shlex.quote, map(str, folders))), name=name)
    command = [
        "unshare",
        "--pid",
        "--mount",
        "--uts",
        "--ipc",
        "--cgroup",
        "--fork",
        "--kill-child",
        "sh",
        "-c",
        script,
    ]
    outside = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    try:
        yield Booted(root, _process_1(outside))
    finally:
        outside.kill()
        outside.communicate()
        for part in parts:
            _remove_groups(part)


def _process_1(outside: subprocess.Popen[bytes]) -> int:
    children = Path(f"/proc/{outside.pid}/task/{outside.pid}/children")
    ends_s = time.monotonic() + BOOTED_WITHIN_S
    while outside.poll() is None and time.monotonic() < ends_s:
        if found := children.read_text().split():
            state = Booted(Path("/"), int(found[0])).run("systemctl is-system-running").strip()
            if state in {"running", "degraded"}:
                return int(found[0])
        time.sleep(0.2)
    said = outside.stderr.read().decode() if outside.poll() is not None and outside.stderr else "it did not boot"
    raise RuntimeError(said)


def _remove_groups(part: Path) -> None:
    """Remove a part of the cgroups of version 1: its folders only, from the innermost on; their files are not files.

    Processes that were killed a moment ago may still be in one.
    """

    def remove() -> bool:
        with suppress(OSError):
            for folder, _, _ in os.walk(part, topdown=False):
                Path(folder).rmdir()
        return not part.exists()

    eventually(remove)
