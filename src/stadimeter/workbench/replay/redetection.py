"""Measuring again, in the pictures of a recording, with other settings. No camera is opened, and no output is built."""

from __future__ import annotations

from dataclasses import replace

from stadimeter.app.detectors import NamedDetector, build_detectors
from stadimeter.app.recordings.cycle_json import RecordedCycle
from stadimeter.config.loader import Configuration
from stadimeter.core.decide import State
from stadimeter.core.observation import Observation
from stadimeter.errors import ConfigError, DriverError, Problem
from stadimeter.perception.perceiver import Perceiver
from stadimeter.workbench.replay.recording_reader import RecordedImage, decoded_frame


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
        self._perceiver = Perceiver({each.name: each.detector for each in named}, configuration.camera_model)

    def observe(self, cycle: RecordedCycle, image: RecordedImage | None, state: State) -> Observation:
        """Return what was observed in a cycle, with what is measured in its picture now.

        Args:
            state: The core's state before the cycle: its tracks say where targets are expected.

        Raises:
            CalibrationError: The picture has another aspect than the camera model.
            JournalError: The picture or the cycle is damaged.
        """
        observation = cycle.observation()
        frame = decoded_frame(image, cycle) if image is not None else None
        if frame is None:
            reason = observation.camera_fault or ("its picture is not recorded" if observation.frame else "")
            return replace(observation, frame=None, measurements=(), camera_fault=reason)
        tracks = {tracked.track.target: tracked.track for tracked in state.tracks}
        _, measurements = self._perceiver.look(frame, tracks)
        return replace(observation, measurements=measurements)
