"""The picture of docs/how-it-measures.md for targets on the floor: a ball, and lines of equal distance along it."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from gallery import JPEG_QUALITY

from stadimeter.core.frame import Frame
from stadimeter.detectors.ball import BallDetector, BallOptions
from stadimeter.ranging.floor import stand
from stadimeter.ranging.measure import measure
from support.scenes.draw import CAMERA
from support.scenes.on_floor import BALL_M, HEIGHT_M, TILT_RAD, ball_on_floor
from support.scenes.render import render

GREEN, YELLOW, WHITE = (80, 200, 60), (0, 210, 255), (255, 255, 255)
SEED, AHEAD_M = 6, 1.0
LINES_M = (0.5, 0.7, 1.0, 1.5, 2.0, 4.0)


def make_floor_picture(path: Path) -> None:
    """Write a ball on the floor, what its size and the floor tell of it, and lines of equal distance along it."""
    drawn = ball_on_floor(SEED, AHEAD_M)
    image = render(drawn.scene).image
    options = BallOptions.model_validate({"diameter": f"{BALL_M} m", "hsv": drawn.hsv})
    detector = BallDetector("ball", options)
    found = detector.detect(Frame(image, 0.0, 0), lens=CAMERA)
    stood = stand(
        measure(found, detector.target_shape, drawn.camera, 0.0),
        found,
        detector.target_shape,
        drawn.camera,
        drawn.footing,
    )
    for ahead_m in LINES_M:
        places = _pixels([(aside, HEIGHT_M, ahead_m) for aside in np.linspace(-3, 3, 61)])
        cv2.polylines(
            image, [np.round(places * 256).astype(np.int32).reshape(-1, 1, 2)], False, YELLOW, 1, cv2.LINE_AA, 8
        )
        y = _pixels([(0.0, HEIGHT_M, ahead_m)])[0, 1]
        cv2.putText(image, f"{ahead_m:g} m", (8, round(y) - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.5, YELLOW, 1, cv2.LINE_AA)
    cv2.polylines(
        image, [np.round(found.outline_px * 256).astype(np.int32).reshape(-1, 1, 2)], True, GREEN, 2, cv2.LINE_AA, 8
    )
    both = stood.measurement
    for row, (name, value_m, sigma_m) in enumerate(
        (
            ("by size", stood.by_size.distance_m, stood.by_size.sigma_m),
            ("by floor", stood.distance_m, stood.sigma_m),
            ("both", both.distance_m, both.sigma_m),
        )
    ):
        text = f"{name}: {value_m:.3f} m +- {sigma_m:.3f}"
        cv2.putText(image, text, (330, 30 + 26 * row), cv2.FONT_HERSHEY_SIMPLEX, 0.6, WHITE, 2, cv2.LINE_AA)
    cv2.imwrite(str(path), image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])


def _pixels(places_m: list[tuple[float, float, float]]) -> np.ndarray:
    """Return where places in level axes (right, down, ahead) appear."""
    aside, below, ahead = np.array(places_m).T
    cosine, sine = math.cos(TILT_RAD), math.sin(TILT_RAD)
    depth = ahead * cosine - below * sine
    return CAMERA.project(np.stack((aside, below * cosine + ahead * sine), axis=1) / depth[:, None])


if __name__ == "__main__":
    make_floor_picture(Path(__file__).parent / "how-floor.jpg")
