"""What a run leaves behind: the options for journals and recordings, and what they do."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from stadimeter.app.loop import Loop
from stadimeter.errors import JournalError

if TYPE_CHECKING:
    from stadimeter.app.recordings.recorder import Recorder

JournalFile = Annotated[
    Path | None, typer.Option("--journal", metavar="FILE", help="Record every cycle, for `stadimeter replay`.")
]
RecordFile = Annotated[
    Path | None,
    typer.Option(
        "--record", metavar="FILE.mcap", help="Record every cycle with its picture, for `replay` and for Foxglove."
    ),
]
RecordImages = Annotated[
    Literal["all", "events", "none"],
    typer.Option("--record-images", help="Which pictures --record takes: those of `events` show what changed."),
]
ImageRate = Annotated[
    float | None,
    typer.Option("--image-rate", min=0.01, metavar="HZ", help="Record at most so many pictures a second."),
]
ImageQuality = Annotated[
    int, typer.Option("--image-quality", min=1, max=100, metavar="PERCENT", help="Of their JPEGs; 95 measures best.")
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Keeping:
    """What is kept of a run.

    Attributes:
        journal: The journal to write; None for none.
        record: The recording to write; None for none.
        images: Which pictures the recording holds.
        image_rate_hz: How many of them in a second; None for no limit.
        image_quality_percent: The quality of their JPEGs.
        is_quiet: Whether to say what goes wrong at the end only, since something else has the screen.
    """

    journal: Path | None = None
    record: Path | None = None
    images: Literal["all", "events", "none"] = "all"
    image_rate_hz: float | None = None
    image_quality_percent: int = 90
    is_quiet: bool = False


@contextmanager
def kept(loop: Loop, keeping: Keeping) -> Iterator[None]:
    """Record a run.

    Args:
        loop: The run.
        keeping: What is kept of it.

    Yields:
        Nothing; the files are closed with the context.

    Raises:
        JournalError: A file cannot be written.
        DriverUnavailableError: A library for recordings is not installed.
    """
    if keeping.journal is not None and keeping.record is not None and keeping.journal == keeping.record:
        raise JournalError(f"--journal and --record both name {keeping.journal}; they need a file each")
    with _journal(loop, keeping), _recording(loop, keeping):
        yield


@contextmanager
def _journal(loop: Loop, keeping: Keeping) -> Iterator[None]:
    if keeping.journal is None:
        yield
        return
    from stadimeter.app.recordings.journal import JournalWriter  # noqa: PLC0415 - it takes long, and few runs have one
    from stadimeter.app.recordings.recorded_configuration import to_be_recorded  # noqa: PLC0415 - likewise

    loop.journal = JournalWriter(keeping.journal, to_be_recorded(loop.parts.configuration))
    try:
        yield
    finally:
        loop.journal.close()


@contextmanager
def _recording(loop: Loop, keeping: Keeping) -> Iterator[None]:
    if keeping.record is None:
        yield
        return
    from stadimeter.app.recordings.recorded_configuration import to_be_recorded  # noqa: PLC0415 - it takes long, and few need it
    from stadimeter.app.recordings.recorder import END_WAIT_S, Recorder  # noqa: PLC0415 - likewise
    from stadimeter.app.recordings.recording import ImageOptions, Recorded, RecordingWriter  # noqa: PLC0415 - likewise

    parts = loop.parts
    recorded = Recorded(
        configuration=to_be_recorded(parts.configuration),
        camera=parts.configuration.camera_model,
        sizes={name: detector.target_size for name, detector in parts.cycle.detectors.items()},
    )
    options = ImageOptions(
        images=keeping.images, rate_hz=keeping.image_rate_hz, quality_percent=keeping.image_quality_percent
    )
    recorder = Recorder(RecordingWriter(keeping.record, recorded, options), is_live=parts.is_live)
    tell = _FailureTeller(recorder)
    loop.listeners += [recorder] if keeping.is_quiet else [recorder, tell]
    try:
        yield
    finally:
        recorder.close(loop.deadline.left_s(END_WAIT_S))
        tell()
        if recorder.images_left_out and not recorder.failure:
            typer.echo(f"warning: {recorder.trouble()}", err=True)


class _FailureTeller:
    """Tells at once, and once, that a recording has ended before the run."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self._has_said = False

    def __call__(self, *_: object) -> None:
        failure = self._recorder.failure
        if failure and not self._has_said:
            self._has_said = True
            typer.echo(f"warning: {failure}; the run goes on without it", err=True)
