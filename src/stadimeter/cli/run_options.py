"""What a run leaves behind: the options for journals and recordings, and what they do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from stadimeter.app.loop import Loop
from stadimeter.errors import JournalError

if TYPE_CHECKING:
    from stadimeter.app.recordings.recorded_configuration import RecordedConfiguration
    from stadimeter.app.recordings.recorder import Recorder, Writer

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
    typer.Option("--image-rate", min=0.01, metavar="HZ", help="Upper limit of recorded pictures a second."),
]
ImageQuality = Annotated[
    int, typer.Option("--image-quality", min=1, max=100, metavar="PERCENT", help="Of their JPEGs; 95 measures best.")
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Keeping:
    """What is kept of a run. With `is_quiet`, trouble is printed at the end only: the view has shown it."""

    journal: Path | None = None
    record: Path | None = None
    images: Literal["all", "events", "none"] = "all"
    image_rate_hz: float | None = None
    image_quality_percent: int = 90
    is_quiet: bool = False


@contextmanager
def kept(loop: Loop, keeping: Keeping) -> Iterator[None]:
    """Record a run while in the context."""
    if keeping.journal is not None and keeping.record is not None and keeping.journal == keeping.record:
        raise JournalError(f"--journal and --record both name {keeping.journal}; they need a file each")
    with ExitStack() as closing:
        recorders: list[Recorder] = []
        teller = _Teller(recorders, loop.services.tell, is_quiet=keeping.is_quiet)
        closing.callback(teller.at_end)
        for writer in _writers(loop, keeping):
            recorders.append(_recorder(writer, loop))
            closing.callback(recorders[-1].close)
        loop.listeners += [*recorders, teller]
        yield
        for recorder in recorders:  # both at once
            recorder.end()


def _recorder(writer: Writer, loop: Loop) -> Recorder:
    from stadimeter.app.recordings.recorder import Recorder  # noqa: PLC0415 - it takes long, and few runs have one

    return Recorder(writer, is_live=loop.parts.is_live, deadline=loop.deadline)


def _writers(loop: Loop, keeping: Keeping) -> Iterator[Writer]:
    if keeping.journal is None and keeping.record is None:
        return
    from stadimeter.app.recordings.recorded_configuration import to_be_recorded  # noqa: PLC0415 - likewise

    configuration = to_be_recorded(loop.parts.configuration)
    if keeping.journal is not None:
        from stadimeter.app.recordings.journal import JournalWriter  # noqa: PLC0415 - likewise

        yield JournalWriter(keeping.journal, configuration)
    if keeping.record is not None:
        yield _recording_writer(loop, keeping, keeping.record, configuration)


def _recording_writer(loop: Loop, keeping: Keeping, path: Path, configuration: RecordedConfiguration) -> Writer:
    from stadimeter.app.recordings.recording import ImageOptions, Recorded, RecordingWriter  # noqa: PLC0415 - likewise

    recorded = Recorded(
        configuration=configuration,
        camera=loop.parts.configuration.camera_model,
        sizes={name: detector.target_shape for name, detector in loop.parts.cycle.detectors.items()},
    )
    options = ImageOptions(
        images=keeping.images, rate_hz=keeping.image_rate_hz, quality_percent=keeping.image_quality_percent
    )
    return RecordingWriter(path, recorded, options)


class _Teller:
    """Reports what becomes of the files: each thing once, and what is missing in a file again at the end."""

    def __init__(self, recorders: Sequence[Recorder], tell: Callable[[str], None], *, is_quiet: bool) -> None:
        self._recorders = recorders
        self._tell = tell
        self._is_quiet = is_quiet
        self._said: set[str] = set()

    def __call__(self, *_: object) -> None:
        for recorder in self._recorders:
            self._say_kept(recorder)
            if recorder.failure and not self._is_quiet:
                self._say(f"warning: {recorder.failure}; the run goes on without it")

    def at_end(self) -> None:
        """Tell which files are not whole, after the files were closed."""
        for recorder in self._recorders:
            self._say_kept(recorder)
            if recorder.failure:
                self._say(f"warning: the {recorder.kind} is not whole: {recorder.failure}")
            elif recorder.images_left_out:
                count = recorder.images_left_out
                self._say(f"warning: recording: {count} pictures were left out, since the disk did not keep up")

    def _say_kept(self, recorder: Recorder) -> None:
        if recorder.kept():
            self._say(recorder.kept())

    def _say(self, words: str) -> None:
        if words not in self._said:
            self._said.add(words)
            self._tell(words)
