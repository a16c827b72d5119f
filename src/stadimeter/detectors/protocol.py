"""What a detector is to the rest of the program."""

from __future__ import annotations

from typing import Protocol

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Prediction
from stadimeter.core.frame import Frame
from stadimeter.core.target import TargetShape


class Detector(Protocol):
    """Finds one target in a frame. It keeps no state: the same frame, prediction and lens give the same answer."""

    @property
    def target_size(self) -> TargetShape:
        """The known size and form of the target."""
        ...

    def detect(
        self, frame: Frame, prediction: Prediction | None = None, *, lens: CameraModel | None = None
    ) -> Detection:
        """Look for the target.

        A frame without the target is an ordinary result, not an error.

        Args:
            frame: The frame; its image is not changed.
            prediction: Where the target is expected, for a detector that can look there first; None to search the
                whole frame.
            lens: The camera model at the frame's resolution, which the answer will be measured with; None where it is
                not known yet, as while a camera is calibrated.

        Returns:
            Where the target is; or that it is cut off by the border; or that it is not there, with a reason that
            holds the figures: ``largest blob 6 px, limit 12 px``.
        """
        ...
