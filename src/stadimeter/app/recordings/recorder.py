"""Records a run beside the loop: the disk's work is done in a thread, and no failure of the disk ends a run.

A full disk, one that fails and one that hangs are the same to the loop: it hands a cycle over and goes on.
"""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Protocol

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.ending import Deadline
from stadimeter.app.persistence.resumption import state_text
from stadimeter.app.recordings.journal import RecordedConfiguration
from stadimeter.core.decide import State
from stadimeter.core.frame import Frame
from stadimeter.errors import StadimeterError

# The most cycles that wait for the disk: two minutes at 30 a second. A memory card that pauses needs a few seconds.
WAITING_MAX = 4096

# While more cycles than this wait, pictures are left out: they take the time and the memory.
IMAGES_WAITING_MAX = 8

# How long the end of a run waits for the disk.
END_WAIT_S = 30.0

# How long it waits if the run was asked to end, by SIGTERM for example.
GOODBYE_S = 0.7

_STEP_S = 0.1


class Writer(Protocol):
    """Writes a journal or a recording, in the thread of the caller."""

    kind: str
    takes_pictures: bool

    def write(self, record: CycleRecord, frame: Frame | None = None, /) -> None:
        """Add one cycle."""
        ...

    def note_resumption(self, text: str) -> None:
        """Take in what the run restores from an earlier one, before the first cycle."""
        ...

    def note_reload(self, now_s: float, configuration: RecordedConfiguration) -> None:
        """Add that another configuration was loaded."""
        ...

    def older_file(self) -> str:
        """Return in words where an older file of that name is now; empty if there was none."""
        ...

    def close(self) -> None:
        """Finish the file."""
        ...

    def abandon(self) -> None:
        """Close the file as it is, after a failure."""
        ...


class Recorder:
    """Takes the cycles of a run, as a listener of the loop, and has them written by a thread.

    On a live camera the loop never waits: if the disk does not keep up, pictures are left out first, and in the end the
    recording stops. On a recording or a simulation the loop waits, so that every cycle and every picture is recorded.

    Attributes:
        kind: ``journal`` or ``recording``.
        failure: Why the recording ended before the run; empty while it goes on.
        images_left_out: How many pictures were left out, since the disk did not keep up.
    """

    def __init__(self, writer: Writer, *, is_live: bool, deadline: Deadline | None = None) -> None:
        self.kind = writer.kind
        self.failure = ""
        self.images_left_out = 0
        self._writer = writer
        self._is_live = is_live
        self._deadline = deadline or Deadline()
        room_for = WAITING_MAX if is_live else IMAGES_WAITING_MAX
        self._waiting: queue.Queue[Callable[[], None] | None] = queue.Queue(room_for)
        self._ended_s: float | None = None
        self._thread = threading.Thread(target=self._run, name=writer.kind, daemon=True)
        self._thread.start()

    def __call__(self, record: CycleRecord, frame: Frame | None) -> None:
        """Take one cycle, and the frame that was new in it."""
        self.put(partial(self._writer.write, record, self.admit(frame) if self._writer.takes_pictures else None))

    def admit(self, frame: Frame | None) -> Frame | None:
        """Return a frame if it can be recorded; None, and count it, if too much waits."""
        if not self._is_live or frame is None or self._waiting.qsize() <= IMAGES_WAITING_MAX:
            return frame
        self.images_left_out += 1
        return None

    def note_state(self, state: State) -> None:
        """Take in the state with which the recording begins, before its first cycle. The disk's thread writes it."""
        self.put(lambda: self._writer.note_resumption(state_text(state)))

    def note_reload(self, now_s: float, configuration: RecordedConfiguration) -> None:
        """Take in that another configuration was loaded, before the first cycle that it decides."""
        self.put(partial(self._writer.note_reload, now_s, configuration))

    def older_file(self) -> str:
        """Return in words where an older file of that name is now; empty if there was none."""
        return self._writer.older_file()

    def trouble(self) -> str:
        """Return in words what is wrong; empty if nothing is. The words stay the same while that lasts."""
        if self.failure:
            return f"{self.kind}: {self.failure}"
        return "recording: pictures are left out, since the disk does not keep up" if self.images_left_out else ""

    def end(self) -> None:
        """Have what waits written and the file finished. Returns at once; `close` waits for it."""
        if self._ended_s is None:
            self._ended_s = time.monotonic()
            with suppress(queue.Full):  # then the thread does not wait for anything
                self._waiting.put_nowait(None)

    def close(self) -> None:
        """Wait until what waits is written and the file is finished. May be called any number of times."""
        self.end()
        while self._thread.is_alive() and not self._is_too_late(self._ended_s or 0.0):
            self._thread.join(_STEP_S)
        if self._thread.is_alive():
            self._give_up()

    @property
    def waiting(self) -> int:
        """Number of cycles that wait for the thread."""
        return self._waiting.qsize()

    def put(self, step: Callable[[], None]) -> None:
        """Have the thread do a step."""
        began_s = time.monotonic()
        while not self.failure:
            try:
                self._waiting.put(step, block=not self._is_live, timeout=_STEP_S)
            except queue.Full:
                if self._is_live:
                    words = f"the disk does not keep up: {WAITING_MAX} cycles wait for it; the {self.kind} ends here"
                    self.failure = words
                elif self._is_too_late(began_s):
                    self._give_up()
            else:
                return

    def _give_up(self) -> None:
        """Wait for the disk no longer, at the end neither. The thread stays behind; it ends if the disk comes back."""
        self.failure = self.failure or f"the disk does not answer; the end of the {self.kind} is missing"
        self.end()
        self._ended_s = -math.inf

    def _is_too_late(self, began_s: float) -> bool:
        """Check whether a wait for the disk has been long enough; a program has no more than two seconds to end."""
        longest_s = GOODBYE_S if self._deadline.is_set else END_WAIT_S
        return time.monotonic() - began_s >= longest_s or self._deadline.left_s(longest_s) <= 0

    def _run(self) -> None:
        try:
            while not (self._ended_s is not None and self._waiting.empty()) and (step := self._waiting.get()):
                if not self.failure:
                    step()
            self._writer.close()
        except BaseException as error:  # noqa: BLE001 - whatever it is, the run goes on without the recording
            self.failure = str(error) if isinstance(error, StadimeterError) else f"{type(error).__name__}: {error}"
            self._writer.abandon()
