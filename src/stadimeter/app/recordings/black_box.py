"""The last seconds of a run in memory, and the clips that are written from them. All of it is done by one thread.

The memory is a row of segments of about a second, each with the state of the run with which it begins: a recording can
begin at any of them and replays to the same decisions. A segment is encoded and compressed as it will be written, in a
mapping of its own: its bytes are known, and go back to the system when it is dropped.

A clip is written segment by segment, while the next ones are taken in: a slow disk delays it, and costs no pictures.
"""

from __future__ import annotations

import math
import shutil
from collections import deque
from collections.abc import Callable, Mapping
from mmap import PAGESIZE, mmap
from pathlib import Path

from msgspec import Struct, msgpack
from msgspec.structs import replace
from zstandard import ZstdCompressor, ZstdDecompressor

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.persistence.resumption import state_text
from stadimeter.app.recordings.record_file import delete_old
from stadimeter.app.recordings.recorded_configuration import RecordedConfiguration
from stadimeter.app.recordings.recording import (
    Entry,
    EntryEncoder,
    ImageOptions,
    Recorded,
    RecordingWriter,
    reload_entry,
)
from stadimeter.config.black_box_table import BlackBoxTable
from stadimeter.core.decide import State
from stadimeter.core.frame import Frame
from stadimeter.errors import JournalError, StadimeterError

# What Python needs for an entry beside its data: the object, its two numbers and the head of its bytes.
ENTRY_BYTES = 200

# No clip begins with less room on the disk: what alarms remember must find some.
FREE_MIN_BYTES = 50_000_000


class Clip(Struct, frozen=True, kw_only=True):
    """A clip to be written.

    Attributes:
        clip_of: What for: the kind of event, and the rule or source.
        anchor_ns: The wall-clock time at which the run's clock showed 0.
    """

    path: Path
    clip_of: Mapping[str, str]
    anchor_ns: int


class _Segment(Struct, frozen=True):
    """About a second of a run.

    Attributes:
        resumed: Returns the state with which it begins, as text; empty for that of a run that restored nothing.
        size_bytes: What it takes in memory.
    """

    began_s: float
    resumed: Callable[[], str]
    configuration: RecordedConfiguration
    data: mmap
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
        self._encoder = EntryEncoder(recorded, ImageOptions(rate_hz=table.rate, quality_percent=table.quality))
        self._compressor, self._decompressor = ZstdCompressor(level=1), ZstdDecompressor()
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
        new = [*self._encoder.encode(record, frame)]
        self._entries += new
        self._open_bytes += sum(ENTRY_BYTES + len(entry.data) for entry in new)
        self._make_room(now_s)
        if not self.is_behind():
            self._go_on()

    def note_resumption(self, text: str) -> None:
        """Take in what the run restores from an earlier one, before the first cycle."""
        self._resumed = lambda: text

    def note_reload(self, now_s: float, configuration: RecordedConfiguration) -> None:
        """Take in that another configuration was loaded, before the first cycle that it decides."""
        self._entries.append(reload_entry(now_s, configuration))
        self._newest_configuration = configuration

    def begin_segment(self, state: State | None) -> None:
        """Put what was taken in since the last call into a segment. The next one begins with this state."""
        if not math.isnan(self._began_s):
            packed = self._compressor.compress(msgpack.encode(self._entries))
            data = mmap(-1, len(packed))
            data.write(packed)
            size_bytes = -(-len(packed) // PAGESIZE) * PAGESIZE
            segment = _Segment(self._began_s, self._resumed, self._configuration, data, size_bytes)
            self._segments.append(segment)
            self._bytes += size_bytes
            if self._clip is not None:
                self._clip.pending.append(segment)
        self._entries, self._open_bytes, self._began_s = [], 0, math.nan
        self._configuration = self._newest_configuration
        self._resumed = str if state is None else lambda: state_text(state)

    def begin_clip(self, clip: Clip) -> None:
        """Begin a clip with the oldest segment."""
        self.finish_clip()
        try:
            clip.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            free_bytes = shutil.disk_usage(clip.path.parent).free
            if free_bytes < FREE_MIN_BYTES:
                raise JournalError(f"the disk has only {free_bytes / 1e6:.0f} MB left; make room")
            first = self._segments[0]
            recorded = replace(self._recorded, configuration=first.configuration, clip_of=clip.clip_of)
            writer = RecordingWriter(clip.path, recorded, anchor_ns=clip.anchor_ns)
            writer.note_resumption(first.resumed())
            self._clip = _OpenClip(clip.path, writer, deque(self._segments))
        except (StadimeterError, OSError) as error:
            self._clip_trouble = f"clip {clip.path.name} is not written: {error}"

    def finish_clip(self) -> None:
        """Write what the clip under way still lacks, and finish its file."""
        while self._clip is not None and self._clip.pending:
            self._go_on()
        self._end(self._clip, "")

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
        try:
            packed = self._decompressor.decompress(memoryview(clip.pending.popleft().data))
            clip.writer.add(msgpack.decode(packed, type=list[Entry]))
            clip.writer.flush()
            delete_old(clip.path.parent, math.inf, self._table.max_total, self._names, newest=clip.path.name)
        except (StadimeterError, OSError) as error:
            clip.writer.abandon()
            self._clip, self._clip_trouble = None, f"clip {clip.path.name} is not whole: {error}"
            return
        if clip.writer.size_bytes > self._table.max_total:
            self._end(clip, f"clip {clip.path.name} ends early: it is as large as max_total")

    def _end(self, clip: _OpenClip | None, trouble: str) -> None:
        """Finish the file of a clip."""
        self._clip = None
        if clip is None:
            return
        try:
            clip.writer.close()
            self._clip_trouble = trouble
        except (StadimeterError, OSError) as error:
            self._clip_trouble = f"clip {clip.path.name} is not whole: {error}"
