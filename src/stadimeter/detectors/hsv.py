"""Ranges of colours, such as ``"29,86,6:64,255,255"``: which pixels have a target's colour."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator

from stadimeter.core.frame import Image

Mask = NDArray[np.uint8]

# The channels as OpenCV has them, each with its highest value.
CHANNELS = (("hue", 179), ("saturation", 255), ("value", 255))

# Where the channels of a pixel differ by fewer levels, their noise decides its hue: black shows every hue.
MIN_CHROMA = 8

# Where the least saturation of a range reaches that difference at this value or less, all darker pixels are left out,
# those that are more saturated too: that needs no look at the saturation of each. Not so for ranges of dark colours,
# nor where nothing else is found.
DARK_VALUE = 32

# Pixels that are dark are looked at if there are as many more of them with the colour: by this factor, and number.
MORE_OF_DARK, MIN_OF_DARK = 1.1, 4

# Among fewer pixels there is nothing to tell apart.
MIN_TOLD_APART = 64

# Up to this many are converted as one row, which saves OpenCV what it spends on each: two thirds at 80 by 60. More may
# be spread over several threads, by rows.
FEW_PIXELS = 1 << 16

EXAMPLE = "29,86,6:64,255,255"


@dataclass(frozen=True, slots=True)
class HsvRange:
    """Colours between two limits, both included.

    Hue runs from 0 to 179, half a degree each, as OpenCV has it; saturation and value from 0 to 255. A lower hue above
    the upper one wraps through 0, which is red: ``"170,120,70:10,255,255"``.
    """

    lower: tuple[int, int, int]
    upper: tuple[int, int, int]
    # Whether pixels count that are dark, but saturated enough to have a hue, which takes a look at each.
    keeps_dark: bool = False

    def mask(self, image: Image) -> Mask:
        """Return which pixels have such a colour: 255 where one has, 0 elsewhere, shape ``(height, width)``.

        A pixel that is all but grey has no hue, so it counts only where every hue does.
        """
        hsv = _hsv(image)
        if (self.lower[0], self.upper[0]) == (0, 179):
            return _between(hsv, self.lower, self.upper)
        # From this value on every pixel of the range has a hue, since its chroma is at least saturation * value / 255.
        # That limit costs less than the chroma of each pixel, but leaves out darker pixels that are more saturated.
        min_value = math.ceil(MIN_CHROMA * 255 / max(self.lower[1], 1))
        if self.keeps_dark or min_value > DARK_VALUE or self.upper[2] < 2 * DARK_VALUE:
            return np.asarray(cv2.bitwise_and(self._between_hues(hsv, self.lower[2]), _has_hue(hsv)), np.uint8)
        return self._between_hues(hsv, max(self.lower[2], min_value))

    def covers(self, hsv: Image) -> Mask:
        """Return which pixels of a picture in hue, saturation and value are between the limits, grey ones included."""
        return self._between_hues(hsv, self.lower[2])

    def _between_hues(self, hsv: cv2.typing.MatLike, min_value: int) -> Mask:
        """Return which pixels are between the limits, with another lower limit of the value."""
        (low_hue, saturation, _), (high_hue, *most) = self.lower, self.upper
        if low_hue <= high_hue:
            return _between(hsv, (low_hue, saturation, min_value), self.upper)
        below_red = _between(hsv, (low_hue, saturation, min_value), (179, *most))
        above_red = _between(hsv, (0, saturation, min_value), self.upper)
        return np.asarray(cv2.bitwise_or(below_red, above_red), np.uint8)

    def __str__(self) -> str:
        """Return it as it is written."""
        return ":".join(",".join(str(part) for part in limit) for limit in (self.lower, self.upper))


def parse_hsv_range(text: object) -> HsvRange:
    """Read a range of colours such as ``"29,86,6:64,255,255"``: lower and upper limit of hue, saturation and value.

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
    if (lower[0], upper[0]) != (0, 179) and round(upper[1] * upper[2] / 255) < MIN_CHROMA:
        raise ValueError(
            f"{text!r}: all that is at most so saturated and bright is grey, which has no hue, so no colour fits; "
            f"raise the upper saturation {upper[1]} or the upper value {upper[2]}, or let every hue count, 0 to 179"
        )
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


def _hsv(image: Image) -> cv2.typing.MatLike:
    """Return hue, saturation and value of each pixel."""
    if image.size > 3 * FEW_PIXELS:
        return cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
    return cv2.cvtColor(image.reshape(1, -1, 3), cv2.COLOR_BGR2HSV).reshape(image.shape)


def _has_hue(hsv: cv2.typing.MatLike) -> cv2.typing.MatLike:
    """Return where the channels differ by `MIN_CHROMA` levels: saturation is their difference as a share of value."""
    chroma = cv2.multiply(cv2.extractChannel(hsv, 1), cv2.extractChannel(hsv, 2), scale=1 / 255)
    return cv2.threshold(chroma, MIN_CHROMA - 1, 255, cv2.THRESH_BINARY)[1]


def _between(hsv: cv2.typing.MatLike, lower: tuple[int, ...], upper: tuple[int, ...]) -> Mask:
    return np.asarray(cv2.inRange(hsv, lower, upper), np.uint8)


HsvRangeText = Annotated[HsvRange, BeforeValidator(parse_hsv_range)]


def other_ranges(image: Image, colour: HsvRange) -> Iterator[HsvRange]:
    """Yield ranges that may show a ball where its own shows none.

    First with the darkest pixels. Then the more saturated of the pixels in the range, and the brighter of them: a range
    that holds the ball may hold the floor or a hand as well, but hardly anything is exactly as vivid.
    """
    mask, with_dark = colour.mask(image), replace(colour, keeps_dark=True)
    if cv2.countNonZero(with_dark.mask(image)) > MORE_OF_DARK * cv2.countNonZero(mask) + MIN_OF_DARK:
        yield with_dark
    pixels = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)[mask > 0]
    if len(pixels) < MIN_TOLD_APART:
        return
    for channel in (1, 2):
        least, _ = cv2.threshold(pixels[None, :, channel].copy(), 0, 255, cv2.THRESH_OTSU)
        lower = list(colour.lower)
        lower[channel] = max(lower[channel], int(least) + 1)
        yield replace(colour, lower=(lower[0], lower[1], lower[2]))
