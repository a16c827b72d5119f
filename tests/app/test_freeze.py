from __future__ import annotations

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
    assert freeze.frozen_for_s(1.5) == 0.0
    assert freeze.frozen_for_s(1.6) == pytest.approx(0.6)


def test_an_opened_camera_gets_its_time_again_but_the_old_picture_stays_old(image: np.ndarray) -> None:
    freeze = FreezeDetector(frozen_after_s=0.5)
    freeze.is_new(frame(1.0, image), 1.0)
    freeze.restart(5.0)
    assert freeze.frozen_for_s(5.4) == 0.0
    assert not freeze.is_new(frame(5.4, image.copy()), 5.4)
    assert freeze.frozen_for_s(5.6) == pytest.approx(0.6)
