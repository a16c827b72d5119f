"""The picture of the picture detector in docs/how-it-measures.md: what it is given, and what it finds."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import cv2
import numpy as np
from measuring_round import QUALITY, RED, YELLOW

from stadimeter.core.detection import Points
from stadimeter.core.frame import Frame, Image
from stadimeter.detectors.picture import PictureDetector, PictureFeatures, PictureOptions
from stadimeter.detectors.sampling import grey_of
from support.scenes import draw
from support.scenes.plane import Pose
from support.scenes.poster import PosterTarget, poster
from support.scenes.render import render
from support.scenes.scene import Scene

POSTER = 12
ENLARGED = 2
HEIGHT_PX = 300


def picture_steps(path: Path) -> None:
    """Draw the file, and the frame with the place that its key points agree on, and its corners."""
    pose = Pose(position_m=(0.05, 0.0, 1.3), tilt_rad=math.radians(40), tilt_towards_rad=0.5, roll_rad=-0.2)
    image = render(Scene(camera=draw.CAMERA, target=PosterTarget(pose=pose, number=POSTER), seed=4)).image
    known = poster(POSTER)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "poster.png"
        cv2.imwrite(str(file), known)
        options = PictureOptions.model_validate({"file": str(file), "width": "40 cm"})
        detector = PictureDetector("poster", options)
        found = detector.detect(Frame(image, 0.0, 0), lens=draw.CAMERA)
    place = PictureFeatures(grey_of(known)).places_in(grey_of(image))[0]
    low, high = (np.rint(each).astype(int) for each in (found.outline_px.min(axis=0), found.outline_px.max(axis=0)))
    left, top = low - 25
    part = image[top : high[1] + 25, left : high[0] + 25]
    shown = cv2.resize(part, None, fx=ENLARGED, fy=ENLARGED, interpolation=cv2.INTER_NEAREST)
    for corners, colour in ((place, YELLOW), (found.outline_px, RED)):
        _loop(shown, (corners - (left, top) + 0.5) * ENLARGED, colour)
    cv2.imwrite(str(path), np.hstack([_scaled(known), np.full((HEIGHT_PX, 8, 3), 255, np.uint8), _scaled(shown)]),
                [cv2.IMWRITE_JPEG_QUALITY, QUALITY])  # fmt: skip


def _loop(image: Image, points: Points, colour: tuple[int, int, int]) -> None:
    cv2.polylines(image, [np.rint(points).astype(np.int32)], True, colour, 1, cv2.LINE_AA)


def _scaled(image: Image) -> Image:
    width = round(image.shape[1] * HEIGHT_PX / image.shape[0])
    return np.asarray(cv2.resize(image, (width, HEIGHT_PX), interpolation=cv2.INTER_AREA), np.uint8)


if __name__ == "__main__":
    picture_steps(Path(__file__).parent / "measuring-picture.jpg")
