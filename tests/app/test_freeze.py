from __future__ import annotations

import cv2
import numpy as np
import pytest

from stadimeter.app.freeze import FreezeDetector
from stadimeter.core.frame import Frame


def frame(captured_at_s: float, image: np.ndarray) -> Frame:
    return Frame(image, captured_at_s, 0)


@pytest.fixture
def image() -> np.ndarray:
    return np.random.default_rng(3).integers(0, 256, (48, 64, 3), dtype=np.uint8)


def test_pictures_that_differ_are_new(image: np.ndarray) -> None:
    freeze = FreezeDetector()
    assert freeze.is_new(frame(1.0, image), 1.0)
    assert freeze.is_new(frame(1.1, image + 1), 1.1)


def test_a_picture_with_the_same_bytes_is_not_new_whatever_its_time(image: np.ndarray) -> None:
    freeze = FreezeDetector()
    freeze.is_new(frame(1.0, image), 1.0)
    assert not freeze.is_new(frame(1.1, image.copy()), 1.1)


@pytest.mark.parametrize("row", [0, 1, 17, 47])
def test_one_byte_anywhere_makes_a_picture_new(image: np.ndarray, row: int) -> None:
    freeze = FreezeDetector()
    freeze.is_new(frame(1.0, image), 1.0)
    other = image.copy()
    other[row, 63, 2] ^= 1
    assert freeze.is_new(frame(1.1, other), 1.1)


@pytest.mark.parametrize("captured_at_s", [1.0, 0.9])
def test_a_capture_time_that_does_not_advance_is_not_new(image: np.ndarray, captured_at_s: float) -> None:
    freeze = FreezeDetector()
    freeze.is_new(frame(1.0, image), 1.0)
    assert not freeze.is_new(frame(captured_at_s, image + 1), 1.1)


def test_a_picture_of_another_size_is_new(image: np.ndarray) -> None:
    freeze = FreezeDetector()
    freeze.is_new(frame(1.0, image), 1.0)
    assert freeze.is_new(frame(1.1, image[:24]), 1.1)


def test_a_camera_is_frozen_when_nothing_new_came_for_longer_than_allowed(image: np.ndarray) -> None:
    freeze = FreezeDetector(frozen_after_s=0.5)
    freeze.is_new(frame(1.0, image), 1.0)
    freeze.is_new(frame(1.4, image), 1.4)
    assert freeze.frozen(1.5) == ""
    assert freeze.frozen(1.6) == "the picture has not changed for 0.6 s"


def test_an_opened_camera_gets_its_time_again_but_the_old_picture_stays_old(image: np.ndarray) -> None:
    freeze = FreezeDetector(frozen_after_s=0.5)
    freeze.is_new(frame(1.0, image), 1.0)
    freeze.restart(5.0)
    assert freeze.frozen(5.4) == ""
    assert not freeze.is_new(frame(5.4, image.copy()), 5.4)
    assert freeze.frozen(5.6)


def noisy(scene: np.ndarray, seed: int, sigma: float = 2.0) -> np.ndarray:
    """Return an exposure of a still scene."""
    noise = np.random.default_rng(seed).normal(0, sigma, scene.shape)
    return np.clip(scene + noise, 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def scene() -> np.ndarray:
    """Return a still scene with contrast everywhere, but for a wall that is plain and one that is overexposed."""
    blobs = cv2.GaussianBlur(np.random.default_rng(5).normal(0, 1, (480, 640)), (0, 0), 4)
    grey = np.clip(128 + 60 * blobs / blobs.std(), 20, 235)
    grey[120:180] = 90
    grey[300:360] = 400
    return np.repeat(grey[:, :, None], 3, axis=2)


def as_jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)


@pytest.mark.parametrize("cycle", [2, 3, 8, 16])
def test_old_pictures_that_come_again_in_turn_are_not_new(cycle: int) -> None:
    freeze = FreezeDetector()
    pictures = [np.random.default_rng(seed).integers(0, 256, (48, 64, 3), dtype=np.uint8) for seed in range(cycle)]
    new = [freeze.is_new(frame(at, pictures[at % cycle].copy()), at) for at in range(1, 5 * cycle)]
    assert new == [True] * cycle + [False] * (4 * cycle - 1)
    assert freeze.frozen(5 * cycle).startswith("old pictures have come again in turn for")


@pytest.mark.parametrize("kept", [0.1, 0.4, 0.7, 0.95])
def test_a_picture_whose_lower_part_is_old_is_not_new(scene: np.ndarray, kept: float) -> None:
    freeze = FreezeDetector()
    whole = noisy(scene, 0)
    assert freeze.is_new(frame(0.0, whole), 0.0)
    for number in range(1, 30):
        damaged = noisy(scene, number)
        damaged[round(480 * kept) :] = whole[round(480 * kept) :]
        assert not freeze.is_new(frame(number / 10, damaged), number / 10)
    assert freeze.frozen(3.0) == "parts of the picture have not changed for 3.0 s"
    assert freeze.is_new(frame(3.1, noisy(scene, 99)), 3.1)


@pytest.mark.parametrize("sigma", [0.5, 2.0])
@pytest.mark.parametrize("gain", [0.15, 1.0, 2.0])
@pytest.mark.parametrize("quality", [30, 60, 90])
def test_good_pictures_of_a_still_scene_are_new(scene: np.ndarray, sigma: float, gain: float, quality: int) -> None:
    freeze = FreezeDetector()
    for number in range(6):
        image = as_jpeg(noisy(gain * scene, number, sigma), quality)
        assert freeze.is_new(frame(number / 10, image), number / 10)


def test_a_rendered_picture_in_which_only_the_target_moves_is_new(scene: np.ndarray) -> None:
    freeze = FreezeDetector()
    for number in range(10):
        image = np.clip(scene, 0, 255).astype(np.uint8)
        cv2.circle(image, (100 + 20 * number, 100), 80, (0, 160, 0), -1)
        assert freeze.is_new(frame(number / 10, image), number / 10)
