"""The files that a run leaves behind: its journal and its recording, and what is said of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from stadimeter.app.loop import Loop
from stadimeter.app.recordings.journal import JournalWriter, RecordedConfiguration, to_be_recorded
from stadimeter.app.recordings.recorder import Recorder, Writer
from stadimeter.cli.run_services import RunOptions
from stadimeter.config.extras import require
from stadimeter.errors import JournalError


@contextmanager
def recording(loop: Loop, options: RunOptions, *, is_quiet: bool) -> Iterator[None]:
    """Record a run while in the context."""
    if options.journal is not None and options.record is not None and options.journal == options.record:
        raise JournalError(f"--journal and --record both name {options.journal}; they need a file each")
    with ExitStack() as closing:
        recorders: list[Recorder] = []
        teller = _RecordingTroubles(recorders, loop.services.tell, is_quiet=is_quiet)
        closing.callback(teller.at_end)
        for writer in _writers(loop, options):
            recorders.append(_recorder(writer, loop))
            closing.callback(recorders[-1].close)
        loop.listeners += [*recorders, teller]
        yield
        for recorder in recorders:  # both at once
            recorder.end()


def _recorder(writer: Writer, loop: Loop) -> Recorder:
    return Recorder(writer, is_live=loop.parts.is_live, deadline=loop.deadline)


def _writers(loop: Loop, options: RunOptions) -> Iterator[Writer]:
    if options.record is not None:
        require("record", "recording to an MCAP file")  # before a journal is begun that would stay empty
    configuration = to_be_recorded(loop.parts.configuration)
    if options.journal is not None:
        yield JournalWriter(options.journal, configuration)
    if options.record is not None:
        yield _recording_writer(loop, options, options.record, configuration)


def _recording_writer(loop: Loop, options: RunOptions, path: Path, configuration: RecordedConfiguration) -> Writer:
    # Loads MCAP and picture writing, which a run with only a journal does not need.
    from stadimeter.app.recordings.recording import ImageOptions, RecordingWriter, what_is_recorded  # noqa: PLC0415

    recorded = what_is_recorded(loop.parts.configuration, loop.parts.cycle.detectors, configuration)
    images = ImageOptions(
        images=options.images, rate_hz=options.image_rate_hz, quality_percent=options.image_quality_percent
    )
    return RecordingWriter(path, recorded, images)


class _RecordingTroubles:
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
        if recorder.older_file():
            self._say(recorder.older_file())

    def _say(self, words: str) -> None:
        if words not in self._said:
            self._said.add(words)
            self._tell(words)
