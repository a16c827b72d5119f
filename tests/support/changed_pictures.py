"""Old pictures in which something changes: what a recorder that loops, or an encoder that repeats itself, shows.

Each kind makes, of the pictures that a camera took until it failed, those that it delivers afterwards.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from msgspec import structs

from stadimeter.core.frame import Frame, Image

RATE_HZ = 30.0

Change = Callable[[Image, int, np.random.Generator], Image]
Draw = Callable[[int], Image]
"""What is delivered as the picture of a number, from 0 on."""


def clock(image: Image, number: int, _rng: np.random.Generator | None = None) -> Image:
    """Draw a clock below the upper edge, where liveness looks."""
    image = image.copy()
    place_px, scale = (8, image.shape[0] // 4), image.shape[1] / 640
    cv2.putText(
        image, f"2026-11-23 {number / RATE_HZ:09.2f}", place_px, cv2.FONT_HERSHEY_SIMPLEX, scale, (255, 255, 255), 2
    )
    return image


def noise(image: Image, _number: int, rng: np.random.Generator, sigma: float = 3.0) -> Image:
    return np.clip(image + rng.normal(0, sigma, image.shape), 0, 255).astype(np.uint8)


def as_jpeg(image: Image, number: int, _rng: np.random.Generator) -> Image:
    """Compress a picture again, each time with another quality."""
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 40 + number * 7 % 50])[1]
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


def brightness(image: Image, number: int, _rng: np.random.Generator) -> Image:
    """Change the brightness by 2 % each way, once in 7 s."""
    return cv2.convertScaleAbs(image, alpha=1 + 0.02 * np.sin(number * 0.03))


def size(image: Image, number: int, _rng: np.random.Generator) -> Image:
    """Change the size by 1 % each way, once in 7 s."""
    height_px, width_px = image.shape[:2]
    turn = cv2.getRotationMatrix2D((width_px / 2, height_px / 2), 0.0, 1.01 + 0.01 * np.sin(number * 0.03))
    return np.asarray(cv2.warpAffine(image, turn, (width_px, height_px), borderMode=cv2.BORDER_REFLECT), np.uint8)


def shift(image: Image, _number: int, rng: np.random.Generator) -> Image:
    """Shift a picture by up to a pixel of 640 each way."""
    x, y = rng.uniform(-1, 1, 2) * image.shape[1] / 640
    moved = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])
    size_px = (image.shape[1], image.shape[0])
    return np.asarray(cv2.warpAffine(image, moved, size_px, borderMode=cv2.BORDER_REFLECT), np.uint8)


def everything(image: Image, number: int, rng: np.random.Generator) -> Image:
    for change in (brightness, shift, clock, noise, as_jpeg):
        image = change(image, number, rng)
    return image


def cycle(count: int, change: Change, *, is_to_and_fro: bool = False) -> Callable[..., Draw]:
    """Repeat the newest pictures, each changed anew."""

    def make(taken: Sequence[Image], _elsewhere: Sequence[Image], rng: np.random.Generator) -> Draw:
        newest = list(taken[-count:])
        if is_to_and_fro:
            newest = newest[::-1] + newest
        return lambda number: change(newest[number % len(newest)], number, rng)

    return make


def scroll(taken: Sequence[Image], _elsewhere: Sequence[Image], rng: np.random.Generator) -> Draw:
    """Move the newest picture sideways, by 1 to 3 pixels of 640 from one to the next."""
    step_px = rng.choice((-1, 1)) * rng.uniform(1, 3) * taken[-1].shape[1] / 640

    def draw(number: int) -> Image:
        height_px, width_px = taken[-1].shape[:2]
        shifted = np.array([[1.0, 0.0, step_px * number % width_px], [0.0, 1.0, 0.0]])
        wide = np.hstack((taken[-1], taken[-1]))
        return np.asarray(
            cv2.warpAffine(wide, shifted - [[0, 0, width_px], [0, 0, 0]], (width_px, height_px)), np.uint8
        )

    return draw


def as_h264(taken: Sequence[Image], _elsewhere: Sequence[Image], rng: np.random.Generator) -> Draw:
    """Send a cycle under a clock through a real encoder, as a recorder does that plays."""
    height_px, width_px = taken[-1].shape[:2]
    drawn = [clock(taken[-24 + number % 24], number, rng) for number in range(150)]
    raw = ["-f", "rawvideo", "-pix_fmt", "bgr24", "-s", f"{width_px}x{height_px}", "-r", "30"]
    coded = subprocess.run(
        ["ffmpeg", "-v", "fatal", *raw, "-i", "-", "-c:v", "libx264", "-preset", "veryfast", "-b:v", "1M", "-g", "40",
         "-f", "h264", "-"],
        input=b"".join(each.tobytes() for each in drawn), capture_output=True, check=True,
    ).stdout  # fmt: skip
    plain = subprocess.run(
        ["ffmpeg", "-v", "fatal", "-f", "h264", "-i", "-", *raw[:4], "-"], input=coded, capture_output=True, check=True
    ).stdout
    pictures = np.frombuffer(plain, np.uint8).reshape(-1, height_px, width_px, 3)
    return lambda number: pictures[min(number, len(pictures) - 1)].copy()


def cycle_of_elsewhere(_taken: Sequence[Image], elsewhere: Sequence[Image], rng: np.random.Generator) -> Draw:
    """Repeat pictures that were never seen before."""
    return lambda number: everything(elsewhere[-20 + number % 20], number, rng)


def once_of_elsewhere(_taken: Sequence[Image], elsewhere: Sequence[Image], rng: np.random.Generator) -> Draw:
    """Play a long recording, of which nothing comes twice."""
    return lambda number: noise(elsewhere[min(number, len(elsewhere) - 1)], number, rng)


NEVER_TWICE = "a long recording from elsewhere, in which nothing comes twice"

KINDS: Mapping[str, Callable[..., Draw]] = {
    "20 in a cycle, under a clock": cycle(20, clock),
    "40 in a cycle, under a clock": cycle(40, clock),
    "20 in a cycle, with noise": cycle(20, noise),
    "40 in a cycle, as JPEG again": cycle(40, as_jpeg),
    "24 in a cycle, as H.264 again": as_h264,
    "30 in a cycle, brightness drifts by 2 %": cycle(30, brightness),
    "30 in a cycle, size drifts by 1 %": cycle(30, size),
    "30 in a cycle, shifted by up to a pixel": cycle(30, shift),
    "20 to and fro, under a clock": cycle(20, clock, is_to_and_fro=True),
    "40 in a cycle, with clock, noise, JPEG, brightness and shift": cycle(40, everything),
    "20 from elsewhere in a cycle, with the same": cycle_of_elsewhere,
    "one, scrolled sideways": scroll,
    NEVER_TWICE: once_of_elsewhere,
}


class ChangedCamera:
    """A camera that shows old pictures from some time on; until then, what another camera shows.

    Attributes:
        taken: The pictures that were taken until then.
    """

    def __init__(self, camera: Any, kind: str, fails_s: float, elsewhere: Sequence[Image]) -> None:
        self.taken: list[Image] = []
        self._camera, self._make, self._fails_s, self._elsewhere = camera, KINDS[kind], fails_s, elsewhere
        self._draw: Draw | None = None
        self._number = 0
        self._has_clock = "clock" in kind

    def __getattr__(self, name: str) -> Any:
        return getattr(self._camera, name)

    def read(self) -> Frame:
        frame: Frame = self._camera.read()
        if frame.captured_at_s < self._fails_s:
            self.taken.append(frame.image)
            return structs.replace(frame, image=clock(frame.image, frame.sequence)) if self._has_clock else frame
        if self._draw is None:
            self._draw = self._make(self.taken, self._elsewhere, np.random.default_rng(frame.sequence))
        self._number += 1
        return structs.replace(frame, image=self._draw(self._number - 1))
