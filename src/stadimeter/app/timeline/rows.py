"""The format of a timeline: rows of fixed length in files that only grow.

A segment is what one run wrote of the same targets and rules, for a day at most: ``NAME.1`` with a row for each second,
and ``NAME.10``, ``NAME.60`` and ``NAME.600`` with one for as many seconds, from which a long time is read quickly. Each
row has the time by the computer's clock and by that of the run: recordings go by that, and either may lag or be set.
Each file begins with a line of JSON that names targets and rules. The coarser files are written every ten minutes; what
they lack after a power cut is made of the seconds, and half a row at the end is not read.
"""

from __future__ import annotations

import os
from bisect import bisect_left
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.app.event_log import ENDING
from stadimeter.config.untrusted_file import JSON_MAX_BYTES, open_untrusted
from stadimeter.core.decision import RuleStatus
from stadimeter.errors import JournalError, StadimeterError

FOLDER = "timeline"
LEVELS_S = (1, 10, 60, 600)

# What rows consist of; files of another format are passed over.
FORMAT = 2

# What is known of a target in a row: means, the extremes of the distance, and how much of the time it was seen.
FIGURES = ("mean_m", "sigma_m", "low_m", "high_m", "seen")
MEAN, SIGMA, LOW, HIGH, SEEN = range(5)

# What a rule did in a row: of several states the one that stands last here, so that a short alarm is seen from afar.
# The first is for no state at all.
STATES = (
    "",
    RuleStatus.IDLE,
    RuleStatus.UNKNOWN,
    RuleStatus.PENDING,
    RuleStatus.RETURNED,
    RuleStatus.CLEARING,
    RuleStatus.LATCHED,
    RuleStatus.ACTIVE,
)

Rows = NDArray[Any]


class Names(Struct, frozen=True):
    """The targets and the rules of a segment, in the order of its rows."""

    targets: tuple[str, ...]
    rules: tuple[str, ...]
    format: int = FORMAT

    @property
    def row(self) -> np.dtype[Any]:
        """The parts of a row."""
        figures = ("figures", "<f4", (len(self.targets), len(FIGURES)))
        return np.dtype([("unix_s", "<u4"), ("run_s", "<f8"), figures, ("states", "u1", (len(self.rules),))])

    @property
    def head(self) -> bytes:
        """The line with which a file begins."""
        return msgspec.json.encode(self) + b"\n"


def timeline_folder(recordings: Path, configuration: Path) -> Path:
    """Return where the timeline of a configuration is: beside the folder of its recordings."""
    return recordings.parent / FOLDER / configuration.stem


def event_log_beside(folder: Path) -> Path:
    """Return the event log of a run that is no service, which is kept with its timeline."""
    return folder / f"events{ENDING}"


def merge_rows(rows: Rows, step_s: int) -> Rows:
    """Return one row for each step of time that has any; extremes and short states stay."""
    if not len(rows):
        return rows
    steps = rows["unix_s"] // step_s
    begins = np.flatnonzero(np.concatenate([[True], steps[1:] != steps[:-1]]))
    merged = np.zeros(len(begins), rows.dtype)
    merged["unix_s"] = steps[begins] * step_s
    merged["run_s"] = rows["run_s"][begins]
    merged["states"] = np.maximum.reduceat(rows["states"], begins)
    found, figures = rows["figures"], merged["figures"]
    seen = np.add.reduceat(found[..., SEEN], begins)
    with np.errstate(invalid="ignore"):  # 0 / 0: never seen, so there is no mean
        for mean in (MEAN, SIGMA):
            figures[..., mean] = np.add.reduceat(np.nan_to_num(found[..., mean]) * found[..., SEEN], begins) / seen
    figures[..., LOW] = np.fmin.reduceat(found[..., LOW], begins)
    figures[..., HIGH] = np.fmax.reduceat(found[..., HIGH], begins)
    figures[..., SEEN] = seen / np.diff(begins, append=len(rows))[:, None]
    return merged


def read_rows(folder: Path, from_s: float, to_s: float, step_s: int) -> Iterator[tuple[Names, Rows]]:
    """Yield the rows of each segment between two times, oldest first, merged to steps of at least a second.

    A file that is no timeline, or gone by now, is passed over.
    """
    level_s = max(each for each in LEVELS_S if step_s % each == 0)
    for path in sorted(folder.glob("*.1")):
        try:
            names, rows = _read_segment(path, from_s, to_s, level_s)
        except (StadimeterError, OSError, ValueError):
            continue
        if len(rows):
            yield names, merge_rows(rows, step_s)


def _read_segment(path: Path, from_s: float, to_s: float, level_s: int) -> tuple[Names, Rows]:
    """Return the rows of a level, and of the seconds that it lacks yet."""
    with open_untrusted(path) as file:
        names = msgspec.json.decode(file.readline(JSON_MAX_BYTES), type=Names)
    coarse = np.zeros(0, names.row)
    if level_s > 1:
        try:
            coarse = _read_file(path.with_suffix(f".{level_s}"), names, from_s - level_s, to_s)
        except (StadimeterError, OSError):
            pass
        else:
            coarse = coarse[coarse["unix_s"] + level_s > from_s]
    since_s = float(coarse["unix_s"][-1]) + level_s if len(coarse) else from_s
    fine = _read_file(path, names, since_s, to_s) if since_s < to_s else np.zeros(0, names.row)
    return names, np.concatenate([coarse, fine])


def _read_file(path: Path, names: Names, from_s: float, to_s: float) -> Rows:
    """Return the rows of a file from one time up to another, which is found by halving."""
    with open_untrusted(path) as file:
        if file.readline(JSON_MAX_BYTES) != names.head:
            raise JournalError(f"{path} is no timeline, or of other targets and rules")
        row, begin = names.row, file.tell()
        count = (os.fstat(file.fileno()).st_size - begin) // row.itemsize

        def time_of(number: int) -> int:
            return _time_at(file, begin + number * row.itemsize)

        while count and not time_of(count - 1):  # a power cut may leave zeros at the end
            count -= 1
        first, end = (bisect_left(range(count), at_s, key=time_of) for at_s in (from_s, to_s))
        file.seek(begin + first * row.itemsize)
        return np.frombuffer(file.read((end - first) * row.itemsize), row)


def _time_at(file: BinaryIO, byte: int) -> int:
    return int.from_bytes(os.pread(file.fileno(), 4, byte), "little")
