"""Ranges of colours around a place in a picture: what belongs to the thing there, drawn up narrow and wide.

A range covers the pixels around the place with a margin. It grows with the patch of connected pixels that it covers,
since light and shade change a colour across a thing. How far it should grow no pixel tells: `colour_proposal` tries
them all.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.frame import Image
from stadimeter.detectors.hsv import HsvRange

# Where something is in a picture: x and y in pixels.
Place = tuple[float, float]

# Hue, saturation and value of pixels, shape ``(n, 3)``.
Colours = NDArray[np.float64]

# Hues on either side of those that were seen, and those that each step of the margin adds.
MARGINS = (1, 2, 3, 4, 5, 6)
HUE_MARGIN, HUE_OF_MARGIN = 2.0, 2.0

# Share that the least saturation and value go down by for each step of the margin: a ball is darker on one side.
LESS_OF_MARGIN = 0.1

# The same for each step by which a person widens a range, and as much more where it is made narrower.
LESS_OF_STEP = 0.06

# Where the channels of most pixels differ by fewer levels, the thing is grey, white or black: every hue counts.
MIN_CHROMA = 24.0

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


def loosen(colour: HsvRange, steps: int) -> HsvRange:
    """Return a range that covers more colours in every direction, or fewer for negative steps; never none."""
    saturation, value = (min(round(each * (1 - LESS_OF_STEP * steps)), 255) for each in colour.lower[1:])
    if (colour.lower[0], colour.upper[0]) == (0, 179):
        most = (colour.upper[1] + GREY_SATURATION * steps, colour.upper[2] * (1 + LESS_OF_STEP * steps))
        return _range(0.0, 179.0, (0.0, min(value, colour.upper[2])), (max(GREY_SATURATION, most[0]), most[1]))
    middle, reach = _hues(colour)
    reach = max(HUE_MARGIN, reach + steps)
    least = (min(saturation, colour.upper[1]), min(value, colour.upper[2]))
    return _range(middle - reach, middle + reach, least, colour.upper[1:])


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
    if min_saturation * np.median(values) / 255 < MIN_CHROMA:
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


def _mean_hue(hues: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """Return the mean of hues on their circle."""
    angles = hues * (np.pi / 90)
    return math.atan2(float(weights @ np.sin(angles)), float(weights @ np.cos(angles))) * 90 / math.pi


def _hues_apart(hues: NDArray[np.float64], middle: float) -> NDArray[np.float64]:
    """Return how far hues are from another, the shorter way round: from -90 to 90."""
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
