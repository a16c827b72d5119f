"""The last hour of a run, kept on disk: recordings without pictures, one after another, of which old ones go.

People who ask why an alarm sounded have seldom begun a recording before it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from stadimeter.app.control.messages import RecordArgs, Reply
from stadimeter.app.control.recording import Bounds, RecordingOnRequest, recordings_folder
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.recordings.recorded_configuration import RecordedConfiguration
from stadimeter.core.decide import State
from stadimeter.core.frame import Frame

if TYPE_CHECKING:
    from stadimeter.app.bootstrap import Parts
    from stadimeter.app.ending import Deadline

FOLDER = "last"

# How often it looks whether a recording is full, or has ended and may be begun again.
LOOK_EVERY_S = 10.0

# An hour at 30 Hz takes 0.04 GB. This bound is for a clock that was set wrong, by which nothing is ever old.
FOLDER_BYTES = 1_000_000_000


def last_folder(configuration: Path) -> Path:
    """Return where the last hour of the runs of a configuration is."""
    return recordings_folder(configuration) / FOLDER / configuration.stem


@contextmanager
def keep_last(
    listeners: list[Callable[[CycleRecord, Frame | None], None]],
    parts: Parts,
    state: Callable[[], State | None],
    tell: Callable[[str], None],
    deadline: Deadline,
) -> Iterator[None]:
    """Keep the last hour of a run while in the context, if its configuration says so."""
    with ExitStack() as closing:
        if parts.configuration.recording is not None:
            last = LastRecording(parts, state, tell, deadline)
            closing.callback(last.close)
            listeners.append(last)
        yield


class LastRecording:
    """Keeps what a run saw and did of late. A listener of the loop.

    Each recording holds `last_s`, so with the one before, between once and twice that is kept.
    """

    def __init__(
        self, parts: Parts, state: Callable[[], State | None], tell: Callable[[str], None], deadline: Deadline
    ) -> None:
        table = parts.configuration.recording
        self._last_s = table.last if table is not None else math.inf
        folder = last_folder(parts.configuration.path)
        bounds = Bounds(seconds=math.inf, folder_bytes=FOLDER_BYTES, keep_s=self._last_s)
        self._recording = RecordingOnRequest(parts, state, tell, deadline, bounds, folder)
        self._tell = tell
        self._look_s = -math.inf
        self._full_s = math.inf
        self._trouble = ""

    def __call__(self, record: CycleRecord, _frame: Frame | None) -> None:
        """Take in a cycle, and begin another recording where it is time to."""
        self._recording(record, None)
        now_s = record.observation.now_s
        if now_s < self._look_s:
            return
        self._look_s = now_s + LOOK_EVERY_S
        if now_s >= self._full_s:
            self._recording.act(RecordArgs(do="stop"), lambda _reply: None)
        if self._recording.now() is None:
            self._full_s = now_s + self._last_s
            self._recording.act(RecordArgs(do="start"), self._note)

    def note_state(self, state: State) -> None:
        """Take in what the run restores from an earlier one: nothing records as early as that."""

    def note_reload(self, now_s: float, configuration: RecordedConfiguration) -> None:
        """Take in that another configuration was loaded."""
        self._recording.note_reload(now_s, configuration)

    def trouble(self) -> str:
        """Return why nothing is kept now; empty if nothing is wrong."""
        return self._trouble or self._recording.trouble()

    def close(self) -> None:
        """End the recording under way with the run."""
        self._recording.close()

    def _note(self, reply: Reply | Callable[[], Reply]) -> None:
        """Take in, from a thread, whether a recording has begun; say once why not."""
        reply = reply if isinstance(reply, Reply) else reply()
        trouble = f"the last {self._last_s / 60:g} min: {reply.error}" if reply.error else ""
        if trouble and trouble != self._trouble:
            self._tell(f"warning: {trouble}")
        self._trouble = trouble
