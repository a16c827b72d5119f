"""Replaying journals and recordings: the same rules, or others, over what was observed. No driver is opened."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.detectors import NamedDetector, build_detectors
from stadimeter.app.persistence.resumption import read_state
from stadimeter.app.recordings.journal import (
    MAGIC,
    JournalHeader,
    RecordedConfiguration,
    RecordedCycle,
    load_recorded,
    read_journal,
    readable,
    to_be_recorded,
)
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.decide import State, decide, initial_state
from stadimeter.core.decision import Decision
from stadimeter.core.observation import Observation
from stadimeter.core.persistence import reload
from stadimeter.core.plan import Plan
from stadimeter.errors import ConfigError, DriverError, JournalError, Problem, StateError
from stadimeter.perception.perceiver import Perceiver

if TYPE_CHECKING:
    from stadimeter.workbench.replay.recording_reader import RecordedImage


class AnyRecording(Protocol):
    """A journal, or a recording with pictures."""

    @property
    def path(self) -> Path:
        """The file."""
        ...

    @property
    def header(self) -> JournalHeader:
        """Everything that it says about its run."""
        ...

    def cycles(self) -> Iterator[RecordedCycle]:
        """Yield every cycle, in order, not read yet; raises JournalError where the file is damaged."""
        ...

    def is_cut_off(self) -> bool:
        """Check whether the end is missing."""
        ...


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
    from stadimeter.workbench.replay.recording_reader import read_mcap  # noqa: PLC0415 - it needs OpenCV and an extra

    return read_mcap(path)


Replayed = tuple[RecordedCycle, Observation, Decision]

# Returns the state with which to go on by another configuration, as a run does at a reload.
OnReload = Callable[[State, RecordedConfiguration], State]


@runtime_checkable
class HasPictures(AnyRecording, Protocol):
    """A recording that may hold pictures."""

    def cycles_and_images(self) -> Iterator[tuple[RecordedCycle, RecordedImage | None]]:
        """Yield every cycle with its new picture, if it was recorded; raises JournalError for damage."""
        ...

    def has_images(self) -> bool:
        """Check whether there is a picture at all; raises JournalError if the file is damaged."""
        ...


def _detectors(configuration: Configuration) -> tuple[NamedDetector, ...]:
    try:
        return build_detectors(configuration.targets, configuration.camera_model)
    except (ConfigError, DriverError) as error:
        message = f"a target cannot be measured in recorded pictures: {error}"
        hint = "name a configuration whose detectors look at pictures with --config"
        raise ConfigError([Problem(message, str(configuration.path), hint=hint)]) from error


class Redetection:
    """Measures the targets of a configuration in recorded pictures.

    Raises:
        ConfigError: It has no camera model, or a detector cannot be built, such as one that asks the simulated world
            instead of the picture.
    """

    def __init__(self, configuration: Configuration) -> None:
        if configuration.camera_model is None:
            raise ConfigError([Problem("there is no camera model to measure with", str(configuration.path))])
        named = _detectors(configuration)
        detectors = {member: each.detector for each in named for member in each.members}
        self._perceiver = Perceiver(detectors, configuration.camera_model, configuration.footings)

    def observe(self, cycle: RecordedCycle, image: RecordedImage | None, state: State) -> Observation:
        """Return the observation of a cycle, with what is measured in its picture now.

        Args:
            state: The core's state before the cycle: its tracks say where targets are expected.

        Raises:
            CalibrationError: The picture has another aspect than the camera model.
            JournalError: The picture or the cycle is damaged.
        """
        observation = cycle.observation()
        frame = image.frame_of(cycle) if image is not None else None
        if frame is None:
            reason = observation.camera_fault or ("its picture is not recorded" if observation.frame else "")
            return replace(observation, frame=None, measurements=(), camera_fault=reason)
        tracks = {tracked.track.target: tracked.track for tracked in state.tracks}
        _, measurements = self._perceiver.look(frame, tracks)
        return replace(observation, measurements=measurements)


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
    observe: Callable[[RecordedCycle, RecordedImage | None, State], Observation],
    on_reload: OnReload | None,
) -> Iterator[Replayed]:
    for cycle, image in cycles:
        if cycle.reloaded is not None and on_reload is not None:
            state = on_reload(state, cycle.reloaded)
        observation = observe(cycle, image, state)
        state, decision = decide(state, observation)
        yield cycle, observation, decision


def journal_record(cycle: Replayed) -> CycleRecord:
    """Return a cycle of a replay for a journal: nothing was applied, and nothing is timed, so it is always the same."""
    _, observation, decision = cycle
    return CycleRecord(observation=observation, decision=decision, applied=(), timings_s={})


class ReplayRun(Struct, frozen=True):
    """Decides over a recording by one configuration. It may be gone through any number of times, always the same.

    Attributes:
        is_recorded: Whether that is the recording's own: then recorded reloads are followed.
    """

    recording: AnyRecording
    configuration: Configuration
    is_recorded: bool = False
    from_images: bool = False

    @property
    def to_be_recorded(self) -> RecordedConfiguration:
        """The configuration as a journal of this replay holds it."""
        if self.is_recorded:
            return self.recording.header.recorded_configuration
        return to_be_recorded(self.configuration)

    def __iter__(self) -> Iterator[Replayed]:
        """Return each cycle, what is observed in it, and what is decided now.

        Raises:
            JournalError: The recording is damaged, or has no pictures to measure in.
            StadimeterError: The configuration cannot measure in its pictures.
        """
        on_reload = self._reload if self.is_recorded else None
        if not self.from_images:
            return decisions(self.recording, self.configuration.plan, on_reload)
        if not isinstance(self.recording, HasPictures):
            how = "record one with `stadimeter run CONFIG --record FILE.mcap`"
            raise JournalError(f"{self.recording.path} is a journal, and has no pictures to measure in; {how}")
        if not self.recording.has_images():
            how = "it was made with `--record-images none`, or ends before the first"
            raise JournalError(f"{self.recording.path} has no pictures to measure in: {how}")
        state = first_state(self.recording, self.configuration.plan)
        return _decide(state, self.recording.cycles_and_images(), Redetection(self.configuration).observe, on_reload)

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
