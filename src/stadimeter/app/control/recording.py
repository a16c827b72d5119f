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
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.app.control.messages import OutputsArgs, RecordArgs, Reply
from stadimeter.app.control.socket_server import Answer
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.persistence.resumption import state_text
from stadimeter.app.places import state_directory
from stadimeter.app.recordings.journal import ENDING, RecordedConfiguration, delete_old
from stadimeter.app.recordings.recorder import Recorder
from stadimeter.app.recordings.recording import (
    Entry,
    EntryEncoder,
    ImageChooser,
    ImageOptions,
    Recorded,
    RecordingWriter,
    what_is_recorded,
)
from stadimeter.config.loader import is_demonstration
from stadimeter.config.optional_tables import BlackBoxTable
from stadimeter.core.decide import State
from stadimeter.core.decision import EventKind
from stadimeter.core.frame import Frame
from stadimeter.errors import JournalError, StadimeterError
from stadimeter.operator_actions import OperatorCommand

if TYPE_CHECKING:
    from stadimeter.app.bootstrap import Parts
    from stadimeter.app.ending import Deadline
    from stadimeter.app.recordings.recorder import Recorder
    from stadimeter.app.recordings.recording import RecordingWriter

FOLDER = "recordings"
CLIPS = "clips"

# How often a recording looks how full the disk is.
LOOK_EVERY_S = 2.0


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
    is_ended: threading.Event = field(default_factory=threading.Event)
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
                begun.is_ended.set()
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
        from stadimeter.app.recordings.recording import (  # noqa: PLC0415
            RecordingWriter,
            require_mcap,
            what_is_recorded,
        )

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
        threading.Thread(target=self._watch_room, args=(ready,), name="disk of recording", daemon=True).start()
        ready.answer(Reply({**ready.about(), "path": str(ready.path)}))

    def _look(self, begun: _Begun, now_s: float) -> None:
        """End a recording that has failed or reached a bound; look once a second."""
        if now_s - begun.looked_s < 1.0:
            return
        begun.looked_s = now_s
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

    def _watch_room(self, begun: _Begun) -> None:
        """Note that the disk becomes full. In a thread: a disk that hangs does not even tell how full it is."""
        while not begun.is_ended.wait(LOOK_EVERY_S):
            try:
                free = shutil.disk_usage(self._folder).free
            except OSError as error:
                begun.reason = f"{self._folder} cannot be looked at any more: {error.strerror or error}"
                return
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
        begun.is_ended.set()
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


# The black box of a run: writes the seconds around an alarm, a fault or the press of a button as a clip.
#
# The loop says what is worth a clip, and gives it a name before the messages of that cycle are sent. All else is done
# by the thread of a recorder, so the loop never waits.
#
# The last seconds are in memory, as a row of segments of about a second, each with the state of the run with which it
# begins: a recording can begin at any of them and replays to the same decisions. Entries are encoded as they will be
# written. A clip is written segment by segment, while the next ones are taken in: a slow disk delays it, and costs no
# pictures.
#
# What happens while a clip is under way makes it longer, by the whole of ``after``. A clip that has been made longer
# by `LONGER_MAX_S` is not made longer again: the next event begins another one, which overlaps it by ``before``.

# No clip begins with less room on the disk: what alarms remember must find some.
FREE_MIN_BYTES = 50_000_000

# What an entry takes in memory beside its data: the objects of its fields.
ENTRY_BYTES = 300


class _Segment(Struct, frozen=True):
    """About a second of a run.

    Attributes:
        resumed: Returns the state with which it begins, as text; empty for that of a run that restored nothing.
        size_bytes: What its entries take in memory.
    """

    began_s: float
    resumed: Callable[[], str]
    configuration: RecordedConfiguration
    entries: list[Entry]
    size_bytes: int


class _OpenClip(Struct):
    """A clip that is being written; ``pending`` are the segments that are not in its file yet."""

    path: Path
    writer: RecordingWriter
    pending: deque[_Segment]


class BlackBoxMemory:
    """Keeps the last seconds of a run, and writes clips. The writer of a `Recorder`.

    Args:
        names: What the names of the clips of this configuration look like, for `max_total`.

    Attributes:
        is_behind: Whether cycles wait to be taken in, so that writing has to wait.
    """

    kind = "black box"
    takes_pictures = True

    def __init__(self, recorded: Recorded, table: BlackBoxTable, names: str) -> None:
        self.is_behind: Callable[[], bool] = lambda: False
        self._recorded = recorded
        self._table = table
        self._names = names
        self._encoder = EntryEncoder(recorded, ImageOptions(quality_percent=table.quality))
        self._segments: deque[_Segment] = deque()
        self._entries: list[Entry] = []
        self._began_s = math.nan
        self._resumed: Callable[[], str] = str
        self._configuration = self._newest_configuration = recorded.configuration
        self._bytes = self._open_bytes = 0
        self._clip: _OpenClip | None = None
        self._clip_trouble = ""
        self._is_short = False

    def trouble(self) -> str:
        """Return in words what is wrong with the memory or the newest clip; empty if nothing is. From any thread."""
        short = f"its memory holds less than {self._table.before:g} s; raise memory, or lower rate or quality"
        return self._clip_trouble or (short if self._is_short else "")

    def write(self, record: CycleRecord, frame: Frame | None = None) -> None:
        """Take in one cycle, and write a second of the clip under way."""
        now_s = record.observation.now_s
        if math.isnan(self._began_s):
            self._began_s = now_s
            self._encoder.begin(now_s)
        for entry in self._encoder.encode(record, frame):
            self._take(entry)
        self._make_room(now_s)
        if not self.is_behind():
            self._go_on()

    def note_resumption(self, text: str) -> None:
        """Take in what the run restores from an earlier one, before the first cycle."""
        self._resumed = lambda: text

    def note_reload(self, now_s: float, configuration: RecordedConfiguration) -> None:
        """Take in that another configuration was loaded, before the first cycle that it decides."""
        self._take(self._encoder.reload(now_s, configuration))
        self._newest_configuration = configuration

    def begin_segment(self, state: State | None) -> None:
        """Put what was taken in since the last call into a segment. The next one begins with this state."""
        if not math.isnan(self._began_s):
            segment = _Segment(self._began_s, self._resumed, self._configuration, self._entries, self._open_bytes)
            self._segments.append(segment)
            self._bytes += segment.size_bytes
            if self._clip is not None:
                self._clip.pending.append(segment)
        self._entries, self._open_bytes, self._began_s = [], 0, math.nan
        self._configuration = self._newest_configuration
        self._resumed = str if state is None else lambda: state_text(state)

    def begin_clip(self, path: Path, clip_of: Mapping[str, str], anchor_ns: int) -> None:
        """Begin a clip with the oldest segment.

        Args:
            clip_of: What for: the kind of event, the rule or source, and the reason.
            anchor_ns: The wall-clock time at which the run's clock showed 0.
        """
        self.finish_clip()
        with self._saying(path, "is not written"):
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            free_bytes = shutil.disk_usage(path.parent).free
            if free_bytes < FREE_MIN_BYTES:
                raise JournalError(f"the disk has only {free_bytes / 1e6:.0f} MB left; make room")
            first = self._segments[0]
            recorded = replace(self._recorded, configuration=first.configuration, clip_of=clip_of)
            writer = RecordingWriter(path, recorded, anchor_ns=anchor_ns)
            writer.note_resumption(first.resumed())
            self._clip = _OpenClip(path, writer, deque(self._segments))

    def finish_clip(self) -> None:
        """Write what the clip under way still lacks, and finish its file."""
        while self._clip is not None and self._clip.pending:
            self._go_on()
        if (clip := self._clip) is not None:
            with self._saying(clip.path, "is not whole"):
                clip.writer.close()
                self._clip, self._clip_trouble = None, ""

    def older_file(self) -> str:
        """Return nothing: each clip has a name of its own."""
        return ""

    def close(self) -> None:
        """Finish the clip under way with what there is."""
        self.begin_segment(None)
        self.finish_clip()

    def abandon(self) -> None:
        """Close the clip under way as it is."""
        if self._clip is not None:
            self._clip.writer.abandon()

    def _take(self, entry: Entry) -> None:
        self._entries.append(entry)
        self._open_bytes += len(entry.data) + ENTRY_BYTES

    def _make_room(self, now_s: float) -> None:
        """Drop what is older than is wanted; then the oldest, while all together takes more memory than it may."""
        while len(self._segments) > 1 and self._segments[1].began_s <= now_s - self._table.before:
            self._drop()
            self._is_short = False
        while self._segments and self._bytes + self._open_bytes > self._table.memory:
            self._drop()
            self._is_short = True

    def _drop(self) -> None:
        """Drop the oldest segment, after it is in the clip that needs it."""
        oldest = self._segments[0]
        if self._clip is not None and self._clip.pending and self._clip.pending[0] is oldest:
            self._go_on()
        self._segments.popleft()
        self._bytes -= oldest.size_bytes

    def _go_on(self) -> None:
        """Write the oldest segment that the clip under way lacks."""
        clip = self._clip
        if clip is None or not clip.pending:
            return
        with self._saying(clip.path, "is not whole"):
            clip.writer.add(clip.pending.popleft().entries)
            clip.writer.flush()
            delete_old(clip.path.parent, math.inf, self._table.max_total, self._names, newest=clip.path.name)
            if clip.writer.size_bytes > self._table.max_total:
                clip.writer.close()
                raise JournalError("it is as large as max_total")

    @contextmanager
    def _saying(self, path: Path, what: str) -> Iterator[None]:
        """Say what a failure makes of a clip, and give that up: the next one may find the disk in order again."""
        try:
            yield
        except (StadimeterError, OSError) as error:
            self.abandon()
            self._clip, self._clip_trouble = None, f"clip {path.name} {what}: {error}"


# The names of clips behind that of the configuration: the time to the millisecond.
NAMES = f"-????????T??????.???Z{ENDING}"

# A clip can begin, and a run that is killed loses, so much at most.
SEGMENT_S = 1.0

# What happens later than this after a clip's first event begins another one.
LONGER_MAX_S = 60.0

# While more cycles than this wait to be encoded, nothing is written.
BEHIND = 2

_KINDS = {EventKind.RAISED: "alarm", EventKind.FAULT: "fault"}


class BlackBox:
    """Keeps the last seconds of a run, and has clips written. A listener of the loop.

    Args:
        state: Returns what the run remembers of its newest cycle.
        tell: Takes what a person should read.

    Attributes:
        clips: The name of the newest clip of each rule, output and so on.
    """

    def __init__(
        self, parts: Parts, state: Callable[[], State | None], tell: Callable[[str], None], deadline: Deadline
    ) -> None:
        table = parts.configuration.black_box or BlackBoxTable()
        self.clips: dict[str, str] = {}
        self._table = table
        self._state, self._tell = state, tell
        self._stem = parts.configuration.path.stem
        self._folder = recordings_folder(parts.configuration.path) / CLIPS
        recorded = what_is_recorded(parts.configuration, parts.cycle.detectors)
        self._memory = BlackBoxMemory(recorded, table, self._stem + NAMES)
        self._recorder = Recorder(self._memory, is_live=parts.is_live, deadline=deadline)
        self._memory.is_behind = lambda: self._recorder.waiting > BEHIND
        self._orders: list[tuple[OutputsArgs, Answer]] = []
        self._due: Callable[[], None] | None = None
        self._name = ""
        self._ends_s = self._latest_s = self._sealed_s = math.nan
        self._said: set[str] = set()
        self._left_out = 0
        self._pictures = ImageChooser(ImageOptions(rate_hz=table.rate))
        self._batch: list[tuple[CycleRecord, Frame | None]] = []

    def act(self, args: OutputsArgs, answer: Answer) -> None:
        """Have a clip written of now. Answers with its name after the next cycle."""
        self._orders.append((args, answer))

    def look(self, record: CycleRecord) -> None:
        """Name the clip of what happened in a cycle, before that is sent to anybody."""
        now_s = record.observation.now_s
        for kind, source, reason in self._found(record):
            self.clips[source] = self._name_clip(now_s, kind, source, reason)
        orders, self._orders = self._orders, []
        for args, answer in orders:
            if self._recorder.failure:
                answer(Reply(error=self.trouble()))
                continue
            name = self._name_clip(now_s, "order", args.by, args.why)
            words = f"{name} will hold the last {self._table.before:g} s and the next {self._table.after:g} s"
            answer(Reply({"words": words, "clip": name, "seconds": round(self._ends_s - now_s, 3)}))

    def __call__(self, record: CycleRecord, frame: Frame | None) -> None:
        """Take in a cycle; begin and end clips."""
        now_s = record.observation.now_s
        is_wanted = frame is not None and self._pictures.is_wanted(record, frame)
        self._batch.append((record, self._recorder.admit(frame) if is_wanted else None))
        is_over = now_s >= self._ends_s
        if self._due is not None or is_over or not 0 <= now_s - self._sealed_s < SEGMENT_S:
            self._sealed_s = now_s
            self._hand_over()
            self._recorder.put(partial(self._memory.begin_segment, self._state()))
            self._left_out, self._recorder.images_left_out = self._recorder.images_left_out, 0
        elif is_wanted:
            self._hand_over()
        if self._due is not None:
            self._recorder.put(self._due)
            self._due = None
        elif is_over:
            self._recorder.put(self._memory.finish_clip)
            self._ends_s = math.nan
        self._tell_trouble()

    def note_state(self, state: State) -> None:
        """Take in what the run restores from an earlier one, before its first cycle."""
        self._recorder.note_state(state)

    def note_reload(self, now_s: float, configuration: RecordedConfiguration) -> None:
        """Take in that another configuration was loaded."""
        self._hand_over()
        self._recorder.note_reload(now_s, configuration)

    def trouble(self) -> str:
        """Describe the trouble with the memory, or with the newest clip; empty if there is none."""
        slow = "pictures are left out, since this computer is too slow" if self._left_out else ""
        words = self._recorder.failure or self._memory.trouble() or slow
        return f"black box: {words}" if words else ""

    def close(self) -> None:
        """Finish the clip under way with what there is, and wait for the disk as long as there is time."""
        self._hand_over()
        self._recorder.close()
        self._tell_trouble()

    def _found(self, record: CycleRecord) -> Iterator[tuple[str, str, str]]:
        """Yield what happened that is worth a clip. An alarm that is inhibited, since it is shelved say, is not."""
        decision, on = record.decision, self._table.on
        for event in decision.events:
            is_inhibited = any(rule.inhibits for rule in decision.rules if rule.rule == event.source)
            if _KINDS.get(event.kind) in on and not is_inhibited:
                yield event.kind.value, event.source, event.reason
        for each in record.observation.operator_commands:
            if (
                isinstance(each, OperatorCommand)
                and each.is_from_button
                and ("button" in on or each.action.writes_file)
            ):
                yield "button", each.by, each.action.value

    def _name_clip(self, now_s: float, kind: str, source: str, reason: str) -> str:
        """Return the name of the clip of this moment: that of the clip under way, or of a new one."""
        ends_s = now_s + self._table.after
        if not ends_s <= self._latest_s or math.isnan(self._ends_s):
            now = datetime.now(UTC)
            self._name = f"{self._stem}-{now:%Y%m%dT%H%M%S}.{now.microsecond // 1000:03}Z{ENDING}"
            anchor_ns = time.time_ns() - round(now_s * 1e9)
            clip_of = {"kind": kind, "source": source, "reason": reason}
            self._due = partial(self._memory.begin_clip, self._folder / self._name, clip_of, anchor_ns)
            self._latest_s = ends_s + LONGER_MAX_S
        self._ends_s = ends_s
        return self._name

    def _hand_over(self) -> None:
        """Hand over the cycles since the last picture: to wake the thread in each cycle would cost the loop more."""
        self._recorder.put(partial(_write, self._memory, self._batch))
        self._batch = []

    def _tell_trouble(self) -> None:
        trouble = self.trouble()
        if trouble and trouble not in self._said:
            self._said.add(trouble)
            self._tell(f"warning: {trouble}")


def _write(memory: BlackBoxMemory, batch: list[tuple[CycleRecord, Frame | None]]) -> None:
    for record, frame in batch:
        memory.write(record, frame)
