from __future__ import annotations

import cv2
import numpy as np
import pytest

from stadimeter.app.capture import FreezeDetector
from stadimeter.core.frame import MAX_REMEMBERED, Frame
from support.each_case import each_case


def frame(captured_at_s: float, image: np.ndarray) -> Frame:
    return Frame(image, captured_at_s, 0)


@pytest.fixture
def image() -> np.ndarray:
    return np.random.default_rng(3).integers(0, 256, (48, 64, 3), dtype=np.uint8)


def test_pictures_that_differ_are_new(image):
    freeze = FreezeDetector()
    assert freeze.is_new(frame(1.0, image), 1.0)
    assert freeze.is_new(frame(1.1, image + 1), 1.1)


def test_a_picture_with_the_same_bytes_is_not_new_whatever_its_time(image):
    freeze = FreezeDetector()
    freeze.is_new(frame(1.0, image), 1.0)
    assert not freeze.is_new(frame(1.1, image.copy()), 1.1)


@pytest.mark.parametrize("row", [0, 1, 17, 47])
def test_one_byte_anywhere_makes_a_picture_new(image, row):
    freeze = FreezeDetector()
    freeze.is_new(frame(1.0, image), 1.0)
    other = image.copy()
    other[row, 63, 2] ^= 1
    assert freeze.is_new(frame(1.1, other), 1.1)


@pytest.mark.parametrize("captured_at_s", [1.0, 0.9])
def test_a_capture_time_that_does_not_advance_is_not_new(image, captured_at_s):
    freeze = FreezeDetector()
    freeze.is_new(frame(1.0, image), 1.0)
    assert not freeze.is_new(frame(captured_at_s, image + 1), 1.1)


def test_a_camera_is_frozen_when_nothing_new_came_for_longer_than_allowed(image):
    freeze = FreezeDetector(frozen_after_s=0.5)
    freeze.is_new(frame(1.0, image), 1.0)
    freeze.is_new(frame(1.4, image), 1.4)
    assert freeze.frozen(1.5) == ""
    assert freeze.frozen(1.6) == "the picture has not changed for 0.6 s"


def test_an_opened_camera_gets_its_time_again_but_the_old_picture_stays_old(image):
    freeze = FreezeDetector(frozen_after_s=0.5)
    freeze.is_new(frame(1.0, image), 1.0)
    freeze.restart(5.0)
    assert freeze.frozen(5.4) == ""
    assert not freeze.is_new(frame(5.4, image.copy()), 5.4)
    assert freeze.frozen(5.6)


NOISE = np.random.default_rng(0).standard_normal((640, 800, 3), np.float32)


def noisy(scene: np.ndarray, seed: int, sigma: float = 2.0) -> np.ndarray:
    """Return an exposure of a still scene. Each takes its noise from another place of one field: making it is dear."""
    down, right = divmod(37 * seed % 25_600, 160)
    exposure = NOISE[down : down + scene.shape[0], right : right + scene.shape[1]] * np.float32(sigma)
    exposure += scene
    return np.clip(exposure, 0, 255, out=exposure).astype(np.uint8)


@pytest.fixture(scope="module")
def scene() -> np.ndarray:
    """Return a still scene with contrast everywhere, but for a wall that is plain and one that is overexposed."""
    blobs = cv2.GaussianBlur(np.random.default_rng(5).normal(0, 1, (480, 640)), (0, 0), 4)
    grey = np.clip(128 + 60 * blobs / blobs.std(), 20, 235)
    grey[120:180] = 90
    grey[300:360] = 400
    return np.repeat(grey[:, :, None], 3, axis=2).astype(np.float32)


def as_jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)


def numbered(number: int, height_px: int = 48) -> np.ndarray:
    return np.random.default_rng(number).integers(0, 256, (height_px, 64, 3), dtype=np.uint8)


@each_case("rate_hz", [5, 30, 60])
@each_case("cycle_s", [0.2, 1.0, 20.0])
def test_old_pictures_that_come_again_in_turn_are_not_new(cycle_s, rate_hz):
    freeze, count = FreezeDetector(), max(2, round(cycle_s * rate_hz))
    new = [freeze.is_new(frame(at / rate_hz, numbered(at % count)), at / rate_hz) for at in range(3 * count + 1)]
    assert new == [True] * count + [False] * (2 * count + 1)
    assert freeze.frozen(4 * cycle_s + 2).startswith("old pictures have come again in turn for")


def test_old_pictures_of_several_sizes_that_come_again_in_turn_are_not_new():
    freeze = FreezeDetector()
    new = [freeze.is_new(frame(at / 30, numbered(at % 5, 40 + 8 * (at % 2))), at / 30) for at in range(300)]
    assert new == [True] * 10 + [False] * 290


def test_old_pictures_are_known_again_after_a_break_of_an_hour():
    freeze = FreezeDetector()
    for at in range(30):
        freeze.is_new(frame(at / 30, numbered(at)), at / 30)
    assert not any(freeze.is_new(frame(3600 + at / 30, numbered(at)), 3600 + at / 30) for at in range(30))


def test_the_memory_for_pictures_is_bounded():
    freeze = FreezeDetector()
    image = np.zeros((8, 64, 3), np.uint8)
    for at in range(MAX_REMEMBERED + 100):
        image[0, 0, :2] = divmod(at, 256)
        assert freeze.is_new(frame(1 + at / 1e6, image.copy()), 1 + at / 1e6)
    assert len(freeze._seen) == MAX_REMEMBERED


@pytest.mark.parametrize("kept", [0.1, 0.4, 0.7, 0.95])
def test_a_picture_whose_lower_part_is_old_is_not_new(scene, kept):
    freeze = FreezeDetector()
    whole = noisy(scene, 0)
    assert freeze.is_new(frame(0.0, whole), 0.0)
    for number in range(1, 30):
        damaged = noisy(scene, number)
        damaged[round(480 * kept) :] = whole[round(480 * kept) :]
        assert not freeze.is_new(frame(number / 10, damaged), number / 10)
    assert freeze.frozen(3.0) == "parts of the picture have not changed for 3.0 s"
    assert freeze.is_new(frame(3.1, noisy(scene, 99)), 3.1)


@each_case("sigma", [0.5, 2.0])
@each_case("gain", [0.15, 1.0, 2.0])
@each_case("quality", [30, 60, 90])
def test_good_pictures_of_a_still_scene_are_new(scene, sigma, gain, quality):
    freeze = FreezeDetector()
    for number in range(6):
        image = as_jpeg(noisy(gain * scene, number, sigma), quality)
        assert freeze.is_new(frame(number / 10, image), number / 10)


def test_a_rendered_picture_in_which_only_the_target_moves_is_new(scene):
    freeze = FreezeDetector()
    for number in range(10):
        image = np.clip(scene, 0, 255).astype(np.uint8)
        cv2.circle(image, (100 + 20 * number, 100), 80, (0, 160, 0), -1)
        assert freeze.is_new(frame(number / 10, image), number / 10)


def with_clock(image: np.ndarray, number: int) -> np.ndarray:
    """Draw a clock with hundredths over a picture, as IP cameras do."""
    image = image.copy()
    cv2.putText(image, f"12:00:{number / 30:05.2f}", (8, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255, 255, 255), 2)
    return image


@pytest.mark.parametrize(("quality", "sigma"), [(100, 0.5), (90, 0.25), (60, 1.0), (30, 2.0)])
def test_a_frozen_picture_under_a_clock_that_goes_on_is_not_new(scene, quality, sigma):
    freeze = FreezeDetector()
    for number in range(70):
        image = as_jpeg(with_clock(noisy(scene, number, sigma), number), quality)
        assert freeze.is_new(frame(number / 30, image), number / 30)
    frozen = noisy(scene, 69, sigma)
    for number in range(70, 130):
        image = as_jpeg(with_clock(frozen, number), quality)
        assert not freeze.is_new(frame(number / 30, image), number / 30)
    assert freeze.frozen(5.3) == "the picture has not changed but for a small part for 3.0 s"
    assert freeze.is_new(frame(5.3, as_jpeg(noisy(scene, 240, sigma), quality)), 5.3)


def test_a_camera_whose_noise_comes_and_goes_is_believed_after_one_picture(scene):
    freeze, image = FreezeDetector(), noisy(scene, 0)
    new = []
    for number in range(150):
        # From the hundredth picture on only each tenth is taken anew, as a codec sends it; the rest gets a clock.
        if number < 100 or number % 10 == 0:
            image = noisy(scene, number)
        new.append(freeze.is_new(frame(number / 30, with_clock(image, number)), number / 30))
    assert all(new[:101])
    assert not any(new[101:110])
    assert all(new[110:])
