"""From a frame and the tracks to measurements: the lens scaled, each target looked for where it is expected, measured.

Around a prediction a detector looks at a small part of the picture only, which takes a fraction of the time. Its answer
there is final, so something that was once mistaken for the target could hold its place for ever, while the target is in
plain sight elsewhere. So from time to time the whole frame is searched, as if nothing was known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Points, Prediction
from stadimeter.core.floor import Footing
from stadimeter.core.frame import Frame, Optics
from stadimeter.core.measurement import Measurement
from stadimeter.core.target import TargetShape
from stadimeter.core.track import Track
from stadimeter.detectors.protocol import Detector, TracksSeveral
from stadimeter.perception.motion_blur import MotionBlur
from stadimeter.perception.prediction import Expectations
from stadimeter.perception.several import Several
from stadimeter.ranging.floor import stand
from stadimeter.ranging.measure import measure, unmeasured
from stadimeter.ranging.separation import SeenTarget

if TYPE_CHECKING:  # most runs have one camera
    from stadimeter.perception.second_camera import SecondView


class Perceiver:
    """Looks for the targets of one run, by name, and measures them. Names with one detector are of one kind.

    The lens, at any resolution of the frames' aspect, is scaled here, once for each resolution, and passed on:
    detectors and ranging must see the very same one.
    """

    def __init__(
        self,
        detectors: Mapping[str, Detector],
        camera_model: CameraModel,
        footings: Mapping[str, Footing] | None = None,
        second: SecondView | None = None,
    ) -> None:
        self.detectors = detectors
        self._footings = footings or {}
        self._second = second
        self._larger: dict[str, float] = {}  # of targets of unknown size, how much larger than assumed they are
        self._camera_model = camera_model
        self._lens = camera_model
        self._optics: Optics | None = None
        self._sightings: dict[str, LastOutline] = {}
        self._kinds = _kinds_of(detectors)
        self.expectations = Expectations()
        self.motion_blur = MotionBlur()

    def look(
        self, frame: Frame, tracks: Mapping[str, Track] | None = None, second: Frame | None = None
    ) -> tuple[tuple[Detection, ...], tuple[Measurement, ...]]:
        """Look for every target, with what tracks tell; return a detection and a measurement for each.

        Args:
            second: Of a run with a second camera, its frame that is nearest in time; None for none.

        Raises:
            CalibrationError: The frame has another aspect than the camera model, or the camera was set otherwise.
        """
        lens, at_s = self.lens_of(frame), frame.captured_at_s
        detections, measurements = [], []
        members: dict[str, Detection] = {}
        for kind in self._kinds:
            members |= kind.look(frame, lens, tracks or {})
        for name, detector in self.detectors.items():
            shape = detector.target_shape
            found = members.get(name)
            if found is None:
                expected = self.expectations.of(tracks.get(name), shape, lens, at_s) if tracks else None
                if expected is not None:
                    larger = expected.size_px * self._larger.get(name, 1.0)
                    expected = add_outline(replace(expected, size_px=larger), self._sightings.get(name), shape, lens)
                found = detector.detect(frame, expected, lens=lens)
            measured = self._measure(found, shape, frame, (tracks or {}).get(name), second)
            if shape.has_corners and measured.depth_m is not None:
                self._sightings[name] = LastOutline(found.outline_px, found.centre_px, measured.depth_m)
            self.motion_blur.add(frame, found, measured, lens.fx_px)
            detections.append(found)
            measurements.append(measured)
        return tuple(detections), tuple(measurements)

    def _measure(
        self, found: Detection, shape: TargetShape, frame: Frame, track: Track | None, second: Frame | None
    ) -> Measurement:
        """Measure a target by its size, and by a second camera or the floor."""
        lens = self._lens
        by_size = measured = measure(found, shape, lens, frame.captured_at_s)
        if self._second is not None:
            seen = SeenTarget(detection=found, measurement=by_size, shape=shape)
            measured = self._second.join(seen, track, frame, second)
        is_joined = measured.distance_m != by_size.distance_m
        if found.target in self._footings and not is_joined:
            measured = stand(measured, found, shape, lens, self._footings[found.target]).measurement
        return self._without_size(measured, by_size) if math.isinf(shape.relative_sigma) else measured

    def _without_size(self, measured: Measurement, by_size: Measurement) -> Measurement:
        """Return what was measured without the size, and learn that; or that nothing was."""
        if measured.distance_m is None or not math.isfinite(measured.sigma_m or math.inf):
            return measured if measured.distance_m is None else unmeasured(measured)
        self._larger[measured.target] = measured.distance_m / (by_size.distance_m or math.inf)
        return measured

    def lens_of(self, frame: Frame) -> CameraModel:
        """Return the camera model for the frame, whose resolution, subsampling and optics hardly ever change."""
        lens = self._lens
        # Scaling a lens takes longer than this comparison, and detector and ranging must get the same object.
        is_same = (lens.width_px, lens.height_px) == (frame.width_px, frame.height_px) and frame.optics is self._optics
        if not is_same or lens.subsampling != (self._camera_model.subsampling or frame.subsampling):
            lens = self._lens = self._camera_model.for_frame(frame)
            self._optics = frame.optics
        return lens


def _kinds_of(detectors: Mapping[str, Detector]) -> tuple[Several, ...]:
    """Return what looks for each kind of which there are several: the names with one and the same detector."""
    names: dict[int, list[str]] = {}
    for name, detector in detectors.items():
        names.setdefault(id(detector), []).append(name)
    several = ((detectors[members[0]], members) for members in names.values())
    return tuple(
        Several(members, detector)
        for detector, members in several
        if isinstance(detector, TracksSeveral) and (len(members) > 1 or detector.numbers)
    )


class LastOutline(NamedTuple):
    """The corners and the centre of a target when it was last seen, in pixels, and its depth then."""

    outline_px: Points
    centre_px: tuple[float, float]
    depth_m: float


def add_outline(
    expected: Prediction, sighting: LastOutline | None, shape: TargetShape, camera: CameraModel
) -> Prediction:
    """Return a prediction with the corners that were last seen, moved and scaled to where and how large it is."""
    if sighting is None:
        return expected
    # Apparent length then, in pixels by similar triangles; the ratio of both lengths scales the corners about the
    # centre, which is moved.
    then_px = shape.longest_m / sighting.depth_m * math.sqrt(camera.fx_px * camera.fy_px)
    around = sighting.outline_px - np.array(sighting.centre_px)
    outline_px = around * (expected.size_px / then_px) + np.array(expected.centre_px)
    return replace(expected, outline_px=outline_px)
