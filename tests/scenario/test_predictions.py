"""A tag that moves and then jumps: looking first where it is expected loses no frame."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.app.bootstrap import build
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Loop
from stadimeter.config.loader import load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Prediction
from stadimeter.core.frame import Frame

FRAMES, JUMP_AT = 36, 24

CONFIGURATION = """
[camera]
driver = "images"
paths = "{folder}"
rate = "30 Hz"
[camera.model]
width_px = 640
height_px = 480
fx_px = 600.0
[targets.tag]
detector = "tag"
side = "10 cm"
"""


def drawn(number: int) -> np.ndarray:
    """Draw a tag that moves along a bow, and from one frame on somewhere else."""
    marker = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), 7, 320)
    paper = cv2.copyMakeBorder(marker, 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=235)
    x = 180 + 5.0 * number if number < JUMP_AT else 470.0
    y = 260 + 40 * math.sin(number / 6) if number < JUMP_AT else 120.0
    turn = cv2.getRotationMatrix2D((219.5, 219.5), 3.0 * number, 0.25)
    turn[:, 2] += (x - 219.5, y - 219.5)
    image = cv2.warpAffine(cv2.GaussianBlur(paper, (0, 0), 1.6), turn, (640, 480), borderValue=90)
    noise = np.random.default_rng(number).normal(0, 2, image.shape)
    return cv2.cvtColor(np.clip(image + noise, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR)


class Listening:
    """Passes everything on to a detector, and counts what was expected."""

    def __init__(self, loop: Loop) -> None:
        self._detector = loop.parts.cycle.detectors["tag"]
        self.target_shape = self._detector.target_shape
        self.expected: list[Prediction | None] = []
        loop.parts.cycle.perceiver.detectors = {"tag": self}

    def detect(
        self, frame: Frame, prediction: Prediction | None = None, *, lens: CameraModel | None = None
    ) -> Detection:
        self.expected.append(prediction)
        return self._detector.detect(frame, prediction, lens=lens)


@pytest.fixture(scope="module")
def configuration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tags")
    for number in range(FRAMES):
        cv2.imwrite(str(folder / f"{number:03}.png"), drawn(number))
    path = tmp_path_factory.mktemp("configuration") / "run.toml"
    path.write_text(CONFIGURATION.format(folder=folder), encoding="utf-8")
    return path


def distances_m(loop: Loop) -> list[float | None]:
    records: list[CycleRecord] = []
    loop.listeners.append(lambda record, _frame: records.append(record))
    loop.run()
    return [measured.distance_m for record in records for measured in record.observation.measurements]


@pytest.mark.long
def test_a_tag_that_moves_and_jumps_is_measured_in_every_frame_as_without_expecting_it(configuration: Path) -> None:
    loop, other = (Loop(build(load_configuration(configuration), speed=None)) for _ in range(2))
    detector = Listening(loop)
    other.parts.cycle.perceiver.expectations.of = lambda *_: None  # type: ignore[method-assign]
    found_m, searched_m = distances_m(loop), distances_m(other)
    assert len(found_m) == FRAMES
    assert found_m == pytest.approx(searched_m, rel=2e-3)
    assert sum(expected is not None for expected in detector.expected) > 0.8 * FRAMES
