"""From light to a file's code values: exposure, tone curve, sharpening, noise, JPEG."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.frame import Image
from support.scenes.tone import Tone, encode

Plane = NDArray[np.float32]

SHARPENING_SIGMA_PX = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """How a camera turns light into code values.

    Attributes:
        exposure_ev: Stops more or less light than what makes white 255.
        tone: The tone curve.
        sharpening: By how much the difference to a blurred copy (sigma 1 px) is added, in code values, as cameras do.
        noise: Standard deviation of the noise in code values, the same for each channel and pixel.
        jpeg_quality: From 1 to 100, with colour at half the resolution (4:2:0); None for no JPEG.
    """

    exposure_ev: float = 0.0
    tone: Tone = Tone.SRGB
    sharpening: float = 0.0
    noise: float = 2.0
    jpeg_quality: int | None = None

    def __post_init__(self) -> None:
        if not (self.noise >= 0 and self.sharpening >= 0):
            raise ValueError(f"noise {self.noise} and sharpening {self.sharpening} must be zero or more")
        if self.jpeg_quality is not None and not 1 <= self.jpeg_quality <= 100:
            raise ValueError(f"JPEG quality {self.jpeg_quality} is not between 1 and 100")

    def develop(self, light: Plane, rng: np.random.Generator) -> Image:
        """Make a picture.

        Args:
            light: Linear light, shape ``(height, width, 3)``, 1 is what white reflects at an exposure of 0.
            rng: What the noise comes from.

        Returns:
            The picture, 8 bits a channel.
        """
        code = encode(light * np.float32(2.0**self.exposure_ev), self.tone)
        if self.sharpening > 0:
            soft = cv2.GaussianBlur(code, (0, 0), SHARPENING_SIGMA_PX)
            code = code + np.float32(self.sharpening) * (code - soft)
        if self.noise > 0:
            code = code + rng.standard_normal(code.shape, dtype=np.float32) * np.float32(self.noise)
        image: Image = np.clip(np.rint(code), 0, 255).astype(np.uint8)
        return image if self.jpeg_quality is None else _through_jpeg(image, self.jpeg_quality)


def _through_jpeg(image: Image, quality: int) -> Image:
    halved_colour = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420)
    _, data = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, quality, *halved_colour))
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)
