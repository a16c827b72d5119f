"""Opens journals and recordings of runs; the content tells which of the two a file is."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from stadimeter.app.recordings.cycle_json import RecordedCycle
from stadimeter.app.recordings.journal import JournalHeader, read_journal, readable
from stadimeter.app.recordings.record_file import MAGIC


class AnyRecording(Protocol):
    """A journal, or a recording with pictures."""

    @property
    def path(self) -> Path:
        """The file."""
        ...

    @property
    def header(self) -> JournalHeader:
        """What it says about its run."""
        ...

    def cycles(self) -> Iterator[RecordedCycle]:
        """Yield every cycle, in order, not read yet; raises JournalError where the file is damaged."""
        ...

    def is_cut_off(self) -> bool:
        """Return whether the end is missing."""
        ...


def read_recording(path: Path) -> AnyRecording:
    """Open a journal or a recording, of which only the beginning is read.

    Raises:
        JournalError: It cannot be read, is neither, or is of a later format.
        DriverUnavailableError: It is an MCAP file, and the library ``mcap`` is not installed.
    """
    with readable(path) as file:
        head = file.read(len(MAGIC))
    if head != MAGIC:
        return read_journal(path)
    from stadimeter.workbench.replay.recording_reader import read_mcap  # noqa: PLC0415 - it needs OpenCV and an extra

    return read_mcap(path)
