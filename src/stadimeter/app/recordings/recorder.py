"""Records a run beside the loop: what takes time is done in a thread, and what fails there ends no run."""

from __future__ import annotations

import queue
import threading
import time
from dataclasses import dataclass

from stadimeter.app.cycle_record import CycleRecord
from stadimeter.app.recordings.recorded_configuration import RecordedConfiguration
from stadimeter.app.recordings.recording import RecordingWriter
from stadimeter.core.frame import Frame
from stadimeter.errors import StadimeterError

WAITING_MAX = 4096
"""So many cycles may wait for the disk: two minutes at 30 a second. A memory card that pauses needs a few seconds."""

IMAGES_WAITING_MAX = 8
"""While more cycles than this wait, pictures are left out: they take the time and the memory."""

END_WAIT_S = 30.0
"""How long `Recorder.close` waits for what is not written yet."""


@dataclass(frozen=True, slots=True)
class _Reload:
    now_s: float
    configuration: RecordedConfiguration | str


_Item = tuple[CycleRecord, Frame | None] | _Reload


class Recorder:
    """Takes the cycles of a run, as a listener of the loop, and has them written by a thread.

    On a live camera the loop never waits: if the disk does not keep up, pictures are left out first, and in the end the
    recording stops. On a recording or a simulation the loop waits, so that every cycle and every picture is recorded.

    Args:
        writer: Writes them.
        is_live: Whether the camera is live.

    Attributes:
        failure: Why the recording ended before the run; empty while it goes on.
        images_left_out: How many pictures were left out, since the disk did not keep up.
    """

    def __init__(self, writer: RecordingWriter, *, is_live: bool) -> None:
        self.failure = ""
        self.images_left_out = 0
        self._writer = writer
        self._is_live = is_live
        self._waiting: queue.Queue[_Item | None] = queue.Queue(WAITING_MAX if is_live else IMAGES_WAITING_MAX)
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def __call__(self, record: CycleRecord, frame: Frame | None) -> None:
        """Take one cycle.

        Args:
            record: The cycle.
            frame: The frame that was new in it.
        """
        if self.failure:
            return
        if self._is_live and frame is not None and self._waiting.qsize() > IMAGES_WAITING_MAX:
            self.images_left_out += 1
            frame = None
        self._put((record, frame))

    def resumed(self, text: str) -> None:
        """Take in what the run takes over from an earlier one. Only before the first cycle.

        Args:
            text: What it takes over.
        """
        self._writer.resumed(text)

    def reloaded(self, now_s: float, configuration: RecordedConfiguration | str) -> None:
        """Take that another configuration was taken over, before the first cycle that it decides.

        Args:
            now_s: When, on the run's monotonic clock.
            configuration: The configuration, or its text.
        """
        if not self.failure:
            self._put(_Reload(now_s, configuration))

    def _put(self, item: _Item) -> None:
        if not self._is_live:
            self._waiting.put(item)
            return
        try:
            self._waiting.put_nowait(item)
        except queue.Full:
            self.failure = f"the disk does not keep up: {WAITING_MAX} cycles wait for it; the recording ends here"

    def trouble(self) -> str:
        """Return in words what is wrong with the recording; empty if nothing is."""
        if self.failure:
            return f"recording: {self.failure}"
        if self.images_left_out:
            return f"recording: {self.images_left_out} pictures are left out, since the disk does not keep up"
        return ""

    def close(self, wait_s: float = END_WAIT_S) -> None:
        """Write what waits, and finish the file. May be called any number of times.

        Args:
            wait_s: How long to wait for that.
        """
        if not self._thread.is_alive():
            return
        until_s = time.monotonic() + wait_s
        try:
            self._waiting.put(None, timeout=wait_s)
        except queue.Full:
            self.failure = self.failure or "the disk does not answer; the end of the recording is missing"
            return
        self._thread.join(max(0.0, until_s - time.monotonic()))
        if self._thread.is_alive():
            self.failure = self.failure or "the disk does not answer; the end of the recording is missing"

    def _run(self) -> None:
        try:
            while (item := self._waiting.get()) is not None:
                if not self.failure:
                    self._write(item)
            self._writer.close()
        except Exception as error:  # noqa: BLE001 - whatever it is, the run goes on without the recording
            self.failure = str(error) if isinstance(error, StadimeterError) else f"{type(error).__name__}: {error}"
            self._writer.abandon()
            self._discard()

    def _write(self, item: _Item) -> None:
        if isinstance(item, _Reload):
            self._writer.reloaded(item.now_s, item.configuration)
        else:
            self._writer.write(*item)

    def _discard(self) -> None:
        """Let go of what waits until the end, so that nobody waits for room."""
        while self._waiting.get() is not None:
            pass
