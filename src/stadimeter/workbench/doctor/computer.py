"""Reads facts of a computer: files below a root, and what commands print. Tests put captured texts in its place."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from stadimeter.app.wall_time import is_synchronised

COMMAND_S = 4.0


@dataclass(frozen=True, slots=True)
class Answer:
    """What a command printed before it ended; `code` is None if it was stopped since it took too long."""

    code: int | None
    output: str
    error: str = ""


def run_command(words: Sequence[str], limit_s: float = COMMAND_S) -> Answer | None:
    """Run a command without a shell and without input; None where it is not installed."""
    try:
        done = subprocess.run(  # noqa: S603 - our own words
            words, stdin=subprocess.DEVNULL, capture_output=True, timeout=limit_s, check=False
        )
    except subprocess.TimeoutExpired as late:
        return Answer(None, _text(late.stdout), _text(late.stderr))
    except OSError:
        return None
    return Answer(done.returncode, _text(done.stdout), _text(done.stderr))


def _text(printed: bytes | None) -> str:
    return (printed or b"").decode("utf-8", "replace")


def _free_bytes(path: Path) -> int:
    return shutil.disk_usage(path).free


@dataclass(frozen=True, slots=True, kw_only=True)
class Computer:
    """What the checks may ask.

    Attributes:
        root: Where ``/proc``, ``/sys``, ``/etc`` and ``/boot`` are found.
        run: Runs a command within a time limit in seconds; None where it is not installed.
        is_clock_right: Whether the clock is synchronised.
        free_bytes: The free space of the file system that a path is on; raises `OSError`.
    """

    root: Path = Path("/")
    run: Callable[[Sequence[str], float], Answer | None] = run_command
    environment: Mapping[str, str] = field(default_factory=lambda: os.environ)
    is_clock_right: Callable[[], bool] = is_synchronised
    free_bytes: Callable[[Path], int] = _free_bytes

    def has(self, path: str) -> bool:
        """Return whether there is such a file or folder."""
        return os.path.lexists(self._at(path))

    def is_readable(self, path: str) -> bool:
        """Return whether this user may read a file."""
        return os.access(self._at(path), os.R_OK)

    def text(self, *paths: str) -> str:
        """Return the text of the first of these files that can be read, without spaces around it; else ``""``."""
        for path in paths:
            try:
                return self._at(path).read_text("utf-8", "replace").strip("\0 \n")
            except OSError:
                continue
        return ""

    def paths(self, pattern: str) -> list[str]:
        """Return what fits a pattern such as ``/dev/gpiochip*``, sorted."""
        return sorted(f"/{found.relative_to(self.root)}" for found in self.root.glob(pattern.lstrip("/")))

    def node(self, path: str) -> str:
        """Return the name of the device that a path such as ``/dev/serial0`` leads to."""
        return self._at(path).resolve().name

    def home(self, user: str) -> str:
        """Return the home of a user, or what would be a usual one."""
        lines = [line.split(":") for line in self.text("/etc/passwd").splitlines()]
        return next((fields[5] for fields in lines if fields[0] == user and len(fields) > 5), f"/home/{user}")

    def settings(self, *patterns: str) -> dict[str, str]:
        """Return what files of lines ``KEY=VALUE`` set; later files and lines win."""
        lines = "\n".join(self.text(path) for pattern in patterns for path in self.paths(pattern))
        return {key: value.strip("\"' ") for key, value in re.findall(r"^\s*(\w+)\s*=(.*)$", lines, re.MULTILINE)}

    def prints(self, *words: str) -> str:
        """Return what a command prints, or ``""`` where it fails or is not installed."""
        answer = self.run(words, COMMAND_S)
        return answer.output.strip() if answer is not None and answer.code == 0 else ""

    @property
    def model(self) -> str:
        """The board, such as ``Raspberry Pi 5 Model B Rev 1.0``; empty where the firmware names none."""
        return self.text("/proc/device-tree/model")

    @property
    def is_pi(self) -> bool:
        """Whether this is a Raspberry Pi."""
        return "Raspberry Pi" in self.model

    @property
    def is_root(self) -> bool:
        """Whether this process may read every file."""
        return re.search(r"^Uid:\s+0\s", self.text("/proc/self/status"), re.MULTILINE) is not None

    @property
    def has_systemd(self) -> bool:
        """Whether systemd runs this computer, as ``sd_booted`` finds out."""
        return self.has("/run/systemd/system")

    def unit(self, name: str, *properties: str) -> dict[str, str]:
        """Return properties of a unit of systemd, or of systemd itself for ``""``; nothing where it does not answer."""
        words = ("systemctl", "show", *([name] if name else []), f"--property={','.join(properties)}")
        return dict(line.split("=", 1) for line in self.prints(*words).splitlines() if "=" in line)

    def is_active(self, unit: str) -> bool:
        """Return whether a unit of systemd is active."""
        return self.prints("systemctl", "is-active", unit) == "active"

    def _at(self, path: str) -> Path:
        return self.root / path.lstrip("/")
