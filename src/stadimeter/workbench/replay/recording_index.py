"""Random access to the moments of a recording with pictures, fast enough for a slider.

A recording consists of chunks of about a second, each with the times of what is in it at its beginning. Only these are
read to find a moment; then one chunk is decompressed, and kept, since the next moment that is asked for is near.
"""

from __future__ import annotations

import os
import struct
from bisect import bisect_right
from pathlib import Path

from msgspec import Struct, field

from stadimeter.app.recordings.journal import RecordedCycle, readable
from stadimeter.app.recordings.record_file import MAGIC
from stadimeter.app.recordings.recording import ANNOTATIONS, CYCLES, IMAGES
from stadimeter.config.untrusted_file import CHUNK_MAX_BYTES
from stadimeter.core.frame import Frame
from stadimeter.errors import JournalError
from stadimeter.workbench.replay.recording_reader import (
    CHUNK,
    DATA_END,
    MESSAGE_INDEX,
    RECORD_HEAD,
    McapRecording,
    RecordedImage,
    messages_in,
    read_mcap,
)

# A chunk begins with the times of its first and its last message, in nanoseconds.
_TIMES = struct.Struct("<QQ")

# The newest picture before a moment is searched in this many chunks: about a minute.
_BACK_MAX = 60

# The number of decompressed chunks that are kept; one of full HD takes 10 MB.
_KEPT_MAX = 2


class _Chunk(Struct, frozen=True):
    at_byte: int
    length: int
    from_ns: int
    to_ns: int


class _Entry(Struct, frozen=True):
    """A cycle, and the picture that was new in it, if it was recorded, with what is drawn into it."""

    at_ns: int
    cycle: RecordedCycle
    image: RecordedImage | None
    annotations: bytes


class RecordedMoment(Struct, frozen=True, eq=False):
    """The newest cycle and picture at a moment of a recording.

    Attributes:
        at_s: When it was, since the beginning of the recording.
        cycle: The newest cycle by then.
        frame: The newest picture by then that was recorded; None if there is none nearby.
        seen: The cycle in which that picture was new.
        annotations: What is drawn into that picture, as the message of the recording has it; empty for nothing.
    """

    at_s: float
    cycle: RecordedCycle
    frame: Frame | None = None
    seen: RecordedCycle | None = None
    annotations: bytes = b""


class RecordingIndex(Struct, kw_only=True):
    """The places of a recording's moments in its file."""

    recording: McapRecording
    _chunks: list[_Chunk]
    _topics: dict[int, str] = field(default_factory=dict)
    _kept: dict[int, list[_Entry]] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Its duration."""
        return (self._chunks[-1].to_ns - self._chunks[0].from_ns) / 1e9

    def moment(self, at_s: float) -> RecordedMoment:
        """Find what it holds of a moment, which may be before the first or after the last.

        Args:
            at_s: Since the beginning of the recording.

        Raises:
            JournalError: The recording is damaged there.
        """
        begin_ns = self._chunks[0].from_ns
        at_ns = begin_ns + round(min(max(at_s, 0.0), self.seconds) * 1e9)
        number = max(0, bisect_right(self._chunks, at_ns, key=lambda chunk: chunk.from_ns) - 1)
        entries = self._entries(number)
        now = max((each for each in entries if each.at_ns <= at_ns), key=lambda each: each.at_ns, default=None)
        if now is None:
            now = self._first(entries)
        found_s = (now.at_ns - begin_ns) / 1e9
        shown = self._newest_with_image(number, max(at_ns, now.at_ns))
        frame = shown.image.frame_of(shown.cycle) if shown is not None and shown.image is not None else None
        if shown is None or frame is None:
            return RecordedMoment(found_s, now.cycle)
        return RecordedMoment(found_s, now.cycle, frame, shown.cycle, shown.annotations)

    def _first(self, entries: list[_Entry]) -> _Entry:
        if not entries:
            raise JournalError(f"{self.recording.path}: there is no whole cycle at that moment")
        return entries[0]

    def _newest_with_image(self, number: int, at_ns: int) -> _Entry | None:
        for before in range(number, max(-1, number - _BACK_MAX), -1):
            found = [each for each in self._entries(before) if each.image is not None and each.at_ns <= at_ns]
            if found:
                return found[-1]
        return None

    def _entries(self, number: int) -> list[_Entry]:
        if number not in self._kept:
            while len(self._kept) >= _KEPT_MAX:
                del self._kept[next(iter(self._kept))]
            self._kept[number] = self._read(self._chunks[number])
        return self._kept[number]

    def _read(self, chunk: _Chunk) -> list[_Entry]:
        path = self.recording.path
        entries: list[_Entry] = []
        image, annotations = None, b""
        for topic, message in messages_in(f"{path}, byte {chunk.at_byte}", _content(path, chunk), self._topics):
            place = f"{path}, frame or cycle {message.sequence}"
            if topic == IMAGES:
                image = RecordedImage(message.sequence, message.data, place)
            elif topic == ANNOTATIONS:
                annotations = message.data
            elif topic == CYCLES:
                cycle = RecordedCycle(message.data, place)
                entries.append(_Entry(message.log_time, cycle, image, annotations))
                image, annotations = None, b""
        return entries


def read_index(path: Path) -> RecordingIndex:
    """Open a recording and find out where its moments are.

    Raises:
        JournalError: It cannot be read, or ends before its first second was on the disk.
        DriverUnavailableError: The library ``mcap`` is not installed.
    """
    recording = read_mcap(path)
    chunks, introduced = _scan_chunks(path)
    if not chunks:
        raise JournalError(f"{path}: the recording ends before its first cycle")
    topics: dict[int, str] = {}
    for chunk in introduced:
        for _ in messages_in(f"{path}, byte {chunk.at_byte}", _content(path, chunk), topics):
            pass
    return RecordingIndex(recording=recording, _chunks=chunks, _topics=topics)


def _scan_chunks(path: Path) -> tuple[list[_Chunk], list[_Chunk]]:
    """Return the whole chunks, and those in which a topic comes up for the first time, which introduce it."""
    chunks: list[_Chunk] = []
    first: dict[int, _Chunk] = {}
    with readable(path) as file:
        size = os.fstat(file.fileno()).st_size
        at = file.seek(len(MAGIC))
        while len(head := file.read(RECORD_HEAD.size + _TIMES.size)) >= RECORD_HEAD.size:
            opcode, length = RECORD_HEAD.unpack_from(head)
            end = at + RECORD_HEAD.size + length
            if opcode == DATA_END or end > size:
                break
            if opcode == CHUNK and len(head) == RECORD_HEAD.size + _TIMES.size:
                chunks.append(_Chunk(at, length, *_TIMES.unpack_from(head, RECORD_HEAD.size)))
            elif opcode == MESSAGE_INDEX and chunks:
                first.setdefault(int.from_bytes(head[RECORD_HEAD.size :][:2], "little"), chunks[-1])
            at = file.seek(end)
    return chunks, list(dict.fromkeys(first.values()))


def _content(path: Path, chunk: _Chunk) -> bytes:
    if chunk.length > CHUNK_MAX_BYTES:
        raise JournalError(f"{path}, byte {chunk.at_byte}: the recording is damaged: a record of {chunk.length} bytes")
    with readable(path) as file:
        file.seek(chunk.at_byte + RECORD_HEAD.size)
        return file.read(chunk.length)
