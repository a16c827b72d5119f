"""Recordings of a run while it goes on: one that is begun and ended on request, and the last hour.

A recording goes to a folder of its own, which cannot fill the disk: it is refused while the folder or the disk is full,
and ends by itself before that. Whatever takes time is done in threads, so that the loop is never held up. The
recording holds the state of the run at its beginning, from which it replays to the same decisions.

People who ask why an alarm sounded have seldom begun a recording before it: the last hour is kept without pictures, in
recordings one after another, of which old ones go.
"""

from __future__ import annotations

import math
import shutil
import threading
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import Struct

from stadimeter.app.control.messages import RecordArgs, Reply
from stadimeter.app.control.socket_server import Answer
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.places import state_directory
from stadimeter.app.recordings.journal import ENDING, RecordedConfiguration, delete_old
from stadimeter.config.loader import is_demonstration
from stadimeter.core.decide import State
from stadimeter.core.frame import Frame
from stadimeter.errors import JournalError, StadimeterError

if TYPE_CHECKING:
    from stadimeter.app.bootstrap import Parts
    from stadimeter.app.ending import Deadline
    from stadimeter.app.recordings.recorder import Recorder
    from stadimeter.app.recordings.recording import RecordingWriter


FOLDER = "recordings"
CLIPS = "clips"

# How often a recording looks whether it has reached a bound, and how full the disk is.
LOOK_EVERY_S = 1.0


class Bounds(Struct, frozen=True, kw_only=True):
    """Limits of the room that recordings may take.

    Attributes:
        folder_bytes: No recording begins while those in the folder are larger together.
        file_bytes: A recording ends at this size.
        seconds: A recording ends after this long.
        free_bytes: A recording ends when the disk has less room; none begins with less than twice that.
        keep_s: What ended longer ago is deleted when a recording begins, and the oldest while the folder is full; None
            to delete nothing.
    """

    folder_bytes: int = 4_000_000_000
    file_bytes: int = 1_000_000_000
    seconds: float = 3600.0
    free_bytes: int = 250_000_000
    keep_s: float | None = None


def recordings_folder(configuration: Path) -> Path:
    """Return where the recordings of a run go: to the folder of the service's state, or beside its configuration."""
    of_service = state_directory()
    if of_service is not None:
        return of_service / FOLDER
    beside = configuration.resolve().parent
    return (Path.cwd() if is_demonstration(configuration) else beside) / FOLDER


class _Begun(Struct, kw_only=True):
    """A recording, from when its file is open. It begins with the first cycle after that."""

    path: Path
    writer: RecordingWriter
    recorder: Recorder
    answer: Answer
    began_unix_s: float = 0.0
    began_s: float = 0.0
    newest_s: float = 0.0
    looked_s: float = 0.0
    reason: str = ""

    def about(self) -> dict[str, object]:
        return {
            "file": self.path.name,
            "started_unix_s": round(self.began_unix_s, 3),
            "seconds": round(self.newest_s - self.began_s, 1),
            "bytes": self.writer.size_bytes,
        }


class RecordingOnRequest:
    """Records a run between a request to start and one to stop. A listener of the loop.

    Args:
        state: Returns what the run remembers of its newest cycle.
        tell: Takes what a person should read.
        folder: Where recordings go; None for the usual place.
    """

    def __init__(
        self,
        parts: Parts,
        state: Callable[[], State | None],
        tell: Callable[[str], None],
        deadline: Deadline,
        bounds: Bounds | None = None,
        folder: Path | None = None,
    ) -> None:
        self._parts = parts
        self._state = state
        self._folder = folder or recordings_folder(parts.configuration.path)
        self._tell = tell
        self._deadline = deadline
        self._bounds = bounds or Bounds()
        self._is_beginning = False
        self._ready: _Begun | None = None
        self._reloaded: RecordedConfiguration | None = None
        self._begun: _Begun | None = None
        self._ending: _Begun | None = None
        self._trouble = ""

    def act(self, args: RecordArgs, answer: Answer) -> None:
        """Begin or end a recording. Answers when that is done; never waits."""
        if args.do == "stop":
            self._stop(answer)
        elif self._is_beginning or self._ready or self._begun:
            answer(Reply(error="a recording is under way already; end it first"))
        else:
            self._is_beginning, self._reloaded, self._trouble = True, None, ""
            threading.Thread(target=self._begin, args=(answer,), name="begin recording", daemon=True).start()

    def now(self) -> Mapping[str, object] | None:
        """Return the known facts of the recording under way; None if there is none. From any thread."""
        begun = self._begun
        return begun.about() if begun is not None else None

    def __call__(self, record: CycleRecord, frame: Frame | None) -> None:
        """Take in a cycle; begin with the next one, if the file is open."""
        if self._begun is not None:
            self._begun.newest_s = record.observation.now_s
            self._begun.recorder(record, frame)
            self._look(self._begun, record.observation.now_s)
        elif self._ready is not None:
            self._join(self._ready, record.observation.now_s)

    def note_state(self, state: State) -> None:
        """Take in what the run restores from an earlier one: nothing records as early as that."""

    def note_reload(self, now_s: float, configuration: RecordedConfiguration) -> None:
        """Take in that another configuration was loaded."""
        self._reloaded = configuration
        if self._begun is not None:
            self._begun.recorder.note_reload(now_s, configuration)

    def trouble(self) -> str:
        """Return why the last recording ended too early, or what is wrong with this one; empty if nothing is."""
        begun = self._begun
        return begun.recorder.trouble() if begun is not None else self._trouble

    def close(self) -> None:
        """End the recording under way with the run, and wait for the disk as long as there is time."""
        for begun in (self._begun, self._ready, self._ending):
            if begun is not None:
                begun.recorder.close()
        self._begun = self._ready = None

    def _begin(self, answer: Answer) -> None:
        """Open the file, in a thread."""
        try:
            self._ready = self._opened(answer)
        except (StadimeterError, OSError) as error:
            answer(Reply(error=f"nothing is recorded: {error}"))
        except BaseException as error:  # noqa: BLE001 - a defect must not leave the one who asks waiting
            answer(Reply(error=f"nothing is recorded: {type(error).__name__}: {error}"))
        finally:
            self._is_beginning = False

    def _opened(self, answer: Answer) -> _Begun:
        from stadimeter.app.recordings.recorder import Recorder  # noqa: PLC0415 - it takes long, and few runs record
        from stadimeter.app.recordings.recording import RecordingWriter, require_mcap, what_is_recorded  # noqa: PLC0415

        require_mcap("recording to an MCAP file")
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if self._bounds.keep_s is not None:
            delete_old(self._folder, self._bounds.keep_s, self._bounds.folder_bytes)
        self._check_room()
        parts, path = self._parts, self._new_path()
        writer = RecordingWriter(path, what_is_recorded(parts.configuration, parts.cycle.detectors))
        recorder = Recorder(writer, is_live=True, deadline=self._deadline)
        return _Begun(path=path, writer=writer, recorder=recorder, answer=answer)

    def _new_path(self) -> Path:
        """Return a name that no recording has: of two in one second, the second would take that of the first."""
        name = f"{self._parts.configuration.path.stem}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
        names = (name, *(f"{name}-{number}" for number in range(2, 100)))
        return next(path for each in names if not (path := self._folder / f"{each}{ENDING}").exists())

    def _check_room(self) -> None:
        """Raise `JournalError` if there is no room for a recording."""
        used = sum(map(_size_bytes, self._folder.glob(f"*{ENDING}")))
        if used > self._bounds.folder_bytes:
            raise JournalError(f"{self._folder} holds {used / 1e9:.1f} GB; delete recordings first")
        free = shutil.disk_usage(self._folder).free
        if free < 2 * self._bounds.free_bytes:
            raise JournalError(f"{self._folder}: the disk has only {free / 1e6:.0f} MB left; make room first")

    def _join(self, ready: _Begun, now_s: float) -> None:
        """Record from the next cycle on."""
        state = self._state()
        if state is None:
            return
        ready.recorder.note_state(state)
        if self._reloaded is not None:
            ready.writer.begin_with(self._reloaded)
        ready.began_unix_s = time.time()
        ready.began_s = ready.newest_s = ready.looked_s = now_s
        self._ready, self._begun = None, ready
        ready.answer(Reply({**ready.about(), "path": str(ready.path)}))

    def _look(self, begun: _Begun, now_s: float) -> None:
        """End a recording that has failed or reached a bound; look now and then."""
        if now_s - begun.looked_s < LOOK_EVERY_S:
            return
        begun.looked_s = now_s
        begun.recorder.put(partial(self._look_at_disk, begun))
        reason = begun.recorder.failure or self._reason_to_end(begun, now_s)
        if reason:
            self._trouble = f"recording {begun.path.name} has ended: {reason}"
            self._tell(f"warning: {self._trouble}")
            self._end(begun, lambda _reply: None)

    def _reason_to_end(self, begun: _Begun, now_s: float) -> str:
        if begun.writer.size_bytes > self._bounds.file_bytes:
            return f"it has {self._bounds.file_bytes / 1e6:.0f} MB"
        if now_s - begun.began_s > self._bounds.seconds:
            return f"it is {self._bounds.seconds / 60:.0f} min long"
        return begun.reason

    def _look_at_disk(self, begun: _Begun) -> None:
        """Note that the disk becomes full. In the thread of the recorder: a disk that hangs does not even tell that."""
        free = shutil.disk_usage(self._folder).free
        if free < self._bounds.free_bytes:
            begun.reason = f"the disk has only {free / 1e6:.0f} MB left"

    def _stop(self, answer: Answer) -> None:
        if self._begun is not None:
            self._end(self._begun, answer)
        elif self._is_beginning or self._ready:
            answer(Reply(error="the recording is only just beginning; end it when it has begun"))
        else:
            answer(Reply(error=self._trouble or "nothing is recorded"))

    def _end(self, begun: _Begun, answer: Answer) -> None:
        self._begun, self._ending = None, begun
        begun.recorder.end()
        threading.Thread(target=_finish, args=(begun, answer), name="end recording", daemon=True).start()


def _size_bytes(path: Path) -> int:
    """Return the size of a file; 0 if it was deleted since it was listed."""
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


def _finish(begun: _Begun, answer: Answer) -> None:
    """Wait for the disk, in a thread, and answer."""
    begun.recorder.close()
    failure = begun.recorder.failure
    answer(Reply(error=f"{begun.path.name} is not whole: {failure}") if failure else Reply(begun.about()))


LAST = "last"

# How often it looks whether a recording is full, or has ended and may be begun again.
LAST_LOOK_EVERY_S = 10.0

# An hour at 30 Hz takes 0.04 GB. This bound is for a clock that was set wrong, by which nothing is ever old.
LAST_BYTES = 1_000_000_000


def last_folder(configuration: Path) -> Path:
    """Return where the last hour of the runs of a configuration is."""
    return recordings_folder(configuration) / LAST / configuration.stem


class LastRecording(RecordingOnRequest):
    """Keeps what a run saw and did of late, if its configuration says so. A listener of the loop.

    Each recording holds `last_s`, so with the one before, between once and twice that is kept.
    """

    def __init__(
        self,
        parts: Parts,
        state: Callable[[], State | None],
        tell: Callable[[str], None],
        deadline: Deadline,
        last_s: float,
    ) -> None:
        bounds = Bounds(seconds=math.inf, folder_bytes=LAST_BYTES, keep_s=last_s)
        super().__init__(parts, state, tell, deadline, bounds, last_folder(parts.configuration.path))
        self._last_s = last_s
        self._look_s = -math.inf
        self._full_s = math.inf
        self._not_begun = ""

    def __call__(self, record: CycleRecord, _frame: Frame | None) -> None:
        """Take in a cycle, and begin another recording where it is time to."""
        super().__call__(record, None)
        now_s = record.observation.now_s
        if now_s < self._look_s:
            return
        self._look_s = now_s + LAST_LOOK_EVERY_S
        if now_s >= self._full_s:
            self.act(RecordArgs(do="stop"), lambda _reply: None)
        if self.now() is None:
            self._full_s = now_s + self._last_s
            self.act(RecordArgs(do="start"), self._note)

    def trouble(self) -> str:
        """Return why nothing is kept now; empty if nothing is wrong."""
        return self._not_begun or super().trouble()

    def _note(self, reply: Reply | Callable[[], Reply]) -> None:
        """Take in, from a thread, whether a recording has begun; say once why not."""
        reply = reply if isinstance(reply, Reply) else reply()
        trouble = f"the last {self._last_s / 60:g} min: {reply.error}" if reply.error else ""
        if trouble and trouble != self._not_begun:
            self._tell(f"warning: {trouble}")
        self._not_begun = trouble
