"""The picture of several balls in docs/how-it-measures.md: two cross, one is hidden, and both keep their names."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from gallery import JPEG_QUALITY

from stadimeter.core.detection import Detection, DetectionStatus, Prediction
from stadimeter.core.frame import Frame, Image
from stadimeter.detectors.ball import BallOptions, SeveralBalls
from support.crossing_balls import Follower, appearances, picture_of

GREEN, YELLOW = (60, 170, 40), (0, 200, 255)
FRAMES, SHOWN = 41, (8, 20, 32)
CUT = slice(130, 350), slice(140, 500)


class Noting(SeveralBalls):
    """Notes where it is asked to look."""

    def __init__(self, options: BallOptions) -> None:
        super().__init__("balls", options)
        self.expected: list[Prediction] = []

    def detect_near(self, frame: Frame, prediction: Prediction, **more: object) -> Detection:
        """Look there, and note it."""
        self.expected.append(prediction)
        return super().detect_near(frame, prediction, **more)


def make_several(folder: Path) -> None:
    """Write the picture."""
    at = np.linspace(-1, 1, FRAMES)
    near = np.stack([0.16 * at, 0 * at + 0.01, 0 * at + 0.7], axis=1)
    far = np.stack([-0.25 * at, 0 * at, 0 * at + 1.1], axis=1)
    options = BallOptions.model_validate({"diameter": "6.7 cm", "hsv": "29,86,6:64,255,255", "count": 2})
    detector = Noting(options)
    follower = Follower(detector, 2)
    panels: list[Image] = []
    for number, places in enumerate(np.stack([near, far], axis=1)):
        image = picture_of(places, 7, number)
        detector.expected.clear()
        follower.step(image, number, appearances(places))
        if number in SHOWN:
            panels.append(_drawn(image, detector.expected, follower.detections))
    cv2.imwrite(str(folder / "how-several.jpg"), np.hstack(panels), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])


def _drawn(image: Image, expected: list[Prediction], found: tuple[Detection, ...]) -> Image:
    shown = image.copy()
    for each in expected:
        radius_px = each.size_px / 2 + 2 * each.sigma_px
        cv2.circle(shown, _whole(each.centre_px), round(radius_px), YELLOW, 2, cv2.LINE_AA)
    lines = []
    for each in found:
        if each.status is DetectionStatus.FOUND:
            cv2.circle(shown, _whole(each.centre_px), round(each.width_px / 2), GREEN, 2, cv2.LINE_AA)
            x, y = _whole(each.centre_px)
            place = (x - 32, y - round(each.width_px / 2) - 12)
            cv2.putText(shown, each.target, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, GREEN, 2, cv2.LINE_AA)
        else:
            lines.append(f"{each.target}: {each.reason}")
    panel = np.ascontiguousarray(shown[CUT])
    for line in lines:
        cv2.rectangle(panel, (0, panel.shape[0] - 26), (panel.shape[1], panel.shape[0]), (255, 255, 255), -1)
        place = (8, panel.shape[0] - 8)
        cv2.putText(panel, line, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (30, 30, 30), 1, cv2.LINE_AA)
    return panel


def _whole(place_px: tuple[float, float]) -> tuple[int, int]:
    return round(place_px[0]), round(place_px[1])


if __name__ == "__main__":
    make_several(Path(__file__).parent)
