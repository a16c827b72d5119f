"""The black box of a run: writes the seconds around an alarm, a fault or the press of a button as a clip.

The loop says what is worth a clip, and gives it a name before the messages of that cycle are sent. All else is done by
the thread of a recorder, so the loop never waits.

The last seconds are in memory, as a row of segments of about a second, each with the state of the run with which it
begins: a recording can begin at any of them and replays to the same decisions. Entries are encoded as they will be
written. A clip is written segment by segment, while the next ones are taken in: a slow disk delays it, and costs no
pictures.

What happens while a clip is under way makes it longer, by the whole of ``after``. A clip that has been made longer by
`LONGER_MAX_S` is not made longer again: the next event begins another one, which overlaps it by ``before``.
"""

from __future__ import annotations

import math
import shutil
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.app.control.messages import OutputsArgs, Reply
from stadimeter.app.control.recording import CLIPS, recordings_folder
from stadimeter.app.control.socket_server import Answer
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.persistence.resumption import state_text
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
from stadimeter.config.optional_tables import BlackBoxTable
from stadimeter.core.decide import State
from stadimeter.core.decision import EventKind
from stadimeter.core.frame import Frame
from stadimeter.errors import JournalError, StadimeterError
from stadimeter.operator_actions import OperatorCommand

if TYPE_CHECKING:
    from stadimeter.app.bootstrap import Parts
    from stadimeter.app.ending import Deadline


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
