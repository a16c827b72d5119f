"""From a frame and the tracks to measurements: the lens scaled, each target looked for where it is expected, measured.

Around a prediction a detector looks at a small part of the picture only, which takes a fraction of the time. Its answer
there is final, so something that was once mistaken for the target could hold its place for ever, while the target is in
plain sight elsewhere. So from time to time the whole frame is searched, as if nothing was known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Prediction
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Measurement
from stadimeter.core.target import TargetShape
from stadimeter.core.track import Track
from stadimeter.detectors.protocol import Detector
from stadimeter.perception.prediction import Motion, follow, predict
from stadimeter.ranging.measure import measure

SEARCH_EVERY_S = 1.0
"""Each target is looked for in the whole frame this often, in time of capture."""


class Perceiver:
    """Looks for the targets of one run, by name, and measures them.

    The lens, at any resolution of the frames' aspect, is scaled here, once for each resolution, and passed on:
    detectors and ranging must see the very same one.
    """

    def __init__(self, detectors: Mapping[str, Detector], camera_model: CameraModel) -> None:
        self.detectors = detectors
        self._camera_model = camera_model
        self._lens = camera_model
        self.expectations = Expectations()

    def look(
        self, frame: Frame, tracks: Mapping[str, Track] | None = None
    ) -> tuple[tuple[Detection, ...], tuple[Measurement, ...]]:
        """Look for every target, with what tracks tell; return a detection and a measurement for each.

        Raises:
            CalibrationError: The frame has another aspect than the camera model.
        """
        lens, at_s = self._lens_of(frame), frame.captured_at_s
        detections, measurements = [], []
        for name, detector in self.detectors.items():
            shape = detector.target_shape
            expected = self.expectations.of(tracks.get(name), shape, lens, at_s) if tracks else None
            found = detector.detect(frame, expected, lens=lens)
            detections.append(found)
            measurements.append(measure(found, shape, lens, at_s))
        return tuple(detections), tuple(measurements)

    def _lens_of(self, frame: Frame) -> CameraModel:
        """Return the camera model at the frame's resolution, which hardly ever changes."""
        lens = self._lens
        if (lens.width_px, lens.height_px) != (frame.width_px, frame.height_px):
            lens = self._lens = self._camera_model.scaled_to(frame.width_px, frame.height_px)
        return lens


class Expectations:
    """Decides in which frames each target is looked for where it is expected. One for each run."""

    def __init__(self) -> None:
        self._searched_at_s: dict[str, float] = {}
        self._motions: dict[str, Motion | None] = {}

    def of(self, track: Track | None, shape: TargetShape, camera: CameraModel, at_s: float) -> Prediction | None:
        """Return where a target is expected in a frame; None to search all of it. Asked once for a target and frame."""
        if track is None:
            return None
        motion = self._motions[track.target] = follow(self._motions.get(track.target), track)
        since_s = at_s - self._searched_at_s.get(track.target, -math.inf)
        expected = predict(track, shape, camera, at_s, motion) if 0 <= since_s < SEARCH_EVERY_S else None
        if expected is None:
            self._searched_at_s[track.target] = at_s
        return expected
