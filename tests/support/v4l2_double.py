"""A camera where there is none: OpenCV's capture of one Video4Linux node, answered by a picture that can be changed."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from stadimeter.core.frame import Image

PACE_S = 0.005
"""Time between frames: a device has a pace, and the tests have little time."""

DELIVERED_S = 5.0


class V4l2Double:
    """A device that takes every setting that it is not told to keep, and shows one picture with fresh sensor noise.

    Put it in place of ``cv2.VideoCapture`` by `plugged_in`; other files and streams still reach OpenCV.

    Attributes:
        node: Its path; a file that is there for as long as the device is plugged in.
        kept: Properties that it does not let be changed, with what it says of them.
        set_to: Every property that was set, with its last value.
        is_busy: Whether another program has it.
    """

    def __init__(self, node: Path, image: Image) -> None:
        self.node = node
        self.kept: dict[int, float] = {}
        self.set_to: dict[int, float] = {}
        self.is_busy = False
        self._image = image
        self._rng = np.random.default_rng(1)
        self._open_capture = cv2.VideoCapture
        self._frames = threading.Condition()
        self._grabbed = 0
        self._is_open = False
        node.parent.mkdir(parents=True, exist_ok=True)
        node.touch()

    @classmethod
    def plugged_in(cls, node: Path, image: Image, monkeypatch: pytest.MonkeyPatch) -> V4l2Double:
        """Return a double that drivers reach at that path, until the test ends."""
        device = cls(node, image)
        monkeypatch.setattr(cv2, "VideoCapture", device)
        return device

    def __call__(self, source: Any, api: int = cv2.CAP_ANY, params: Any = ()) -> Any:
        if api != cv2.CAP_V4L2 or source != str(self.node):
            return self._open_capture(source, api, params)
        self._is_open = not self.is_busy
        return self

    def show(self, image: Image) -> None:
        """Show another picture; return when an open camera has delivered it twice."""
        with self._frames:
            self._image = image
            wanted = self._grabbed + 3  # the first may still be the old one
            assert not self._is_open or self._frames.wait_for(lambda: self._grabbed >= wanted, DELIVERED_S)

    def isOpened(self) -> bool:  # noqa: N802 - OpenCV's name
        return self._is_open

    def set(self, prop: int, value: float) -> bool:
        self.set_to[prop] = value
        return prop not in self.kept

    def get(self, prop: int) -> float:
        return self.kept.get(prop, self.set_to.get(prop, -1.0))

    def grab(self) -> bool:
        with self._frames:
            self._frames.wait(PACE_S)
            if not (self._is_open and self.node.exists()):
                return False
            self._grabbed += 1
            self._frames.notify_all()
            return True

    def retrieve(self) -> tuple[bool, Image]:
        noise = self._rng.integers(-2, 3, self._image.shape, np.int8)
        return True, np.clip(self._image.astype(np.int16) + noise, 0, 255).astype(np.uint8)

    def release(self) -> None:
        self._is_open = False
