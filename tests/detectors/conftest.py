"""Pictures drawn with known truth, and detectors for them."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame, Image
from stadimeter.detectors.ball import BallDetector, BallOptions
from stadimeter.detectors.sheet import SheetDetector, SheetOptions
from support.through_lens import ThroughLens

OVERSAMPLING = 8


def framed(image: Image) -> Frame:
    return Frame(image, 0.0, 0)


def with_noise(image: Image, sigma: float = 3.0) -> Image:
    noise = np.random.default_rng(1).normal(0, sigma, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def wall(width: int = 640, height: int = 480, bgr: tuple[int, int, int] = (70, 100, 120)) -> Image:
    return np.full((height, width, 3), bgr, np.uint8)


def draw_polygon(image: Image, corners: object, bgr: tuple[int, int, int]) -> Image:
    """Fill a polygon with smooth edges; pixel coordinates have (0, 0) at the centre of the first pixel."""
    height, width = image.shape[:2]
    mask = np.zeros((height * OVERSAMPLING, width * OVERSAMPLING), np.uint8)
    fixed = np.round((np.asarray(corners, float) + 0.5) * OVERSAMPLING - 0.5).astype(np.int32)
    cv2.fillPoly(mask, [fixed.reshape(-1, 1, 2)], 255)
    return _blended(image, mask, bgr)


def draw_disc(image: Image, centre: tuple[float, float], radius: float, bgr: tuple[int, int, int]) -> Image:
    """Fill a circle with a smooth edge."""
    height, width = image.shape[:2]
    rows, columns = np.indices((height, width), dtype=float)
    share = np.clip(radius - np.hypot(columns - centre[0], rows - centre[1]) + 0.5, 0, 1)[..., None]
    return np.round(image * (1 - share) + np.array(bgr) * share).astype(np.uint8)


def _blended(image: Image, mask: object, bgr: tuple[int, int, int]) -> Image:
    height, width = image.shape[:2]
    share = cv2.resize(mask, (width, height), interpolation=cv2.INTER_AREA)[..., None] / 255
    return np.round(image * (1 - share) + np.array(bgr) * share).astype(np.uint8)


@pytest.fixture
def draw() -> SimpleNamespace:
    """Return the ways to draw a picture with known truth."""
    return SimpleNamespace(polygon=draw_polygon, disc=draw_disc, noise=with_noise, frame=framed)


@pytest.fixture(name="wall")
def wall_fixture() -> Callable[..., Image]:
    """Return a function that makes an even picture."""
    return wall


@pytest.fixture
def sheet_detector() -> Callable[..., SheetDetector]:
    """Return a function that makes a detector for letter paper; options may be given."""

    def make(**options: object) -> SheetDetector:
        return SheetDetector("paper", SheetOptions.model_validate({"width": "11 in", "height": "8.5 in", **options}))

    return make


@pytest.fixture
def ball_detector() -> Callable[..., ThroughLens]:
    """Return a function that makes a detector for a red ball, whose hue wraps through 0; options may be given."""

    def make(camera: CameraModel | None = None, **options: object) -> ThroughLens:
        table = {"diameter": "6.4 cm", "hsv": "170,100,60:10,255,255", **options}
        return ThroughLens(BallDetector("ball", BallOptions.model_validate(table)), camera)

    return make
