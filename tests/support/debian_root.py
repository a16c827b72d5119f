"""Root file systems of Debian to install into, and one with a systemd of its own as process 1 of a namespace."""

from __future__ import annotations

import ctypes
import os
import shlex
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

import pytest
from msgspec import Struct

from stadimeter.testing.rig import eventually
from support.programs import why_missing

# Root file systems of Debian to install into: made once by debootstrap, and then a layer for each trial.

CLONE_NEWNS = 0x20000
"""Of `unshare(2)`; `os.unshare` came with Python 3.12."""

MIRROR = "http://deb.debian.org/debian"

Done = subprocess.CompletedProcess[str]


class DebianRoot(Struct, frozen=True):
    """A root file system; commands run inside of it, by chroot."""

    path: Path

    def __truediv__(self, place: str) -> Path:
        """Return where a place of the root is outside of it."""
        return self.path / place.removeprefix("/")

    def try_to(self, *command: str, **options: object) -> Done:
        """Run a command, whatever becomes of it."""
        return subprocess.run(
            self.command(*command),
            capture_output=True,
            text=True,
            check=False,
            **options,  # type: ignore[call-overload]
        )

    def run(self, *command: str) -> str:
        """Run a command that must succeed, and return what it printed."""
        done = self.try_to(*command)
        assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        return done.stdout

    def command(self, *command: str) -> list[str]:
        """Return a command that runs another one inside of the root."""
        around = ["env", "-i", "PATH=/usr/sbin:/usr/bin:/sbin:/bin", "DEBIAN_FRONTEND=noninteractive", "LC_ALL=C.UTF-8"]
        # Where arm64 is emulated: a Pi 4's processor. QEMU 7.2's own default has vector instructions (SVE) with which
        # numpy multiplies matrices wrongly.
        return ["chroot", str(self.path), *around, "QEMU_CPU=cortex-a72", *command]

    def install(self, package: Path) -> Done:
        """Install a package as people do, with what it depends on."""
        shutil.copy(package, self / "/root")
        options = ("--yes", "--no-install-recommends", "--allow-downgrades")
        return self.try_to("apt-get", "install", *options, f"/root/{package.name}")


def why_no_root() -> str:
    """Return why no root file system can be made here, or an empty string."""
    if os.geteuid() != 0:
        return "only root may make root file systems"
    return why_missing("debootstrap", "dpkg-deb")


def make_root(folder: Path, release: str, architecture: str) -> DebianRoot:
    """Make the smallest root that has apt. Another architecture than this computer's needs qemu-user-static.

    The test is skipped where debootstrap cannot do it: without a network, or without the right to make device files.
    """
    command = ["debootstrap", "--variant=minbase", f"--arch={architecture}", release, folder, MIRROR]
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except subprocess.CalledProcessError as error:
        pytest.skip(f"debootstrap makes no root here: {(error.stdout + error.stderr).strip()[-300:]}")
    finally:  # if it was interrupted; whoever deletes the folder must not meet the computer's own /proc
        for mounted in ("proc", "sys"):
            subprocess.run(["umount", "--lazy", folder / mounted], check=False, capture_output=True)
    # A root that is thrown away need not survive a power cut: flushing takes most of the time.
    (folder / "etc/dpkg/dpkg.cfg.d/unsafe-io").write_text("force-unsafe-io\n")
    return DebianRoot(folder)


@contextmanager
def layered(below: Path, folder: Path) -> Iterator[DebianRoot]:
    """Make a root that begins as the one below, and leaves that as it is.

    Raises `subprocess.CalledProcessError` where nothing can be mounted.
    """
    _leave_the_mounts_of_others()
    upper, work, root = (folder / name for name in ("upper", "work", "root"))
    for each in (upper, work, root):
        each.mkdir(parents=True)
    layers = f"lowerdir={below},upperdir={upper},workdir={work}"
    _mount("-t", "overlay", "overlay", "-o", layers, str(root))
    try:
        _mount("-t", "proc", "proc", str(root / "proc"))
        shutil.copy("/etc/resolv.conf", root / "etc/resolv.conf")
        yield DebianRoot(root)
    finally:
        subprocess.run(["umount", "--recursive", "--lazy", str(root)], check=True, capture_output=True)
        shutil.rmtree(folder)


@cache
def _leave_the_mounts_of_others() -> None:
    """Give this thread mounts of its own: what it mounts is gone with the process, however that ends."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(CLONE_NEWNS):
        raise subprocess.CalledProcessError(1, "unshare", stderr=os.strerror(ctypes.get_errno()))
    _mount("--make-rprivate", "/")


def _mount(*arguments: str) -> None:
    subprocess.run(["mount", *arguments], check=True, capture_output=True)


# A Debian root with a systemd of its own that runs as process 1 of a namespace: a computer in all that a service sees.
#
# Cgroups are those of version 1 or 2, whichever this computer has; the namespace has a part of its own in them.

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


def root_to_boot(folder: Path, *packages: str) -> Path:
    """Return a root with systemd, dbus and more: that of ``BOOTED_ROOT``, or one that is made; else the test skips."""
    root = Path(os.environ.get("BOOTED_ROOT") or folder / "root")
    if not root.exists():
        make_root(root, "bookworm", subprocess.check_output(["dpkg", "--print-architecture"], text=True).strip())
    shutil.copy("/etc/resolv.conf", root / "etc/resolv.conf")
    needed = ("systemd", "dbus", *packages)
    if DebianRoot(root).try_to("apt-get", "install", "--yes", "--no-install-recommends", *needed).returncode:
        pytest.skip("no packages can be had here")
    return root


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
    apart = ("--pid", "--mount", "--uts", "--ipc", "--cgroup", "--fork", "--kill-child")
    command = ["unshare", *apart, "sh", "-c", script]
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
