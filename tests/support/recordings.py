"""Journals and recordings, read whole."""

from __future__ import annotations

from collections.abc import Iterator

from stadimeter.app.cycle import CycleRecord
from stadimeter.workbench.replay import AnyRecording


def records_of(recording: AnyRecording) -> Iterator[CycleRecord]:
    """Yield every cycle of a journal or a recording, in order; raises JournalError where it is damaged."""
    return (cycle.record() for cycle in recording.cycles())
