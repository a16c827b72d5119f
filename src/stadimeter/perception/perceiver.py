"""Looking for every target in a frame, first where its track says that it will be, and measuring it."""

from __future__ import annotations

from collections.abc import Mapping

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Measurement
from stadimeter.core.track import Track
from stadimeter.detectors.protocol import Detector
from stadimeter.perception.predictions import Expectations
from stadimeter.ranging.measure import measure


class Looking:
    """Looks for the targets of one run.

    Args:
        detectors: One for each target, by the target's name.
        camera_model: The lens, at any resolution of the frames' aspect.

    Attributes:
        detectors: The detectors.
        expectations: Says where each target is expected.
    """

    def __init__(self, detectors: Mapping[str, Detector], camera_model: CameraModel) -> None:
        self.detectors = detectors
        self._camera_model = camera_model
        self._lens: CameraModel | None = None
        self.expectations = Expectations()

    def look(self, frame: Frame, tracks: Mapping[str, Track]) -> tuple[tuple[Detection, ...], tuple[Measurement, ...]]:
        """Look for every target.

        Args:
            frame: The frame.
            tracks: What is known of the targets so far, by name.

        Returns:
            The detections and the measurements, one of each for each target.

        Raises:
            CalibrationError: The frame has another aspect than the camera model.
        """
        lens = self._lens_of(frame)
        at_s = frame.captured_at_s
        detections = tuple(
            [
                detector.detect(frame, self.expectations.of(tracks.get(name), detector.target_size, lens, at_s))
                for name, detector in self.detectors.items()
            ]
        )
        looked = zip(detections, self.detectors.values(), strict=True)
        return detections, tuple([measure(found, detector.target_size, lens, at_s) for found, detector in looked])

    def _lens_of(self, frame: Frame) -> CameraModel:
        """Return the camera model at the frame's resolution, which hardly ever changes."""
        lens = self._lens
        if lens is None or (lens.width_px, lens.height_px) != (frame.width_px, frame.height_px):
            lens = self._lens = self._camera_model.scaled_to(frame.width_px, frame.height_px)
        return lens
