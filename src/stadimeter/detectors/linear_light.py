"""From code values to light.

A pixel on an edge sees some of the one side and some of the other, and what it collects is light. A picture file does
not hold light: a camera writes each value through a tone curve, so that half the light between black and white becomes
188 of 255, not 128. Half way up in code values is therefore not where the edge is: on a sharp picture it lies about a
third of a pixel inside the brighter side. Measured in light it is.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.camera_model import ToneCurve

Light = NDArray[np.float32]

CODES = 256


@cache
def light_table(tone_curve: ToneCurve) -> Light:
    """Return the light that each code value of 8 bits stands for; ``light_table("srgb")[image]`` decodes a picture.

    Args:
        tone_curve: ``srgb``, which phones and cameras write by default (IEC 61966-2-1), or ``linear`` for a camera
            whose values are in proportion to the light.

    Returns:
        Shape ``(256,)``, rising from 0 for black to 1 for the brightest value. Read-only.
    """
    share = np.arange(CODES, dtype=np.float64) / (CODES - 1)
    if tone_curve == "srgb":
        share = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    table = share.astype(np.float32)
    table.setflags(write=False)
    return table
