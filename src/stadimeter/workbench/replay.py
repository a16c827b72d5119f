"""Recordings, read and replayed: MCAP files that ``run --record`` wrote, whole ones and those that were cut off.

A recording consists of chunks of about a second, each with the times of what is in it at its beginning. To find a
moment, fast enough for a slider, only these are read; then one chunk is decompressed, and kept, since the next moment
that is asked for is near.
"""

from __future__ import annotations

import os
import struct
from base64 import b64decode
from binascii import Error as Base64Error
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.app.detectors import NamedDetector, build_detectors
from stadimeter.app.persistence.resumption import read_state
from stadimeter.app.recordings.journal import (
    FILE_NAME,
    LIBRARY,
    MAGIC,
    Journal,
    JournalHeader,
    RecordedConfiguration,
    RecordedCycle,
    load_recorded,
    read_journal,
    readable,
    reload_of,
)
from stadimeter.app.recordings.recording import (
    ANNOTATIONS,
    CAMERA_FILE,
    CLIP_OF,
    CONFIGURATION,
    CYCLES,
    FORMAT,
    IMAGES,
    METADATA,
    RESUMED_NAME,
    require_mcap,
)
from stadimeter.config.files import CHUNK_MAX_BYTES, decode_picture
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.decide import State, decide, initial_state
from stadimeter.core.decision import Decision
from stadimeter.core.frame import Frame, Image
from stadimeter.core.observation import Observation
from stadimeter.core.persistence import reload
from stadimeter.core.plan import Plan
from stadimeter.errors import ConfigError, DriverError, JournalError, PictureError, Problem, StateError
from stadimeter.perception.perceiver import Perceiver

with suppress(ImportError):  # an extra; without it `read_mcap` raises
    from mcap.data_stream import ReadDataStream
    from mcap.records import Attachment, Channel, Chunk, Header, Message, Metadata
    from mcap.stream_reader import breakup_chunk

# The opcodes of the records that matter here.
RECORD_HEAD = struct.Struct("<BQ")
_HEADER, CHUNK, MESSAGE_INDEX, _ATTACHMENT, _METADATA, DATA_END = 0x01, 0x06, 0x07, 0x09, 0x0C, 0x0F

_IMAGE_BEGINS = b'"data":"'


class RecordedImage(Struct, frozen=True, eq=False):
    """A picture of a recording, not decoded yet.

    Attributes:
        sequence: The camera's count of the frame, in 32 bits.
        place: Where it stands, for error messages.
    """

    sequence: int
    message: bytes
    place: str

    def decode(self) -> Image:
        """Return the picture; raises JournalError if it is damaged."""
        begin = self.message.find(_IMAGE_BEGINS) + len(_IMAGE_BEGINS)
        try:
            jpeg = b64decode(self.message[begin : self.message.find(b'"', begin)], validate=True)
            return decode_picture(jpeg)
        except (Base64Error, PictureError) as error:
            raise JournalError(f"{self.place}: a damaged picture") from error

    def frame_of(self, cycle: RecordedCycle) -> Frame | None:
        """Return the frame that was new in a cycle, with this picture; None if the picture is of another one.

        Raises:
            JournalError: The picture or the cycle is damaged.
        """
        stamp = cycle.observation().frame
        if stamp is None or stamp.sequence % 2**32 != self.sequence:
            return None
        return Frame(self.decode(), stamp.captured_at_s, stamp.sequence, self.place)


class McapRecording(Struct, frozen=True, kw_only=True):
    """A recording that was opened.

    Attributes:
        clip_of: Of a clip, the kind of event that it was written for, and the rule or source; None for no clip.
    """

    path: Path
    header: JournalHeader
    clip_of: Mapping[str, str] | None = None

    def cycles(self) -> Iterator[RecordedCycle]:
        """Yield every cycle, in order; raises JournalError if the file is damaged."""
        return (entry.cycle for entry in self._entries())

    def cycles_and_images(self) -> Iterator[tuple[RecordedCycle, RecordedImage | None]]:
        """Yield every cycle with its new picture, if it was recorded; raises JournalError for damage."""
        return ((entry.cycle, entry.image) for entry in self._entries())

    def has_images(self) -> bool:
        """Check whether there is a picture at all; raises JournalError if the file is damaged."""
        return any(topic == IMAGES for topic, _ in _messages(self.path))

    def is_cut_off(self) -> bool:
        """Check whether the file was not finished, as after a power cut or on a full disk."""
        with readable(self.path) as file:
            size = file.seek(0, 2)
            file.seek(max(0, size - len(MAGIC)))
            return size < 2 * len(MAGIC) or file.read() != MAGIC

    def _entries(self) -> Iterator[_Entry]:
        return entries_of(self.path, _messages(self.path))


class _Entry(Struct, frozen=True):
    """A cycle, and the picture that was new in it, if it was recorded, with what is drawn into it."""

    at_ns: int
    cycle: RecordedCycle
    image: RecordedImage | None
    annotations: bytes


def entries_of(path: Path, messages: Iterable[tuple[str, Message]]) -> Iterator[_Entry]:
    """Yield each cycle among messages, with those that stand before it and belong to it."""
    image, annotations, reloaded = None, b"", None
    for topic, message in messages:
        place = f"{path}, message {message.sequence} of {topic}"
        if topic == IMAGES:
            image = RecordedImage(message.sequence, message.data, place)
        elif topic == ANNOTATIONS:
            annotations = message.data
        elif topic == CONFIGURATION:
            reloaded = reload_of(message.data, place)
        elif topic == CYCLES:
            yield _Entry(message.log_time, RecordedCycle(message.data, place, reloaded), image, annotations)
            image, annotations, reloaded = None, b"", None


def read_mcap(path: Path) -> McapRecording:
    """Open a recording and read what it says about its run.

    Raises:
        JournalError: It cannot be read, is no recording of ours, or one of a later format.
        DriverUnavailableError: The library ``mcap`` is not installed.
    """
    require_mcap(f"reading {path}")
    about, files = _about(path)
    version = about.get("format", "")
    if version != str(FORMAT):
        raise JournalError(f"{path}: a recording of format {version}; this version of stadimeter reads format {FORMAT}")
    header = JournalHeader(
        stadimeter_journal=FORMAT,
        version=about.get("version", ""),
        began_at=about.get("began_at", ""),
        configuration=files.pop(FILE_NAME),
        configuration_sha256=about.get("configuration_sha256", ""),
        resumed=files.pop(RESUMED_NAME, ""),
        files={name.removeprefix(CAMERA_FILE): text for name, text in files.items() if name.startswith(CAMERA_FILE)},
    )
    clip_of = {key.removeprefix(CLIP_OF): value for key, value in about.items() if key.startswith(CLIP_OF)}
    return McapRecording(path=path, header=header, clip_of=clip_of or None)


def _about(path: Path) -> tuple[dict[str, str], dict[str, str]]:
    """Return the metadata of a recording and the files attached to it; they stand before its first chunk."""
    about: dict[str, str] = {}
    files: dict[str, str] = {}
    for place, opcode, data in _records(path):
        if opcode == CHUNK:
            break
        stream = ReadDataStream(BytesIO(data))
        if opcode == _HEADER:
            library = _call_reader(place, Header.read, stream).library
            if not library.startswith(LIBRARY):
                raise JournalError(f"{path}: an MCAP file written by {library}, and not by `stadimeter run --record`")
        elif opcode == _METADATA:
            metadata = _call_reader(place, Metadata.read, stream)
            about |= metadata.metadata if metadata.name == METADATA else {}
        elif opcode == _ATTACHMENT:
            attachment = _call_reader(place, Attachment.read, stream)
            files[attachment.name] = attachment.data.decode(errors="replace")
    # What was cut off before the configuration tells nothing; one of a later format may have none.
    if not about or (about.get("format") == str(FORMAT) and FILE_NAME not in files):
        raise JournalError(f"{path}: the recording ends before its first cycle")
    return about, files


def _messages(path: Path) -> Iterator[tuple[str, Message]]:
    """Yield the messages, each behind its topic, in the order of the file."""
    channels: dict[int, str] = {}
    for place, opcode, data in _records(path):
        if opcode == DATA_END:
            return
        if opcode == CHUNK:
            yield from messages_in(place, data, channels)


def messages_in(place: str, chunk: bytes, channels: dict[int, str]) -> Iterator[tuple[str, Message]]:
    """Yield the messages of a chunk that was read, each behind its topic.

    Args:
        channels: The topics by the numbers that messages have for them. Those that the chunk introduces are added.
    """
    for record in _call_reader(place, _break_up, chunk):
        if isinstance(record, Channel):
            channels[record.id] = record.topic
        elif isinstance(record, Message):
            yield channels.get(record.channel_id, ""), record


def _heads(path: Path, file: BinaryIO) -> Iterator[tuple[int, int, int]]:
    """Yield the place, the opcode and the length of every record that is whole, and have its content be read next.

    A file may end anywhere. The library's own reader of streams takes the bytes before the end for a whole record.
    """
    size, at = os.fstat(file.fileno()).st_size, len(MAGIC)
    file.seek(at)
    while len(head := file.read(RECORD_HEAD.size)) == RECORD_HEAD.size:
        opcode, length = RECORD_HEAD.unpack(head)
        if length > CHUNK_MAX_BYTES:
            raise JournalError(f"{path}, byte {at}: the recording is damaged: a record of {length} bytes")
        end = at + RECORD_HEAD.size + length
        if end > size:
            return
        yield at, opcode, length
        at = file.seek(end)


def _records(path: Path) -> Iterator[tuple[str, int, bytes]]:
    """Yield the place, the opcode and the content of every record that is whole."""
    with readable(path) as file:
        for at, opcode, length in _heads(path, file):
            yield f"{path}, byte {at}", opcode, file.read(length)


def _break_up(chunk: bytes) -> list[Any]:
    return breakup_chunk(Chunk.read(ReadDataStream(BytesIO(chunk))), validate_crc=True)


def _call_reader(place: str, read: Callable[[Any], Any], what: Any) -> Any:
    """Call a reader of the library; whatever it makes of damaged bytes is one kind of error."""
    try:
        return read(what)
    except Exception as error:
        # The library raises errors of its own, of both compressors, of struct and of the text decoder.
        raise JournalError(f"{place}: the recording is damaged: {error or type(error).__name__}") from error


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
        if not entries:
            raise JournalError(f"{self.recording.path}: there is no whole cycle at that moment")
        now = max((each for each in entries if each.at_ns <= at_ns), key=lambda each: each.at_ns, default=entries[0])
        found_s = (now.at_ns - begin_ns) / 1e9
        shown = self._newest_with_image(number, max(at_ns, now.at_ns))
        frame = shown.image.frame_of(shown.cycle) if shown is not None and shown.image is not None else None
        if shown is None or frame is None:
            return RecordedMoment(found_s, now.cycle)
        return RecordedMoment(found_s, now.cycle, frame, shown.cycle, shown.annotations)

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
            chunk, path = self._chunks[number], self.recording.path
            messages = messages_in(f"{path}, byte {chunk.at_byte}", _content(path, chunk), self._topics)
            self._kept[number] = [*entries_of(path, messages)]
        return self._kept[number]


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
        for at, opcode, length in _heads(path, file):
            if opcode == DATA_END:
                break
            if opcode == CHUNK and len(times := file.read(_TIMES.size)) == _TIMES.size:
                chunks.append(_Chunk(at, length, *_TIMES.unpack(times)))
            elif opcode == MESSAGE_INDEX and chunks:
                first.setdefault(int.from_bytes(file.read(2), "little"), chunks[-1])
    return chunks, list(dict.fromkeys(first.values()))


def _content(path: Path, chunk: _Chunk) -> bytes:
    with readable(path) as file:
        file.seek(chunk.at_byte + RECORD_HEAD.size)
        return file.read(chunk.length)


# Replaying journals and recordings: the same rules, or others, over what was observed. No driver is opened.


AnyRecording = Journal | McapRecording


def read_recording(path: Path) -> AnyRecording:
    """Open a journal or a recording, of which only the beginning is read.

    Raises:
        JournalError: It cannot be read, is neither, or is of a later format.
        DriverUnavailableError: It is an MCAP file, and the library ``mcap`` is not installed.
    """
    with readable(path) as file:
        head = file.read(len(MAGIC))
    if head != MAGIC:
        return read_journal(path)
    return read_mcap(path)


Replayed = tuple[RecordedCycle, Observation, Decision]

# Returns the state with which to go on by another configuration, as a run does at a reload.
OnReload = Callable[[State, RecordedConfiguration], State]


# Returns what is observed in a cycle: its picture comes with it if that was recorded, and the core's state before it.
Observe = Callable[[RecordedCycle, RecordedImage | None, State], Observation]


def _detectors(configuration: Configuration) -> tuple[NamedDetector, ...]:
    try:
        return build_detectors(configuration.targets, configuration.camera_model)
    except (ConfigError, DriverError) as error:
        message = f"a target cannot be measured in recorded pictures: {error}"
        hint = "name a configuration whose detectors look at pictures with --config"
        raise ConfigError([Problem(message, str(configuration.path), hint=hint)]) from error


def redetect(configuration: Configuration) -> Observe:
    """Return the function that measures the targets of a configuration in recorded pictures.

    It raises a `CalibrationError` for a picture of another aspect, a `JournalError` for one that is damaged.

    Raises:
        ConfigError: It has no camera model, or a detector cannot be built, such as one that asks the simulated world
            instead of the picture.
    """
    if configuration.camera_model is None:
        raise ConfigError([Problem("there is no camera model to measure with", str(configuration.path))])
    detectors = {member: each.detector for each in _detectors(configuration) for member in each.members}
    perceiver = Perceiver(detectors, configuration.camera_model, configuration.footings)

    def observe(cycle: RecordedCycle, image: RecordedImage | None, state: State) -> Observation:
        observation = cycle.observation()
        frame = image.frame_of(cycle) if image is not None else None
        if frame is None:
            reason = observation.camera_fault or ("its picture is not recorded" if observation.frame else "")
            return replace(observation, frame=None, measurements=(), camera_fault=reason)
        _, measurements = perceiver.look(frame, {tracked.track.target: tracked.track for tracked in state.tracks})
        return replace(observation, measurements=measurements)

    return observe


def first_state(recording: AnyRecording, plan: Plan) -> State:
    """Return the state with which a replay begins: the snapshot that the run restored, if any.

    Raises:
        JournalError: The snapshot is damaged.
    """
    state = initial_state(plan)
    if not recording.header.resumed:
        return state
    try:
        return read_state(recording.header.resumed, state)
    except StateError as error:
        raise JournalError(f"{recording.path}: {error}") from error


def decisions(
    recording: AnyRecording, plan: Plan, on_reload: OnReload | None = None, from_s: float | None = None
) -> Iterator[Replayed]:
    """Decide again on everything that was observed, by rules that need not be those of the recording.

    Args:
        on_reload: Applied where the run reloaded its configuration; None to go on with these rules.
        from_s: When to begin, with nothing known, on the clock of the run; None for its beginning.

    Raises:
        JournalError: The recording is damaged.
    """
    state = first_state(recording, plan) if from_s is None else initial_state(plan)
    cycles = ((cycle, None) for cycle in recording.cycles() if from_s is None or cycle.now_s() >= from_s)
    return _decide(state, cycles, lambda cycle, _image, _state: cycle.observation(), on_reload)


def _decide(
    state: State,
    cycles: Iterable[tuple[RecordedCycle, RecordedImage | None]],
    observe: Observe,
    on_reload: OnReload | None,
) -> Iterator[Replayed]:
    for cycle, image in cycles:
        if cycle.reloaded is not None and on_reload is not None:
            state = on_reload(state, cycle.reloaded)
        observation = observe(cycle, image, state)
        state, decision = decide(state, observation)
        yield cycle, observation, decision


class ReplayRun(Struct, frozen=True):
    """Decides over a recording by one configuration. It may be gone through any number of times, always the same.

    Attributes:
        is_recorded: Whether that is the recording's own: then recorded reloads are followed.
    """

    recording: AnyRecording
    configuration: Configuration
    is_recorded: bool = False
    from_images: bool = False

    def __iter__(self) -> Iterator[Replayed]:
        """Return each cycle, what is observed in it, and what is decided now.

        Raises:
            JournalError: The recording is damaged, or has no pictures to measure in.
            StadimeterError: The configuration cannot measure in its pictures.
        """
        on_reload = self._reload if self.is_recorded else None
        if not self.from_images:
            return decisions(self.recording, self.configuration.plan, on_reload)
        if not isinstance(self.recording, McapRecording):
            how = "record one with `stadimeter run CONFIG --record FILE.mcap`"
            raise JournalError(f"{self.recording.path} is a journal, and has no pictures to measure in; {how}")
        if not self.recording.has_images():
            how = "it was made with `--record-images none`, or ends before the first"
            raise JournalError(f"{self.recording.path} has no pictures to measure in: {how}")
        state = first_state(self.recording, self.configuration.plan)
        return _decide(state, self.recording.cycles_and_images(), redetect(self.configuration), on_reload)

    def _reload(self, state: State, recorded: RecordedConfiguration) -> State:
        return reload(state, load_recorded(recorded, self.recording.path).plan).state


def replay_run(recording: AnyRecording, config: Path | None, *, from_images: bool = False) -> ReplayRun:
    """Prepare a replay by a configuration, or by that of the recording.

    Raises:
        ConfigError: The configuration cannot be used.
    """
    if config is not None:
        return ReplayRun(recording, load_configuration(config), from_images=from_images)
    loaded = load_recorded(recording.header.recorded_configuration, recording.path)
    return ReplayRun(recording, loaded, is_recorded=True, from_images=from_images)
