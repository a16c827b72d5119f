"""From light to a picture: blur by optics and motion, and what a sensor makes of it."""

from __future__ import annotations

import math

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.frame import Image, Subsampling
from support.scenes.tone import Tone, encode

# What blurs a picture before it reaches the sensor: the lens' point spread and motion during the exposure.
#
# Both act on light, so they work on linear light, and on the samples before these are averaged to pixels.

Plane = NDArray[np.float32]

REACH_SIGMAS = 4.0
"""The point spread is cut off there; 0.006 % of a Gaussian's light lies further out."""


class Blur(Struct, frozen=True, kw_only=True):
    """What a point of light becomes.

    Attributes:
        sigma_px: Standard deviation of the lens' point spread, a Gaussian, without the pixel's own square.
        motion_px: How far the picture moves during the exposure, evenly.
        direction_rad: Which way, from right towards down.
    """

    sigma_px: float = 0.7
    motion_px: float = 0.0
    direction_rad: float = 0.0

    @property
    def reach_px(self) -> int:
        """How far light spreads, rounded up to whole pixels."""
        return math.ceil(REACH_SIGMAS * self.sigma_px + self.motion_px / 2) + 1

    def of_samples(self, samples: Plane, finer: int) -> Plane:
        """Blur samples, ``finer`` of which make a pixel."""
        if self.sigma_px > 0:
            spread = _gaussian(self.sigma_px * finer)
            samples = _plane(cv2.sepFilter2D(samples, -1, spread, spread, borderType=cv2.BORDER_REPLICATE))
        if self.motion_px > 0:
            line = _line(self.motion_px * finer, self.direction_rad)
            samples = _plane(cv2.filter2D(samples, -1, line, borderType=cv2.BORDER_REPLICATE))
        return samples

    def of_pixels(self, picture: Plane, finer: int) -> Plane:
        """Blur whole pixels as if each were ``finer`` × ``finer`` equal samples, so that a patch of samples fits in.

        Its kernel is what becomes of a single pixel in `of_samples`.
        """
        if self.sigma_px == 0 and self.motion_px == 0:
            return picture
        reach = self.reach_px + 1
        single = np.zeros(((2 * reach + 1) * finer,) * 2, np.float32)
        single[reach * finer : (reach + 1) * finer, reach * finer : (reach + 1) * finer] = 1
        spread = self.of_samples(single, finer)
        kernel = cv2.resize(spread, (2 * reach + 1,) * 2, interpolation=cv2.INTER_AREA)
        return _plane(cv2.filter2D(picture, -1, kernel, borderType=cv2.BORDER_REPLICATE))


def _gaussian(sigma: float) -> Plane:
    reach = math.ceil(REACH_SIGMAS * sigma)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return _plane(weights / weights.sum())


def _line(length: float, direction_rad: float) -> Plane:
    """Return a kernel that smears along a line: many points on it, each shared among the four samples around it."""
    reach = math.ceil(length / 2) + 1
    along = (np.arange(math.ceil(length * 8)) + 0.5) / math.ceil(length * 8) * length - length / 2
    x, y = along * math.cos(direction_rad) + reach, along * math.sin(direction_rad) + reach
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1))
    for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
        weight = np.abs(1 - right - (x - left)) * np.abs(1 - down - (y - top))
        np.add.at(kernel, (top + down, left + right), weight)
    return _plane(kernel / kernel.sum())


def _plane(array: object) -> Plane:
    return np.asarray(array, np.float32)


# From light to a file's code values: exposure, tone curve, sharpening, noise, JPEG.

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
