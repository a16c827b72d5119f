"""Ranges of colours, such as ``"29,86,6:64,255,255"``: which pixels have a target's colour, and ranges for a place.

A range around a place in a picture covers the pixels there with a margin. It grows with the patch of connected pixels
that it covers, since light and shade change a colour across a thing. How far it should grow no pixel tells:
`stadimeter.detectors.ball.colour_proposal` tries narrow and wide ones.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from typing import Annotated

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from pydantic import BeforeValidator, InstanceOf

from stadimeter.core.detection import Values
from stadimeter.core.frame import Image

Mask = NDArray[np.uint8]

# The channels as OpenCV has them, each with its highest value.
CHANNELS = (("hue", 179), ("saturation", 255), ("value", 255))

# Where the channels of a pixel differ by fewer levels, their noise decides its hue: black shows every hue.
MIN_CHROMA = 8

# Where the least saturation of a range reaches that difference at this value or less, all darker pixels are left out,
# those that are more saturated too: that needs no look at the saturation of each. Not so for ranges of dark colours.
DARK_VALUE = 32

# How many more hues a thing may have to either side in other light, and which shares of the least saturation and value:
# glare leaves a third of the saturation of a tennis ball whose colour was taken indoors.
HUES_OF_LIGHT, PALER, DARKER = 5, 0.33, 0.5

# Up to this many are converted as one row, which saves OpenCV what it spends on each: two thirds at 80 by 60. More may
# be spread over several threads, by rows.
FEW_PIXELS = 1 << 16

EXAMPLE = "29,86,6:64,255,255"


class HsvRange(Struct, frozen=True):
    """Colours between two limits, both included.

    Hue runs from 0 to 179, half a degree each, as OpenCV has it; saturation and value from 0 to 255. A lower hue above
    the upper one wraps through 0, which is red: ``"170,120,70:10,255,255"``.
    """

    lower: tuple[int, int, int]
    upper: tuple[int, int, int]

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
        if min_value > DARK_VALUE or self.upper[2] < 2 * DARK_VALUE:
            return np.asarray(cv2.bitwise_and(self._between_hues(hsv, self.lower[2]), _has_hue(hsv)), np.uint8)
        return self._between_hues(hsv, max(self.lower[2], min_value))

    def covers(self, hsv: Image) -> Mask:
        """Return which pixels of a picture in hue, saturation and value are between the limits, grey ones included."""
        return self._between_hues(hsv, self.lower[2])

    @property
    def in_other_light(self) -> HsvRange:
        """The colours that such a thing may have in other light: paler in the glare, darker in the shade."""
        _, saturation, value = self.lower
        wider = widen(self, HUES_OF_LIGHT)
        return HsvRange((wider.lower[0], int(PALER * saturation), int(DARKER * value)), wider.upper)

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
            raise ValueError(f"{text!r}: {name} {number!r} is not a whole number{_in_other_units(number, most)}")
        if not 0 <= int(number) <= most:
            raise ValueError(f"{text!r}: {name} {number} is outside 0 to {most}{_in_other_units(number, most)}")
        numbers.append(int(number))
    return numbers[0], numbers[1], numbers[2]


def _in_other_units(number: str, most: int) -> str:
    """Return the meaning of a number that other programs give in degrees or per cent, as it is to be written here."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(%|°|deg)?", number)
    if found is None or (most == CHANNELS[0][1]) is (found[2] == "%"):
        return ""
    if most == CHANNELS[0][1] and float(found[1]) <= 360:
        return (
            f": a hue of {found[1]} degrees is {round(float(found[1]) / 2) % 180}, since half the degrees are counted"
        )
    return f": {found[1]} % of {most} are {round(float(found[1]) / 100 * most)}" if found[2] == "%" else ""


def _hsv(image: Image) -> cv2.typing.MatLike:
    if image.size > 3 * FEW_PIXELS:
        return cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
    return cv2.cvtColor(image.reshape(1, -1, 3), cv2.COLOR_BGR2HSV).reshape(image.shape)


def _has_hue(hsv: cv2.typing.MatLike) -> cv2.typing.MatLike:
    """Return where the channels differ by `MIN_CHROMA` levels: saturation is their difference as a share of value."""
    chroma = cv2.multiply(cv2.extractChannel(hsv, 1), cv2.extractChannel(hsv, 2), scale=1 / 255)
    return cv2.threshold(chroma, MIN_CHROMA - 1, 255, cv2.THRESH_BINARY)[1]


def _between(hsv: cv2.typing.MatLike, lower: tuple[int, ...], upper: tuple[int, ...]) -> Mask:
    return np.asarray(cv2.inRange(hsv, lower, upper), np.uint8)


HsvRangeText = Annotated[InstanceOf[HsvRange], BeforeValidator(parse_hsv_range)]


# Where something is in a picture: x and y in pixels.
Place = tuple[float, float]

# Hue, saturation and value of pixels, shape ``(n, 3)``.
Colours = NDArray[np.float64]

# Hues on either side of those that were seen, and those that each step of the margin adds.
MARGINS = (1, 2, 3, 4, 5, 6)
HUE_MARGIN, HUE_OF_MARGIN = 2.0, 2.0

# Share that the least saturation and value go down by for each step of the margin: a ball is darker on one side.
LESS_OF_MARGIN = 0.1

# Where the channels of most pixels differ by fewer levels, the thing is grey, white or black: every hue counts.
GREY_CHROMA = 24.0

# Each step of the margin adds this to grey: levels of saturation, and a share of the value.
GREY_SATURATION, GREY_VALUE = 12.0, 0.08

# A patch that is larger than this share of the picture is the background.
SEEN_PERCENT = (2.0, 98.0)
MAX_PICTURE_SHARE = 0.4

GROWTHS = 3
MAX_COLOURS = 20_000

HUES = np.arange(180.0)

# How far around a place its colour is taken from, as a share of the picture's width.
REACH_OF_WIDTH = 1 / 320

# So many times as far around, the most vivid pixels are the ball's own colour where the place is on a stripe.
VIVID_REACHES, VIVID_PERCENT = 4, 60.0


def smooth(image: Image) -> Image:
    """Return hue, saturation and value of a picture without the grain of sensor and surface."""
    sigma_px = max(0.8, image.shape[1] / 800)
    return np.asarray(cv2.cvtColor(cv2.GaussianBlur(image, (0, 0), sigma_px), cv2.COLOR_BGR2HSV), np.uint8)


def ranges_at(hsv: Image, place: Place) -> Iterator[HsvRange]:
    """Yield ranges of the colour at a place of a smoothed picture, narrow ones first."""
    rows, columns = _around(hsv, place, _reach_px(hsv))
    yield from _grow(hsv, place, _colours(hsv[rows, columns]))


def vivid_ranges_at(hsv: Image, place: Place) -> Iterator[HsvRange]:
    """Yield ranges of the most vivid colour near a place, which itself may be on a pale stripe, a seam or a gloss."""
    rows, columns = _around(hsv, place, VIVID_REACHES * _reach_px(hsv))
    near = _colours(hsv[rows, columns])
    # Saturation times value is the chroma (the difference between the largest and the smallest channel) times 255: dark
    # pixels have a high saturation of no meaning.
    chroma = near[:, 1] * near[:, 2]
    row, column = divmod(int(np.argmax(chroma)), columns.stop - columns.start)
    vivid = near[chroma >= np.percentile(chroma, VIVID_PERCENT)]
    yield from _grow(hsv, (columns.start + column, rows.start + row), vivid)


def join_ranges(ranges: Sequence[HsvRange]) -> HsvRange:
    """Return the narrowest range that covers several."""
    middles, reaches = zip(*(_hues(each) for each in ranges), strict=True)
    middle = _mean_hue(np.array(middles), np.ones(len(middles)))
    # Hues are on a circle of 180 (OpenCV's unit of two degrees): they are compared about a common middle, so that reds
    # on both sides of 0 stay together.
    away = [_hues_apart(each, middle) for each in middles]
    low = min(each - reach for each, reach in zip(away, reaches, strict=True))
    high = max(each + reach for each, reach in zip(away, reaches, strict=True))
    least = [min(each.lower[channel] for each in ranges) for channel in (1, 2)]
    most = [max(each.upper[channel] for each in ranges) for channel in (1, 2)]
    return _range(middle + low, middle + high, (least[0], least[1]), (most[0], most[1]))


def widen(colour: HsvRange, hues: int) -> HsvRange:
    """Return a range with more hues at both ends."""
    middle, reach = _hues(colour)
    return _range(middle - reach - hues, middle + reach + hues, colour.lower[1:], colour.upper[1:])


def _grow(hsv: Image, place: Place, seen: Colours) -> Iterator[HsvRange]:
    tried = set()
    for margin in MARGINS:
        colours = seen
        for _ in range(GROWTHS):
            colour = _cover(colours, margin)
            patch = None if colour in tried else _patch(hsv, colour, place)
            if patch is None:
                break
            tried.add(colour)
            yield colour
            # The next round takes the colours of the whole patch, which holds more of the light and shade.
            colours = patch


def _cover(colours: Colours, margin: int) -> HsvRange:
    """Return the range of these colours with a margin."""
    hues, saturations, values = colours.T
    (min_saturation, max_saturation), (min_value, max_value) = (
        np.percentile(each, SEEN_PERCENT) for each in (saturations, values)
    )
    if min_saturation * np.median(values) / 255 < GREY_CHROMA:
        more = 1 + GREY_VALUE * margin
        least, most = (0.0, min_value * (2 - more)), (max_saturation + GREY_SATURATION * margin, max_value * more)
        return _range(0.0, 179.0, least, most)
    # Hues weighted by chroma: the hue of a grey pixel is noise.
    middle = _mean_hue(
        HUES, np.bincount(hues.astype(np.intp), saturations * values, minlength=len(HUES)).astype(np.float64)
    )
    # Percentiles, not extremes: 2 % of the pixels on either side may be the rim, a gloss or a scratch.
    low, high = np.percentile(_hues_apart(hues, middle), SEEN_PERCENT)
    further, less = HUE_MARGIN + HUE_OF_MARGIN * margin, 1 - LESS_OF_MARGIN * margin
    least = (min_saturation * less, min_value * less)
    return _range(middle + low - further, middle + high + further, least, (255.0, 255.0))


def _range(low: float, high: float, least: tuple[float, ...], most: tuple[float, ...]) -> HsvRange:
    """Return a range of hues from low to high, which may be beyond red on either side."""
    hues = (0, 179) if high - low >= 170 else (round(low) % 180, round(high) % 180)
    saturation, value = (max(0, int(each)) for each in least)
    max_saturation, max_value = (min(255, math.ceil(each)) for each in most)
    return HsvRange((hues[0], saturation, value), (hues[1], max_saturation, max_value))


def _hues(colour: HsvRange) -> tuple[float, float]:
    """Return the middle of a range's hues, and how far it reaches from there."""
    low, high = colour.lower[0], colour.upper[0]
    high += 180 if high < low else 0
    return (low + high) / 2, (high - low) / 2


def _mean_hue(hues: Values, weights: Values) -> float:
    """Return the mean of hues on their circle."""
    angles = hues * (np.pi / 90)
    return math.atan2(float(weights @ np.sin(angles)), float(weights @ np.cos(angles))) * 90 / math.pi


def _hues_apart(hues: Values, middle: float) -> Values:
    """Return the distance of hues from another, the shorter way round: from -90 to 90."""
    return np.asarray((hues - middle + 90) % 180 - 90)


def _patch(hsv: Image, colour: HsvRange, place: Place) -> Colours | None:
    """Return the colours of the connected pixels in a range at a place; None if there are none, or for the background.

    Of many, some are taken.
    """
    mask = colour.covers(hsv)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    rows, columns = _around(hsv, place, _reach_px(hsv))
    # The component that most pixels around the place belong to: the place itself may be a speck.
    here = labels[rows, columns]
    here = here[here > 0]
    if not here.size:
        return None
    label = int(np.bincount(here).argmax())
    area_px2 = int(stats[label, cv2.CC_STAT_AREA])
    if area_px2 > MAX_PICTURE_SHARE * mask.size:
        return None
    left, top, width, height = stats[label, : cv2.CC_STAT_AREA].tolist()
    part = (slice(top, top + height), slice(left, left + width))
    return _colours(hsv[part][labels[part] == label][:: 1 + area_px2 // MAX_COLOURS])


def _reach_px(hsv: Image) -> int:
    return max(2, round(int(hsv.shape[1]) * REACH_OF_WIDTH))


def _around(hsv: Image, place: Place, reach_px: int) -> tuple[slice, slice]:
    """Return the rows and the columns of the square around a place, as far as it is in the picture."""
    x_px, y_px = (round(each) for each in place)
    rows = slice(max(0, y_px - reach_px), min(hsv.shape[0], y_px + reach_px + 1))
    return rows, slice(max(0, x_px - reach_px), min(hsv.shape[1], x_px + reach_px + 1))


def _colours(pixels: Image) -> Colours:
    return pixels.reshape(-1, 3).astype(np.float64)
