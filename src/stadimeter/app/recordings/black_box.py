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
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from mmap import PAGESIZE, mmap
from pathlib import Path

from msgspec import Struct, msgpack
from msgspec.structs import replace
from zstandard import ZstdCompressor, ZstdDecompressor

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.persistence.resumption import state_text
from stadimeter.app.recordings.record_file import delete_old
from stadimeter.app.recordings.recorded_configuration import RecordedConfiguration
from stadimeter.app.recordings.recording import Entry, EntryEncoder, ImageOptions, Recorded, RecordingWriter
from stadimeter.config.optional_tables import BlackBoxTable
from stadimeter.core.decide import State
from stadimeter.core.frame import Frame
from stadimeter.errors import JournalError, StadimeterError

# No clip begins with less room on the disk: what alarms remember must find some.
FREE_MIN_BYTES = 50_000_000


class _Segment(Struct, frozen=True):
    """About a second of a run.

    Attributes:
        resumed: Returns the state with which it begins, as text; empty for that of a run that restored nothing.
        data: Its entries one after the other as MessagePack, compressed.
        count: How many there are.
    """

    began_s: float
    resumed: Callable[[], str]
    configuration: RecordedConfiguration
    data: mmap
    count: int

    @property
    def size_bytes(self) -> int:
        """The space it takes in memory: whole pages."""
        return -(-len(self.data) // PAGESIZE) * PAGESIZE

    def entries(self) -> list[Entry]:
        """Return its entries: as MessagePack, an array of that many."""
        packed = ZstdDecompressor().decompressobj().decompress(memoryview(self.data))
        return msgpack.decode(b"\xdd" + self.count.to_bytes(4, "big") + packed, type=list[Entry])


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
        self._compressor = ZstdCompressor(level=1)
        self._segments: deque[_Segment] = deque()
        self._chunks: list[bytes] = []
        self._stream = self._compressor.compressobj()
        self._began_s = math.nan
        self._resumed: Callable[[], str] = str
        self._configuration = self._newest_configuration = recorded.configuration
        self._bytes = self._open_bytes = self._count = 0
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
            self._keep(self._stream.flush())
            data = mmap(-1, self._open_bytes)
            for chunk in self._chunks:
                data.write(chunk)
            segment = _Segment(self._began_s, self._resumed, self._configuration, data, self._count)
            self._segments.append(segment)
            self._bytes += segment.size_bytes
            if self._clip is not None:
                self._clip.pending.append(segment)
        self._chunks, self._stream = [], self._compressor.compressobj()
        self._count, self._open_bytes, self._began_s = 0, 0, math.nan
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
        self._keep(self._stream.compress(msgpack.encode(entry)))
        self._count += 1

    def _keep(self, chunk: bytes) -> None:
        self._chunks.append(chunk)
        self._open_bytes += len(chunk)

    def _make_room(self, now_s: float) -> None:
        """Drop what is older than is wanted; then the oldest, while all together takes more memory than it may.

        The segment that is being filled counts as large as the last one: allocators do not give its room back.
        """
        while len(self._segments) > 1 and self._segments[1].began_s <= now_s - self._table.before:
            self._drop()
            self._is_short = False
        while (
            self._segments and self._bytes + max(self._open_bytes, self._segments[-1].size_bytes) > self._table.memory
        ):
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
            clip.writer.add(clip.pending.popleft().entries())
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
