"""How sure a camera and a target are expected to be of a distance, without opening either."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from stadimeter.app.clock import SteppedClock
from stadimeter.config.driver_choice import DriverChoice
from stadimeter.config.loader import Configuration
from stadimeter.config.plugins import DriverContext, Shared
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.target import TargetSize
from stadimeter.detectors.protocol import Detector
from stadimeter.errors import ConfigError, Problem, StadimeterError
from stadimeter.ranging.feasibility import expect

SMALLEST_PX = 3.0
"""Nothing smaller is found, however good the picture."""


class SensorModel:
    """A camera that looks at a target of known size."""

    def __init__(self, size: TargetSize, camera: CameraModel) -> None:
        self._size = size
        self._exact = replace(camera, focal_relative_sigma=0.0)
        self._stays = math.hypot(camera.focal_relative_sigma, size.relative_sigma)

    def sigmas_m(self, distance_m: float) -> tuple[float, float]:
        """Return how sure a distance is, as `stadimeter.ranging.feasibility` expects it.

        Returns:
            The whole standard deviation in metres, and the part of it that differs from frame to frame.
        """
        noise_m = expect(self._size, self._exact, distance_m).sigma_m
        return math.hypot(noise_m, self._stays * distance_m), noise_m

    def is_found(self, distance_m: float) -> bool:
        """Return whether the target appears large enough at a distance for any detector to find it."""
        return expect(self._size, self._exact, distance_m).size_px >= SMALLEST_PX


def sensor_models(configuration: Configuration) -> Mapping[str, SensorModel]:
    """Return the sensor model of each target. Nothing is opened.

    Raises:
        ConfigError: There is no camera model, or a detector cannot be built.
    """
    camera = configuration.camera_model
    if camera is None:
        raise ConfigError([_problem(configuration, "camera.model", "there is no camera model, so nothing has a noise")])
    shared = Shared()
    try:
        if configuration.world is not None:
            _built(configuration.world, camera, shared)
        return {choice.name: _model(configuration, choice, camera, shared) for choice in configuration.targets}
    finally:
        for close in reversed(shared.closers):
            close()


def _model(configuration: Configuration, choice: DriverChoice, camera: CameraModel, shared: Shared) -> SensorModel:
    try:
        detector: Detector = _built(choice, camera, shared)
    except StadimeterError as error:
        message = f"how large the target is cannot be known: {error}"
        raise ConfigError([_problem(configuration, f"targets.{choice.name}", message)]) from error
    return SensorModel(size=detector.target_size, camera=camera)


def _built(choice: DriverChoice, camera: CameraModel, shared: Shared) -> Any:
    context = DriverContext(name=choice.name, clock=SteppedClock(), camera_model=camera, shared=shared)
    return choice.plugin.build(choice.options, context)


def _problem(configuration: Configuration, key: str, message: str) -> Problem:
    return Problem(message, str(configuration.path), key=key)
