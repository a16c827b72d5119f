"""A range of colours, as people write it: ``"29,86,6:64,255,255"``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator

from stadimeter.core.frame import Image

Mask = NDArray[np.uint8]

CHANNELS = (("hue", 179), ("saturation", 255), ("value", 255))
LEAST_CHROMA = 8
"""Where the channels of a pixel differ by fewer levels, their noise decides its hue: black shows every hue."""

DARK_VALUE = 32
"""Where the least saturation of a range reaches that difference at this value or less, all darker pixels are left out,
those that are more saturated too: that needs no look at the saturation of each. Not so for ranges of dark colours."""

EXAMPLE = "29,86,6:64,255,255"


@dataclass(frozen=True, slots=True)
class HsvRange:
    """Colours between two limits, both included.

    Hue runs from 0 to 179, half a degree each, as OpenCV has it; saturation and value from 0 to 255. A lower hue above
    the upper one wraps through 0, which is red: ``"170,120,70:10,255,255"``.

    Attributes:
        lower: Hue, saturation and value of the lower limit.
        upper: Those of the upper limit.
    """

    lower: tuple[int, int, int]
    upper: tuple[int, int, int]

    def mask(self, image: Image) -> Mask:
        """Return which pixels have such a colour.

        Args:
            image: A picture, blue first.

        Returns:
            255 where it has, 0 elsewhere, shape ``(height, width)``. A pixel that is all but grey has no hue, so it
            counts only where every hue does.
        """
        hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
        if (self.lower[0], self.upper[0]) == (0, 179):
            return _between(hsv, self.lower, self.upper)
        least_value = math.ceil(LEAST_CHROMA * 255 / max(self.lower[1], 1))
        if least_value > DARK_VALUE or self.upper[2] < 2 * DARK_VALUE:
            return np.asarray(cv2.bitwise_and(self._between_hues(hsv, self.lower[2]), _has_hue(hsv)), np.uint8)
        return self._between_hues(hsv, max(self.lower[2], least_value))

    def _between_hues(self, hsv: cv2.typing.MatLike, least_value: int) -> Mask:
        """Return which pixels are between the limits, with another lower limit of the value."""
        (low_hue, saturation, _), (high_hue, *most) = self.lower, self.upper
        if low_hue <= high_hue:
            return _between(hsv, (low_hue, saturation, least_value), self.upper)
        below_red = _between(hsv, (low_hue, saturation, least_value), (179, *most))
        above_red = _between(hsv, (0, saturation, least_value), self.upper)
        return np.asarray(cv2.bitwise_or(below_red, above_red), np.uint8)

    def __str__(self) -> str:
        """Return it as it is written."""
        return ":".join(",".join(str(part) for part in limit) for limit in (self.lower, self.upper))


def parse_hsv_range(text: object) -> HsvRange:
    """Read a range of colours such as ``"29,86,6:64,255,255"``.

    Args:
        text: Lower and upper limit, each as hue, saturation and value.

    Returns:
        The range.

    Raises:
        ValueError: It is no such text, or a number is outside its channel.
    """
    if isinstance(text, HsvRange):
        return text
    if not isinstance(text, str):
        raise ValueError(f"{text!r} is not a range of colours; write it as text, such as {EXAMPLE!r}")
    limits = text.split(":")
    if len(limits) != 2:
        raise ValueError(
            f"{text!r} has {len(limits)} limits, not 2; write the lower and the upper one such as {EXAMPLE!r}"
        )
    lower, upper = (_parse_limit(limit, text) for limit in limits)
    for (name, _), low, high in zip(CHANNELS[1:], lower[1:], upper[1:], strict=True):
        if low > high:
            raise ValueError(f"{text!r}: the lower {name} {low} is above the upper one {high}, so no colour fits")
    return HsvRange(lower, upper)


def _parse_limit(limit: str, text: str) -> tuple[int, int, int]:
    parts = limit.split(",")
    if len(parts) != 3:
        raise ValueError(
            f"{text!r}: {limit!r} has {len(parts)} numbers, not 3 for hue, saturation and value, such as {EXAMPLE!r}"
        )
    numbers = []
    for part, (name, most) in zip(parts, CHANNELS, strict=True):
        number = part.strip()
        if not (number.isascii() and number.removeprefix("-").isdigit()):
            raise ValueError(f"{text!r}: {name} {number!r} is not a whole number")
        if not 0 <= int(number) <= most:
            raise ValueError(f"{text!r}: {name} {number} is outside 0 to {most}")
        numbers.append(int(number))
    return numbers[0], numbers[1], numbers[2]


def _has_hue(hsv: cv2.typing.MatLike) -> cv2.typing.MatLike:
    """Return where the channels differ by `LEAST_CHROMA` levels: saturation is their difference as a share of value."""
    chroma = cv2.multiply(cv2.extractChannel(hsv, 1), cv2.extractChannel(hsv, 2), scale=1 / 255)
    return cv2.threshold(chroma, LEAST_CHROMA - 1, 255, cv2.THRESH_BINARY)[1]


def _between(hsv: cv2.typing.MatLike, lower: tuple[int, ...], upper: tuple[int, ...]) -> Mask:
    return np.asarray(cv2.inRange(hsv, lower, upper), np.uint8)


HsvRangeText = Annotated[HsvRange, BeforeValidator(parse_hsv_range)]
