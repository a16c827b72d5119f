import math

import cv2
import numpy as np

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Length
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.detectors.protocol import check_image
from stadimeter.ranging.flat import DiscShape


class LampOptions(DriverOptions):
    """What the table of a lamp may hold."""

    diameter: Length
    min_diameter_px: float = 6.0

    def build(self, context: DriverContext) -> "LampDetector":
        return LampDetector(self, context.name)


class LampDetector:
    """Finds the largest bright spot, or the one where the lamp is expected."""

    def __init__(self, options: LampOptions, name: str) -> None:
        self._options = options
        self._name = name

    @property
    def target_shape(self) -> DiscShape:
        return DiscShape(diameter_m=self._options.diameter)

    def detect(self, frame, prediction=None, *, lens=None):
        check_image(frame)  # raises PictureError for anything but 8-bit colour
        bright = (frame.image.min(axis=2) > 127).astype(np.uint8)
        _, _, boxes, centres = cv2.connectedComponentsWithStats(bright)
        spots = [
            (2 * math.sqrt(area / math.pi), (x, y), (left, top, left + width, top + height))
            for (left, top, width, height, area), (x, y) in zip(boxes.tolist()[1:], centres.tolist()[1:])
        ]
        spots = [spot for spot in spots if spot[0] >= self._options.min_diameter_px]
        if not spots:
            reason = f"no bright spot of at least {self._options.min_diameter_px:g} px"
            return Detection(target=self._name, status=DetectionStatus.NOT_FOUND, reason=reason)
        expected = prediction is not None and all(map(math.isfinite, prediction.centre_px))
        if expected:
            diameter_px, centre, box = min(spots, key=lambda spot: math.dist(spot[1], prediction.centre_px))
        else:
            diameter_px, centre, box = max(spots)
        cut_off = min(box) <= 0 or box[2] >= frame.width_px or box[3] >= frame.height_px
        angles = np.linspace(0, 2 * math.pi, 32, endpoint=False)
        rim = np.column_stack((np.cos(angles), np.sin(angles)))
        return Detection(
            target=self._name,
            status=DetectionStatus.TRUNCATED if cut_off else DetectionStatus.FOUND,
            reason="the border cuts the lamp off" if cut_off else "",
            outline_px=centre + rim * diameter_px / 2,
            centre_px=centre,
            width_px=diameter_px,
            height_px=diameter_px,
            size_sigma_px=0.3,
            quality=1.0,
        )
