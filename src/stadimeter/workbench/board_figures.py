"""The figures of a computer, as `bench` measures them and as people send them: what was measured on, and the file.

Nothing in it names the computer or its user.
"""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from statistics import fmean, median
from typing import Annotated, ClassVar, Literal

import cv2
import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

import stadimeter
from stadimeter.app.board_health import temperature_c
from stadimeter.config.untrusted_file import JSON_MAX_BYTES, read_untrusted
from stadimeter.errors import UnreadableError
from stadimeter.workbench.doctor.computer import Computer

# Version 1 had neither this number nor a start, a temperature or a processor limit, and rates instead of times.
SCHEMA_VERSION: Literal[2] = 2

CGROUPS = Path("/sys/fs/cgroup")

AboveZero = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]
Words = Annotated[str, Field(max_length=300)]


class _Checked:
    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid", allow_inf_nan=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Platform(_Checked):
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Heat(_Checked):
    """How a board bears the work; None for what it does not tell.

    Attributes:
        throttled: What a Raspberry Pi's ``vcgencmd get_throttled`` says, such as ``0x0``: not slowed since its start.
    """

    temperature_c: float | None
    throttled: Annotated[str, Field(pattern="^0x[0-9a-fA-F]{1,8}$")] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Times(_Checked):
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


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectorSpeed(_Checked):
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
    found: Annotated[float, Field(ge=0, le=1)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Latency(_Checked):
    """Latency from the arrival of a frame until every actuator has its command, in the demonstration's run."""

    frames: Annotated[int, Field(ge=0)]
    p50_ms: AboveZero | None
    p95_ms: AboveZero | None
    p99_ms: AboveZero | None


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnRun(_Checked):
    """A run of its own program over pictures of a ball, as small as a run can be.

    Attributes:
        first_command_s: From the start of the program until every output had its first command.
        peak_memory_mb: The most memory that it had, in 10⁶ bytes.
    """

    first_command_s: AboveZero
    peak_memory_mb: AboveZero


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures(_Checked):
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
    detectors: Annotated[tuple[DetectorSpeed, ...], Field(min_length=1, max_length=1000)]


_FIGURES = TypeAdapter(Figures)


def to_json(figures: Figures) -> str:
    """Return figures as the text of a file."""
    return _FIGURES.dump_json(figures).decode()


def read_figures(path: Path) -> Figures:
    """Read a file that `bench --json` wrote.

    Raises:
        UnreadableError: It is none; the message says what is wrong with it first, in one line.
    """
    try:
        return _FIGURES.validate_json(read_untrusted(path, JSON_MAX_BYTES))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        what = f"{where}: {first['msg']}" if where else first["msg"]
        raise UnreadableError(
            path, f"it is not what `stadimeter bench --json` of this version writes: {what}"
        ) from error


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

    Both versions of Linux' control groups are looked at (Linux documentation, "CFS bandwidth control" and ``cpu.max``).
    """
    try:
        lines = Path("/proc/self/cgroup").read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    limits = [limit for line in lines for limit in _limits_of(cgroups, *line.split(":", 2)[1:])]
    return min(limits, default=None)


def _limits_of(cgroups: Path, controllers: str, group: str) -> list[float]:
    """Return the limits of one group and of those it is in."""
    if controllers and "cpu" not in controllers.split(","):
        return []
    inner = cgroups / controllers / group.lstrip("/")
    folders = [inner, *inner.parents][: len(inner.parts) - len(cgroups.parts) + 1]
    read = (_limit_in(folder) for folder in folders)
    return [limit for limit in read if limit is not None]


def _limit_in(folder: Path) -> float | None:
    names = ("cpu.max",) if (folder / "cpu.max").exists() else ("cpu.cfs_quota_us", "cpu.cfs_period_us")
    try:
        quota, period = " ".join((folder / name).read_text(encoding="ascii") for name in names).split()
        limit = int(quota) / int(period)
    except (OSError, ValueError):  # no such file in this group, or "max"
        return None
    return limit if limit > 0 else None


def _board() -> str:
    computer = Computer()
    named = re.search(r"^model name\s*:\s*(.+)$", computer.text("/proc/cpuinfo"), re.MULTILINE)
    return computer.model or (named[1].strip() if named else platform.machine())
