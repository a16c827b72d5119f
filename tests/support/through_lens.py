"""A detector behind a lens, as a run has it: the lens is scaled to each frame and passed on."""

from __future__ import annotations

from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Prediction, TargetShape
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Measurement
from stadimeter.detectors.protocol import Detector
from stadimeter.ranging.measure import measure


class ThroughLens(Struct, frozen=True):
    """A detector with the lens that it looks through.

    Attributes:
        detector: The detector.
        camera: The camera model, at any resolution of the frames' aspect; None where it is not known.
    """

    detector: Detector
    camera: CameraModel | None

    @property
    def target_shape(self) -> TargetShape:
        """The target's shape."""
        return self.detector.target_shape

    def detect(self, frame: Frame, prediction: Prediction | None = None) -> Detection:
        """Look for the target through the lens."""
        return self.detector.detect(frame, prediction, lens=self._lens(frame))

    def measure(self, frame: Frame, prediction: Prediction | None = None) -> Measurement:
        """Look for the target, and measure how far away it is."""
        lens = self._lens(frame)
        assert lens is not None, "without a lens there is no distance"
        found = self.detector.detect(frame, prediction, lens=lens)
        return measure(found, self.target_shape, lens, frame.captured_at_s)

    def _lens(self, frame: Frame) -> CameraModel | None:
        if self.camera is None:
            return None
        lens = self.camera.scaled_to(frame.width_px, frame.height_px)
        return lens if frame.subsampling == (lens.subsampling or "4:4:4") else lens.for_frame(frame)
