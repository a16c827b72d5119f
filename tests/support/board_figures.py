"""The figures of a computer, as `make board` measures them and as people send them: what was measured on, and the file.

Nothing in it names the computer or its user.
"""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Sequence
from math import ceil
from pathlib import Path
from statistics import fmean, median
from typing import Annotated, Literal

import cv2
import numpy as np
from msgspec import Meta, Struct, json

import stadimeter
from stadimeter.app.live.health import temperature_c
from stadimeter.workbench.doctor.computer import Computer

# Version 1 had neither this number nor a start, a temperature or a processor limit, and rates instead of times.
SCHEMA_VERSION: Literal[2] = 2

CGROUPS = Path("/sys/fs/cgroup")

AboveZero = Annotated[float, Meta(gt=0)]
Count = Annotated[int, Meta(ge=1)]
Words = Annotated[str, Meta(max_length=300)]


class _Checked(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Figures that are read again, which may have no fields but these."""


class Platform(_Checked, frozen=True, kw_only=True):
    """Computer and versions that were measured.

    Attributes:
        board: The board, or the processor where there is no board to name.
        machine: The processor's instruction set, such as ``aarch64``.
        cores: Processor cores that the program may use.
        processor_limit: How much processor time the system grants it, in cores, such as 0.5; None for no limit.
        system: The operating system, by its own name.
    """

    board: Words
    machine: Words
    cores: Count
    processor_limit: AboveZero | None
    opencv_threads: Count
    system: Words
    stadimeter: Words
    python: Words
    opencv: Words
    numpy: Words


class Heat(_Checked, frozen=True, kw_only=True):
    """How a board bears the work; None for what it does not tell.

    Attributes:
        throttled: What a Raspberry Pi's ``vcgencmd get_throttled`` says, such as ``0x0``: not slowed since its start.
    """

    temperature_c: float | None
    throttled: Annotated[str, Meta(pattern="^0x[0-9a-fA-F]{1,8}$")] | None


class Times(_Checked, frozen=True, kw_only=True):
    """How long the same work took, again and again.

    Attributes:
        mean_ms: It alone is right under a processor limit: short work runs at full speed there, and then not at all.
    """

    median_ms: AboveZero
    p95_ms: AboveZero
    mean_ms: AboveZero

    @classmethod
    def of(cls, times_s: Sequence[float]) -> Times:
        """Return the figures of at least one time."""
        ordered = sorted(times_s)
        p95_s = ordered[ceil(0.95 * len(ordered)) - 1]
        return cls(median_ms=1e3 * median(ordered), p95_ms=1e3 * p95_s, mean_ms=1e3 * fmean(ordered))


class DetectorSpeed(_Checked, frozen=True, kw_only=True):
    """How fast one detector is on pictures of one size.

    Attributes:
        search: For a picture when nothing is known of where the target is.
        track: For a picture when the target is expected where it is; None if it found none.
        found: In which share of the pictures it found its target.
    """

    detector: Words
    width_px: Count
    height_px: Count
    search: Times
    track: Times | None
    found: Annotated[float, Meta(ge=0, le=1)]


class Latency(_Checked, frozen=True, kw_only=True):
    """Latency from the arrival of a frame until every actuator has its command, in the demonstration's run."""

    frames: Annotated[int, Meta(ge=0)]
    p50_ms: AboveZero | None
    p95_ms: AboveZero | None
    p99_ms: AboveZero | None


class OwnRun(_Checked, frozen=True, kw_only=True):
    """A run of its own program over pictures of a ball, as small as a run can be.

    Attributes:
        first_command_s: From the start of the program until every output had its first command.
        peak_memory_mb: The most memory that it had, in 10⁶ bytes.
    """

    first_command_s: AboveZero
    peak_memory_mb: AboveZero


class Figures(_Checked, frozen=True, kw_only=True):
    """All figures of a computer.

    Attributes:
        note: A remark on the measurement, such as the case and the cooling.
    """

    schema_version: Literal[2]
    note: Words
    computer: Platform
    before: Heat
    after: Heat
    run: OwnRun
    latency: Latency
    detectors: Annotated[tuple[DetectorSpeed, ...], Meta(min_length=1, max_length=1000)]


def to_json(figures: Figures) -> str:
    """Return figures as the text of a file."""
    return json.encode(figures).decode()


def this_computer(cgroups: Path = CGROUPS) -> Platform:
    """Return what this program runs on."""
    return Platform(
        board=_board(),
        machine=platform.machine(),
        cores=len(os.sched_getaffinity(0)),
        processor_limit=processor_limit(cgroups),
        opencv_threads=cv2.getNumThreads(),
        system=platform.freedesktop_os_release().get("PRETTY_NAME", "Linux"),
        stadimeter=stadimeter.__version__,
        python=platform.python_version(),
        opencv=cv2.__version__,
        numpy=np.__version__,
    )


def heat() -> Heat:
    """Return how warm this computer is, and whether it was slowed for heat or for its supply."""
    return Heat(temperature_c=temperature_c(), throttled=_throttle_flags())


def _throttle_flags() -> str | None:
    found = re.search(r"throttled=(0x[0-9a-fA-F]{1,8})", Computer().prints("vcgencmd", "get_throttled"))
    return found[1] if found else None


def processor_limit(cgroups: Path = CGROUPS) -> float | None:
    """Return how many cores' time the control groups of this process are granted; None for no limit.

    Linux documentation, "Control Group v2", ``cpu.max``: a quota and a period, for each group and those it is in.
    """
    try:
        lines = Path("/proc/self/cgroup").read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    groups = [cgroups / line.removeprefix("0::/") for line in lines if line.startswith("0::")]
    folders = [folder for group in groups for folder in (group, *group.parents) if folder.is_relative_to(cgroups)]
    return min(filter(None, map(_limit_in, folders)), default=None)


def _limit_in(folder: Path) -> float | None:
    try:
        quota, period = (folder / "cpu.max").read_text(encoding="ascii").split()
        return int(quota) / int(period)
    except (OSError, ValueError):  # no such file in this group, or "max"
        return None


def _board() -> str:
    computer = Computer()
    named = re.search(r"^model name\s*:\s*(.+)$", computer.text("/proc/cpuinfo"), re.MULTILINE)
    return computer.model or (named[1].strip() if named else platform.machine())
