"""Synthetic measurements: the true path of a target with the noise that camera and target are expected to have.

The noise is normally distributed and correlated from one frame to the next as the tracker expects it. Directions are
exact, since their uncertainty is not known. Everything random follows
from a seed, and each frame takes the same number of random numbers, so that one thing changed changes nothing else.
"""

from __future__ import annotations

import math
import random
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any

from stadimeter.app.clock import SteppedClock
from stadimeter.config.loader import Configuration
from stadimeter.config.plugins import DriverChoice, DriverContext, Shared
from stadimeter.config.rule_test_tables import PathPoint, SpanTable
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.core.target import TargetShape
from stadimeter.detectors.protocol import Detector
from stadimeter.errors import ConfigError, Problem, StadimeterError
from stadimeter.ranging.feasibility import expect

# Nothing smaller is found, however good the picture.
MIN_SIZE_PX = 3.0


class SensorModel:
    """A camera that looks at a target of known size."""

    def __init__(self, size: TargetShape, camera: CameraModel) -> None:
        self._size = size
        self._exact = replace(camera, focal_relative_sigma=0.0, uncertainty=None)
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
        return expect(self._size, self._exact, distance_m).size_px >= MIN_SIZE_PX


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
            _build(configuration.world, camera, shared)
        return {choice.name: _model(configuration, choice, camera, shared) for choice in configuration.targets}
    finally:
        for close in reversed(shared.closers):
            close()


def _model(configuration: Configuration, choice: DriverChoice, camera: CameraModel, shared: Shared) -> SensorModel:
    try:
        detector: Detector = _build(choice, camera, shared)
    except StadimeterError as error:
        message = f"how large the target is cannot be known: {error}"
        raise ConfigError([_problem(configuration, f"targets.{choice.name}", message)]) from error
    return SensorModel(size=detector.target_shape, camera=camera)


def _build(choice: DriverChoice, camera: CameraModel, shared: Shared) -> Any:
    context = DriverContext(name=choice.name, clock=SteppedClock(), camera_model=camera, shared=shared)
    return choice.options.build(context)


def _problem(configuration: Configuration, key: str, message: str) -> Problem:
    return Problem(message, str(configuration.path), key=key)


# A gross error makes a distance up to this many times as large, or as small.
OUTLIER_FACTOR = 3.0

# A noisy distance below this share of the true one counts as missed: its small stated sigma would mislead.
DROWNED_SHARE = 0.2

_NORMAL = NormalDist()


def position_at(path: Sequence[PathPoint], at_s: float) -> PathPoint:
    """Return the true position of a target.

    Args:
        path: Where it is at certain times, in order; it stays at the last point.
        at_s: Seconds from the start of the test.
    """
    index = bisect_right(path, at_s, key=lambda point: point.at_s)
    if index == len(path):
        return path[-1]
    before, after = path[max(0, index - 1)], path[index]
    span_s = after.at_s - before.at_s
    share = (at_s - before.at_s) / span_s if span_s > 0 else 0.0
    return PathPoint(
        at_s=at_s,
        distance_m=_between(before.distance_m, after.distance_m, share),
        bearing_rad=_between(before.bearing_rad, after.bearing_rad, share),
        elevation_rad=_between(before.elevation_rad, after.elevation_rad, share),
    )


def _between(start: float, end: float, share: float) -> float:
    return start + (end - start) * share


@dataclass(frozen=True, slots=True, kw_only=True)
class Nuisances:
    """What goes wrong with measurements.

    Attributes:
        noise: How large the noise is, as a factor of what is expected.
        correlation: Of the noise, from one frame to the next.
        dropouts: The share of frames in which the target is not found.
        outliers: The share of frames in which the distance is grossly wrong.
    """

    noise: float = 1.0
    correlation: float = 0.0
    dropouts: float = 0.0
    outliers: float = 0.0
    lost: Sequence[SpanTable] = ()


class SyntheticTrack:
    """Measures one target that is not there, a frame at a time.

    Args:
        path: Where it truly is when; empty for a target that is never in sight.
        seed: Everything random follows from it and the target's name.
    """

    def __init__(
        self, target: str, path: Sequence[PathPoint], sensor: SensorModel, nuisances: Nuisances, seed: int
    ) -> None:
        self._target = target
        self._path = path
        self._sensor = sensor
        self._nuisances = nuisances
        self._random = random.Random(f"{seed}:{target}")  # noqa: S311 - noise, not a secret
        self._deviation = self._normal()

    def measure(self, at_s: float) -> Measurement:
        """Measure it in the next frame.

        Args:
            at_s: When the frame was taken, in seconds from the start of the test; later than the frame before.
        """
        deviation = self._next_deviation()
        is_dropped = self._random.random() < self._nuisances.dropouts
        is_outlier = self._random.random() < self._nuisances.outliers
        error = self._random.random()
        if not self._path or any(span.holds(at_s) for span in self._nuisances.lost):
            return self._missed(at_s, "out of sight")
        if is_dropped:
            return self._missed(at_s, "not found in this frame")
        true = position_at(self._path, at_s)
        if not self._sensor.is_found(true.distance_m):
            return self._missed(at_s, "too small in the picture")
        _, noise_m = self._sensor.sigmas_m(true.distance_m)
        distance_m = true.distance_m + self._nuisances.noise * noise_m * deviation
        if is_outlier:
            distance_m = true.distance_m * OUTLIER_FACTOR ** (2 * error - 1)
        elif distance_m < true.distance_m * DROWNED_SHARE:
            return self._missed(at_s, "lost in the noise")
        return self._measured(at_s, distance_m, true)

    def _next_deviation(self) -> float:
        """Return the noise of this frame in standard deviations: what is left of the last one's, and news."""
        kept = self._nuisances.correlation
        self._deviation = kept * self._deviation + math.sqrt(1 - kept * kept) * self._normal()
        return self._deviation

    def _normal(self) -> float:
        # The open interval: neither of its ends is a probability that has a number of standard deviations.
        return _NORMAL.inv_cdf((self._random.getrandbits(52) + 0.5) / 2**52)

    def _missed(self, at_s: float, reason: str) -> Measurement:
        return Measurement(target=self._target, status=MeasurementStatus.NOT_FOUND, captured_at_s=at_s, reason=reason)

    def _measured(self, at_s: float, distance_m: float, true: PathPoint) -> Measurement:
        sigma_m, noise_m = self._sensor.sigmas_m(distance_m)
        return Measurement(
            target=self._target,
            status=MeasurementStatus.MEASURED,
            captured_at_s=at_s,
            distance_m=distance_m,
            depth_m=distance_m * math.cos(true.bearing_rad) * math.cos(true.elevation_rad),
            sigma_m=sigma_m,
            noise_m=noise_m,
            bearing_rad=true.bearing_rad,
            elevation_rad=true.elevation_rad,
        )
