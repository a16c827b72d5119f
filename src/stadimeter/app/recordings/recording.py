"""A recording: every cycle of a run, and its pictures, in an MCAP file that the tools of roboticists open.

Topics: ``/cycle``, from which a run is replayed; ``/camera/image``, ``/camera/calibration``, ``/camera/annotations``;
``/targets/NAME``, to plot distances; ``/log``, the events. The configuration is an attachment; ``/configuration`` has
those that were reloaded while running. Times are those of the
run's monotonic clock, moved so that the first cycle is at the wall-clock time of the beginning: a wall clock that is
set meanwhile moves nothing.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from msgspec import Struct, field
from msgspec.structs import replace

import stadimeter
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.recordings import journal
from stadimeter.app.recordings import recording_messages as messages
from stadimeter.config.extras import require
from stadimeter.config.files import sha256_of
from stadimeter.config.loader import Configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import TargetShape
from stadimeter.core.frame import Frame
from stadimeter.detectors.protocol import Detector

if TYPE_CHECKING:
    from mcap.writer import Writer

# Begins the name of an attachment that holds a file that the configuration names.
FORMAT = 2
CYCLES = "/cycle"
CONFIGURATION = "/configuration"
IMAGES = "/camera/image"
CALIBRATION = "/camera/calibration"
ANNOTATIONS = "/camera/annotations"
LOG = "/log"
TARGETS = "/targets/"
METADATA = "stadimeter"
CAMERA_FILE = "camera file: "

# Begins the keys of the metadata that say what a clip was written for.
CLIP_OF = "clip_"

# The name of the attachment that holds what the run restored from an earlier one.
RESUMED_NAME = "resumed.json"

# What is newer than this may be lost if the program is killed.
FLUSH_S = 1.0

# Message counters of MCAP have 32 bits.
SEQUENCE_MAX = 2**32

ImageChoice = Literal["none", "events", "all"]


class ImageOptions(Struct, frozen=True, kw_only=True):
    """The choice of pictures that a recording holds.

    Attributes:
        images: ``all``; ``events``, in which something happened: an event, or another status of a rule or a target;
            or ``none``.
        rate_hz: Upper limit of pictures a second of the run; None for no limit.
        quality_percent: The quality of their JPEGs, 1 to 100.
    """

    images: ImageChoice = "all"
    rate_hz: float | None = None
    quality_percent: int = 90


class Recorded(Struct, frozen=True, kw_only=True):
    """The facts that a recording states about its run once and for all.

    Attributes:
        clip_of: Of a clip, what it was written for: the kind of event, and the rule or source; empty for none.
    """

    configuration: journal.RecordedConfiguration
    camera: CameraModel | None = None
    sizes: Mapping[str, TargetShape] = field(default_factory=dict)
    clip_of: Mapping[str, str] = field(default_factory=dict)


def what_is_recorded(
    configuration: Configuration,
    detectors: Mapping[str, Detector],
    recorded: journal.RecordedConfiguration | None = None,
) -> Recorded:
    """Return the facts that the recordings of a run state about it."""
    return Recorded(
        configuration=recorded or journal.to_be_recorded(configuration),
        camera=configuration.camera_model,
        sizes={name: detector.target_shape for name, detector in detectors.items()},
    )


class Entry(Struct, frozen=True):
    """The content of a recording at one moment of one topic.

    Attributes:
        at_s: When, on the run's clock.
        data: The message; of a picture its JPEG.
        taken_s: Of a picture, when it was taken.
    """

    topic: str
    schema: str
    at_s: float
    data: bytes
    sequence: int = 0
    taken_s: float = 0.0


class EntryEncoder:
    """Makes the entries of each cycle of a run.

    Attributes:
        anchor_ns: The wall-clock time, in nanoseconds since 1970, at which the run's clock showed 0.
    """

    def __init__(self, recorded: Recorded, options: ImageOptions) -> None:
        self.anchor_ns = 0
        self._recorded = recorded
        self._choice = ImageChooser(options)
        self._quality_percent = options.quality_percent
        self._lens: CameraModel | None = None
        self._cycles = 0

    def begin(self, now_s: float, anchor_ns: int | None = None) -> None:
        """Give the camera model again before the next picture, and label times by the wall clock of now or of then."""
        self.anchor_ns = time.time_ns() - round(now_s * 1e9) if anchor_ns is None else anchor_ns
        self._lens = None

    def at_ns(self, at_s: float) -> int:
        """Return a time of the run as nanoseconds since 1970; a time that is none becomes the beginning of time."""
        return max(0, self.anchor_ns + round(at_s * 1e9)) if math.isfinite(at_s) else 0

    def encode(self, record: CycleRecord, frame: Frame | None) -> Iterator[Entry]:
        """Yield the entries of a cycle."""
        now_s = record.observation.now_s
        if frame is not None and self._choice.is_wanted(record, frame):
            yield from self._picture(record, frame)
        yield Entry(CYCLES, messages.CYCLE, now_s, journal.cycle_json(record), self._cycles)
        self._cycles += 1
        measured = {measurement.target: measurement for measurement in record.observation.measurements}
        for track in record.decision.tracks:
            data = messages.target(track, measured.get(track.target))
            yield Entry(TARGETS + track.target, messages.TARGET, now_s, data)
        for event in record.decision.events:
            yield Entry(LOG, messages.LOG, now_s, messages.log(event, self.at_ns(event.at_s)))

    def reload(self, now_s: float, configuration: journal.RecordedConfiguration) -> Entry:
        """Return that another configuration was loaded."""
        return Entry(CONFIGURATION, messages.CONFIGURATION, now_s, journal.reload_json(now_s, configuration))

    def _picture(self, record: CycleRecord, frame: Frame) -> Iterator[Entry]:
        """Yield a picture, and what was found in it. It stands before the cycle that it belongs to."""
        now_s = record.observation.now_s
        jpeg = messages.encode_jpeg(frame.image, self._quality_percent)
        if jpeg is None:
            return
        yield from self._new_lens(frame, now_s)
        yield Entry(IMAGES, messages.COMPRESSED_IMAGE, now_s, jpeg, frame.sequence, frame.captured_at_s)
        if self._lens is not None:
            taken_ns = self.at_ns(frame.captured_at_s)
            found = messages.image_annotations(record, self._lens, self._recorded.sizes, taken_ns)
            yield Entry(ANNOTATIONS, messages.IMAGE_ANNOTATIONS, now_s, found)

    def _new_lens(self, frame: Frame, now_s: float) -> Iterator[Entry]:
        """Yield the camera model at the frame's resolution whenever that is another one."""
        lens, camera = self._lens, self._recorded.camera
        if camera is None:
            return
        if lens is None or (lens.width_px, lens.height_px) != (frame.width_px, frame.height_px):
            self._lens = camera.scaled_to(frame.width_px, frame.height_px)
            message = messages.calibration(self._lens, self.at_ns(now_s))
            yield Entry(CALIBRATION, messages.CAMERA_CALIBRATION, now_s, message)


class RecordingWriter:
    """Writes a recording, in the thread of the caller. `Recorder` does so in a thread of its own.

    Args:
        anchor_ns: The wall-clock time at which the run's clock showed 0, if its beginning is past already.

    Raises:
        JournalError: The file cannot be written, or holds something else than a recording.
        DriverUnavailableError: The library ``mcap`` is not installed.
    """

    kind = "recording"
    takes_pictures = True

    def __init__(
        self, path: Path, recorded: Recorded, options: ImageOptions | None = None, anchor_ns: int | None = None
    ) -> None:
        require_mcap("recording to an MCAP file")
        self._recorded = recorded
        self._entries = EntryEncoder(recorded, options or ImageOptions())
        self._anchor_ns = anchor_ns
        self._file = journal.RecordFile(path, self.kind, journal.begins_as_mcap)
        self._writer: Writer | None = None
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._flushed_s = 0.0
        self._resumed = ""

    def write(self, record: CycleRecord, frame: Frame | None = None) -> None:
        """Add one cycle.

        Args:
            frame: The frame that was new in it; None for none, or to leave its picture out.

        Raises:
            JournalError: The file could not be written, for a full disk for example. What was written before is
                intact, and nothing more can be written.
        """
        now_s = record.observation.now_s
        writer = self._ensure_begun(now_s)
        self.add(self._entries.encode(record, frame))
        if not 0 <= now_s - self._flushed_s < FLUSH_S:
            writer.flush()
            self._flushed_s = now_s

    def add(self, entries: Iterable[Entry]) -> None:
        """Add entries; errors are those of `write`."""
        for entry in entries:
            writer = self._ensure_begun(entry.at_s)
            data = entry.data
            if entry.topic == IMAGES:
                data = messages.compressed_image(data, self._entries.at_ns(entry.taken_s))
            at_ns = self._entries.at_ns(entry.at_s)
            channel = self._channels.get(entry.topic) or self._new_channel(writer, entry.topic, entry.schema)
            writer.add_message(channel, at_ns, data, at_ns, entry.sequence % SEQUENCE_MAX)

    def flush(self) -> None:
        """Have what was added in the file; errors are those of `write`."""
        if self._writer is not None:
            self._writer.flush()

    def note_resumption(self, text: str) -> None:
        """Take in what the run restores from an earlier one. Only before the first cycle."""
        self._resumed = text

    def begin_with(self, configuration: journal.RecordedConfiguration) -> None:
        """Take in that another configuration was loaded before there was anything to record."""
        self._recorded = replace(self._recorded, configuration=configuration)

    def note_reload(self, now_s: float, configuration: journal.RecordedConfiguration) -> None:
        """Add that another configuration was loaded, before the first cycle that it decides."""
        self.add([self._entries.reload(now_s, configuration)])

    @property
    def size_bytes(self) -> int:
        """The size of the file. May be asked from any thread."""
        return self._file.tell()

    def older_file(self) -> str:
        """Return in words where an older recording of that name is now; empty if there was none."""
        return self._file.older_file()

    def close(self) -> None:
        """Finish the file, so that it can be searched by time, and close it. May be called any number of times."""
        writer, self._writer = self._writer, None
        try:
            if writer is not None:
                writer.finish()
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close the file as it is, after a `write` that failed."""
        self._writer = None
        self._file.close()

    def _ensure_begun(self, now_s: float) -> Writer:
        if self._writer is None:
            self._entries.begin(now_s, self._anchor_ns)
            self._flushed_s = now_s
            self._writer = self._begin(self._entries.at_ns(now_s))
        return self._writer

    def _begin(self, began_ns: int) -> Writer:
        from mcap.writer import Writer  # noqa: PLC0415 - only recordings need it

        writer = Writer(self._file)  # type: ignore[arg-type] # it needs no more of a file than ours has
        writer.start(library=f"{journal.LIBRARY} {stadimeter.__version__}")
        configuration = self._recorded.configuration
        began_at = datetime.fromtimestamp(began_ns // 1_000_000 / 1000, UTC).isoformat(timespec="milliseconds")
        about = {
            "format": str(FORMAT),
            "version": stadimeter.__version__,
            "began_at": began_at,
            "configuration_sha256": sha256_of(configuration.text),
            **{CLIP_OF + key: value for key, value in self._recorded.clip_of.items()},
        }
        writer.add_metadata(METADATA, about)
        writer.add_attachment(began_ns, began_ns, journal.FILE_NAME, "application/toml", configuration.text.encode())
        for name, text in configuration.files.items():
            writer.add_attachment(began_ns, began_ns, CAMERA_FILE + name, "application/toml", text.encode())
        if self._resumed:
            writer.add_attachment(began_ns, began_ns, RESUMED_NAME, "application/json", self._resumed.encode())
        return writer

    def _new_channel(self, writer: Writer, topic: str, schema: str) -> int:
        if schema not in self._schemas:
            shape = json.dumps(messages.SCHEMAS[schema]).encode()
            self._schemas[schema] = writer.register_schema(schema, "jsonschema", shape)
        channel: int = writer.register_channel(topic, "json", self._schemas[schema])
        self._channels[topic] = channel
        return channel


class ImageChooser:
    """Chooses which pictures are recorded."""

    def __init__(self, options: ImageOptions) -> None:
        self._options = options
        self._newest_s: float | None = None
        self._statuses: tuple[object, ...] = ()

    def is_wanted(self, record: CycleRecord, frame: Frame) -> bool:
        """Check whether the picture of a cycle is wanted; called once for each frame."""
        if self._options.images == "none":
            return False
        if self._options.images == "events" and not self._has_changed(record):
            return False
        rate_hz, newest_s = self._options.rate_hz, self._newest_s
        # A tenth of the period is left to the camera's jitter, so that asking for its own rate takes every frame.
        if rate_hz and newest_s is not None and 0 <= frame.captured_at_s - newest_s < 0.9 / rate_hz:
            return False
        self._newest_s = frame.captured_at_s
        return True

    def _has_changed(self, record: CycleRecord) -> bool:
        decision = record.decision
        before = self._statuses
        tracks = (track.status for track in decision.tracks)
        self._statuses = (*tracks, *(rule.status for rule in decision.rules))
        return bool(decision.events) or self._statuses != before


def require_mcap(what: str) -> None:
    """Raise `DriverUnavailableError` unless the library ``mcap`` is installed."""
    require("record", what)
