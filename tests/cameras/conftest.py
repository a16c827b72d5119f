"""Pictures and devices for the tests of cameras."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

from stadimeter.core.frame import Image


@pytest.fixture
def scene() -> Image:
    """Return a colourful picture without symmetry, 160 × 120."""
    noise = np.random.default_rng(7).integers(0, 256, (120, 160, 3), dtype=np.uint8)
    return np.asarray(cv2.GaussianBlur(noise, (0, 0), 2), np.uint8)


class FakeDevice:
    """A Video4Linux device as OpenCV shows it: takes the settings that it has, substitutes the others silently.

    Attributes:
        calls: The properties that were set, in order.
        values: What the device says of itself.
        fixed: Properties that it does not let be changed.
        images: What it delivers, the last one for ever; None is a picture that cannot be decoded.
        wait: Called for each frame that is waited for.
    """

    def __init__(self) -> None:
        self.calls: list[tuple[int, float]] = []
        self.values: dict[int, float] = {}
        self.fixed: set[int] = set()
        self.images: list[Image | None] = [np.zeros((480, 640, 3), np.uint8)]
        self.wait: Callable[[], None] = lambda: None
        self.is_connected = True
        self.is_released = False
        self.source: tuple[Any, ...] = ()

    def __call__(self, *source: Any) -> FakeDevice:
        self.source = source
        self.is_released = False
        return self

    def isOpened(self) -> bool:  # noqa: N802
        return self.is_connected

    def set(self, prop: int, value: float) -> bool:
        self.calls.append((prop, value))
        if prop not in self.fixed:
            self.values[prop] = value
        return prop not in self.fixed

    def get(self, prop: int) -> float:
        return self.values.get(prop, -1.0)

    def grab(self) -> bool:
        self.wait()
        return self.is_connected

    def retrieve(self) -> tuple[bool, Image | None]:
        image = self.images.pop(0) if len(self.images) > 1 else self.images[0]
        return image is not None, image

    def release(self) -> None:
        self.is_released = True


@pytest.fixture
def device() -> FakeDevice:
    """Return a device that takes every setting and delivers pictures of 640 × 480."""
    return FakeDevice()
