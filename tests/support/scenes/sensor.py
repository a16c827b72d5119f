"""From light to a file's code values: exposure, tone curve, sharpening, noise, JPEG."""

from __future__ import annotations

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.frame import Image, Subsampling
from support.scenes.tone import Tone, encode

Plane = NDArray[np.float32]

SHARPENING_SIGMA_PX = 1.0


class Sensor(Struct, frozen=True, kw_only=True):
    """How a camera turns light into code values.

    Attributes:
        exposure_ev: Stops more or less light than what makes white 255.
        tone: The tone curve.
        sharpening: By how much the difference to a blurred copy (sigma 1 px) is added, in code values, as cameras do.
        noise: Standard deviation of the noise in code values, the same for each channel and pixel.
        shot_noise: Standard deviation of the light of white, as a share of it: that of other light grows with its
            square root, as photons arrive. 0.01 is a good sensor in daylight, 0.05 a phone in a dim room.
        halved_colour: Whether colour is kept at half the resolution (4:2:0) without JPEG, as video frames are.
        jpeg_quality: From 1 to 100, with colour at half the resolution (4:2:0); None for no JPEG.
    """

    exposure_ev: float = 0.0
    tone: Tone = Tone.SRGB
    sharpening: float = 0.0
    noise: float = 2.0
    shot_noise: float = 0.0
    halved_colour: bool = False
    jpeg_quality: int | None = None

    def __post_init__(self) -> None:
        if not (self.noise >= 0 and self.shot_noise >= 0 and self.sharpening >= 0):
            raise ValueError(f"noise {self.noise}, {self.shot_noise} or sharpening {self.sharpening} is below zero")
        if self.jpeg_quality is not None and not 1 <= self.jpeg_quality <= 100:
            raise ValueError(f"JPEG quality {self.jpeg_quality} is not between 1 and 100")

    @property
    def subsampling(self) -> Subsampling:
        """How coarsely colour is stored."""
        return "4:2:0" if self.halved_colour or self.jpeg_quality is not None else "4:4:4"

    def develop(self, light: Plane, rng: np.random.Generator) -> Image:
        """Make a picture.

        Args:
            light: Linear light, shape ``(height, width, 3)``, 1 is what white reflects at an exposure of 0.
            rng: What the noise comes from.

        Returns:
            The picture, 8 bits a channel.
        """
        light = light * np.float32(2.0**self.exposure_ev)
        if self.shot_noise > 0:
            spread = np.float32(self.shot_noise) * np.sqrt(np.maximum(light, 0))
            light = light + spread * rng.standard_normal(light.shape, dtype=np.float32)
        code = encode(light, self.tone)
        if self.sharpening > 0:
            soft = cv2.GaussianBlur(code, (0, 0), SHARPENING_SIGMA_PX)
            code = code + np.float32(self.sharpening) * (code - soft)
        if self.noise > 0:
            code = code + rng.standard_normal(code.shape, dtype=np.float32) * np.float32(self.noise)
        image: Image = np.clip(np.rint(code), 0, 255).astype(np.uint8)
        if self.jpeg_quality is not None:
            return _through_jpeg(image, self.jpeg_quality)
        return _with_halved_colour(image) if self.halved_colour else image


def _through_jpeg(image: Image, quality: int) -> Image:
    halved_colour = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420)
    _, data = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, quality, *halved_colour))
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


def _with_halved_colour(image: Image) -> Image:
    """Return a picture whose colour differences were averaged over 2 × 2 pixels and interpolated again."""
    parts = list(cv2.split(cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb)))
    size = parts[0].shape[::-1]
    for k in (1, 2):
        half = cv2.resize(parts[k], (size[0] // 2, size[1] // 2), interpolation=cv2.INTER_AREA)
        parts[k] = cv2.resize(half, size, interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.cvtColor(cv2.merge(parts), cv2.COLOR_YCrCb2BGR), np.uint8)
