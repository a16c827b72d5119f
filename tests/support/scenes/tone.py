"""Tone curves: how much light makes which code value.

Light adds up, code values do not: half of the light of white has the code value 188 of 255 under sRGB, not 128. So
everything is mixed in linear light and encoded last.
"""

from __future__ import annotations

from enum import StrEnum
from functools import cache

import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float32]

STEPS = 1 << 14
"""An encoding table has so many steps: fine enough for a tenth of a code value in the steepest part."""


class Tone(StrEnum):
    """The tone curve of a camera."""

    SRGB = "srgb"
    """IEC 61966-2-1, what cameras and phones write by default."""
    LINEAR = "linear"
    """A code value in proportion to the light, as from a raw sensor."""
    GAMMA_1_8 = "gamma 1/1.8"
    GAMMA_2_4 = "gamma 1/2.4"
    S_CURVE = "srgb with an s-curve"
    """sRGB with more contrast in the middle, as picture styles have it."""


def decode_srgb(code: NDArray[np.floating] | NDArray[np.integer] | tuple[float, ...]) -> Plane:
    """Return the light that sRGB code values stand for.

    Args:
        code: Code values from 0 to 255.

    Returns:
        Linear light from 0 to 1, of the same shape.
    """
    share = np.asarray(code, np.float64) / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4).astype(np.float32)


def encode(light: Plane, tone: Tone) -> Plane:
    """Return the code values that a camera gives to light.

    Args:
        light: Linear light; what is below 0 or above 1 is clipped, as a sensor does.
        tone: The tone curve.

    Returns:
        Code values from 0 to 255, not rounded.
    """
    if tone is Tone.LINEAR:
        return np.clip(light, 0, 1) * np.float32(255)
    # Square roots spread the steps as evenly over the code values as over the light.
    place = np.sqrt(np.clip(light, 0, 1)) * np.float32(STEPS)
    return _table(tone)[np.rint(place).astype(np.intp)]


@cache
def _table(tone: Tone) -> Plane:
    light = (np.arange(STEPS + 1) / STEPS) ** 2
    return (_curve(light, tone) * 255).astype(np.float32)


def _curve(light: NDArray[np.float64], tone: Tone) -> NDArray[np.float64]:
    if tone is Tone.GAMMA_1_8:
        return np.asarray(light ** (1 / 1.8))
    if tone is Tone.GAMMA_2_4:
        return np.asarray(light ** (1 / 2.4))
    srgb = np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)
    if tone is Tone.S_CURVE:
        return np.asarray(srgb + 0.08 * np.sin(2 * np.pi * (srgb - 0.5)))
    return srgb
