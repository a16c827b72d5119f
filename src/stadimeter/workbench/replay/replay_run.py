"""One replay: a recording, a configuration, and whether to measure again in the pictures."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from stadimeter.app.recordings.recorded_configuration import RecordedConfiguration, load_recorded, to_be_recorded
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.decide import State
from stadimeter.core.reload import carried_over
from stadimeter.errors import JournalError
from stadimeter.workbench.replay.opening import Recording
from stadimeter.workbench.replay.replay import Replayed, decisions


@dataclass(frozen=True, slots=True)
class ReplayRun:
    """Decides over a recording by one configuration. It may be gone through any number of times, always the same.

    Attributes:
        recording: The recording.
        configuration: The configuration that it begins with.
        is_recorded: Whether that is the recording's: then it follows what was taken over while the recording ran.
        from_images: Whether to measure again in the recorded pictures.
    """

    recording: Recording
    configuration: Configuration
    is_recorded: bool = False
    from_images: bool = False

    @property
    def to_be_recorded(self) -> RecordedConfiguration:
        """What a journal of this replay keeps of the configuration."""
        if self.is_recorded:
            return self.recording.header.recorded_configuration
        return to_be_recorded(self.configuration)

    def __iter__(self) -> Iterator[Replayed]:
        """Return each cycle, what is observed in it, and what is decided now.

        Raises:
            JournalError: The recording is damaged, or has no pictures to measure in.
            StadimeterError: The configuration cannot measure in its pictures.
        """
        take_over = self._taken_over if self.is_recorded else None
        if not self.from_images:
            return decisions(self.recording, self.configuration.plan, take_over)
        from stadimeter.workbench.replay.recording_reader import McapRecording  # noqa: PLC0415 - it needs OpenCV
        from stadimeter.workbench.replay.redetection import redetected  # noqa: PLC0415 - likewise

        if not isinstance(self.recording, McapRecording):
            how = "record one with `stadimeter run CONFIG --record FILE.mcap`"
            raise JournalError(f"{self.recording.path} is a journal, and has no pictures to measure in; {how}")
        if not self.recording.has_images():
            how = "it was made with `--record-images none`, or ends before the first"
            raise JournalError(f"{self.recording.path} has no pictures to measure in: {how}")
        return redetected(self.recording, self.configuration, take_over)

    def _taken_over(self, state: State, recorded: RecordedConfiguration) -> State:
        return carried_over(state, load_recorded(recorded, self.recording.path).plan).state


@contextmanager
def uncollected() -> Iterator[None]:
    """Look for no cycles of references meanwhile: a replay leaves none, and looking takes a twentieth of its time.

    Yields:
        Nothing.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def replay_run(recording: Recording, config: Path | None, *, from_images: bool = False) -> ReplayRun:
    """Prepare a replay.

    Args:
        recording: The recording.
        config: The configuration; None for that of the recording.
        from_images: Whether to measure again in the recorded pictures.

    Returns:
        The replay.

    Raises:
        ConfigError: The configuration cannot be used.
    """
    if config is not None:
        return ReplayRun(recording, load_configuration(config), is_recorded=False, from_images=from_images)
    loaded = load_recorded(recording.header.recorded_configuration, recording.path)
    return ReplayRun(recording, loaded, is_recorded=True, from_images=from_images)
