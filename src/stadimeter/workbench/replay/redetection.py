"""Measuring again, in the pictures of a recording, with other settings. No camera is opened, and no output is built."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from stadimeter.app.detectors import NamedDetector, build_detectors
from stadimeter.config.loader import Configuration
from stadimeter.core.decide import State, decide
from stadimeter.core.frame import Frame
from stadimeter.core.observation import Observation
from stadimeter.errors import ConfigError, DriverError, Problem
from stadimeter.perception.perceiver import Perceiver
from stadimeter.workbench.replay.recording_reader import McapRecording, decoded_frame
from stadimeter.workbench.replay.replay import OnReload, Replayed, first_state


def _detectors(configuration: Configuration) -> tuple[NamedDetector, ...]:
    try:
        return build_detectors(configuration.targets, configuration.camera_model)
    except (ConfigError, DriverError) as error:
        message = f"a target cannot be measured in recorded pictures: {error}"
        hint = "name a configuration whose detectors look at pictures with --config"
        raise ConfigError([Problem(message, str(configuration.path), hint=hint)]) from error


class Redetection:
    """Measures the targets of a configuration in recorded pictures.

    Args:
        configuration: The configuration: its targets, its camera model.

    Raises:
        ConfigError: It has no camera model, or a detector cannot be built, such as one that asks the simulated world
            instead of the picture.
    """

    def __init__(self, configuration: Configuration) -> None:
        if configuration.camera_model is None:
            raise ConfigError([Problem("there is no camera model to measure with", str(configuration.path))])
        named = _detectors(configuration)
        self._looking = Perceiver({each.name: each.detector for each in named}, configuration.camera_model)

    def observe(self, observation: Observation, frame: Frame | None, state: State) -> Observation:
        """Return what would have been observed.

        Args:
            observation: What was observed when it was recorded.
            frame: The recorded frame; None for none: then there was none.
            state: What the core remembers, for where targets are expected.

        Returns:
            The same, with what is measured in the frame now.

        Raises:
            CalibrationError: The picture has another aspect than the camera model.
        """
        if frame is None:
            reason = observation.camera_fault or ("its picture is not recorded" if observation.frame else "")
            return replace(observation, frame=None, measurements=(), camera_fault=reason)
        tracks = {tracked.track.target: tracked.track for tracked in state.tracks}
        _, measurements = self._looking.look(frame, tracks)
        return replace(observation, measurements=measurements)


def redetected(
    recording: McapRecording, configuration: Configuration, on_reload: OnReload | None = None
) -> Iterator[Replayed]:
    """Measure again in the pictures of a recording, and decide on that.

    Args:
        configuration: The targets, the camera model and the rules.
        take_over: What to do where another configuration was taken over; None to go on with these rules.

    Yields:
        Each cycle, what is observed in it now, and what is decided.

    Raises:
        CalibrationError: The pictures have another aspect than the camera model.
        ConfigError: There is no camera model, or a detector cannot be built.
        JournalError: The recording is damaged.
    """
    redetection = Redetection(configuration)
    state = first_state(recording, configuration.plan)
    for cycle, image in recording.cycles_and_images():
        if cycle.reloaded is not None and on_reload is not None:
            state = on_reload(state, cycle.reloaded)
        frame = decoded_frame(image, cycle) if image is not None else None
        observation = redetection.observe(cycle.observation(), frame, state)
        state, decision = decide(state, observation)
        yield cycle, observation, decision
