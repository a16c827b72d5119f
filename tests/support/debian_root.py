"""Root file systems of Debian to install into: made once by debootstrap, and then a layer for each trial."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from msgspec import Struct

from support.programs import why_missing

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


def _mount(*arguments: str) -> None:
    subprocess.run(["mount", *arguments], check=True, capture_output=True)
