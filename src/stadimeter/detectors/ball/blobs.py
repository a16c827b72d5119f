"""Blobs of a range of colours, such as ``"29,86,6:64,255,255"``: where in a picture a ball may be.

Most of a picture is not the ball, so only every fourth pixel or so is looked at. Leaving out pixels, not averaging
them, costs a thirteenth of a proper reduction, and each pixel that is left keeps its colour. How large the ball is
comes later, from all pixels along its limb.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator

from stadimeter.core.detection import Points
from stadimeter.core.frame import Image
from stadimeter.detectors.ball.circles import Circle
from stadimeter.detectors.region import Region

Mask = NDArray[np.uint8]

SMALLEST_SEARCHED_RADIUS_PX = 1.25
"""Pixels are left out only as long as the smallest accepted ball still has this radius in what remains."""

GREATEST_STEP = 8

MOST_BLOBS = 16
"""Number of blobs that are looked at: the largest."""

MOST_POINTS = 60
"""Number of points of an outline, evenly spaced, used where fewer will do."""

PATCH_GAP, LEAST_PATCH = 0.5, 0.25
"""Greatest gap between two patches of one ball, and least size of the smaller one, as shares of the larger's size."""

GRID = 16
"""Pixels each way from which the share of a circle with the ball's colour is estimated."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Blob:
    """Pixels of the ball's colour that hang together, or several such patches of one ball."""

    circle: Circle  # the circle around which its limb may be: as wide or as high as the blob, whichever is more
    contours: tuple[cv2.typing.MatLike, ...]  # its outlines as OpenCV has them, in pixels of the thinned picture
    mask: Mask  # which pixels in the box of the first of them have the ball's colour
    coloured_px2: float  # area of these
    step: int  # every step-th pixel of the picture was looked at
    origin_px: tuple[int, int]  # where the thinned part begins in the picture, x and y

    @property
    def size_px(self) -> float:
        """The larger of its width and its height."""
        return 2 * self.circle.radius_px

    @property
    def area_px2(self) -> float:
        """The area within its outlines."""
        return sum(map(cv2.contourArea, self.contours)) * self.step**2

    @property
    def inscribed(self) -> Circle:
        """The largest circle of its pixels: the ball, where other things of its colour touch it."""
        x, y, _, _ = cv2.boundingRect(self.contours[0])
        # The median leaves out single pixels, and what is beyond the box counts as another colour.
        solid = cv2.copyMakeBorder(cv2.medianBlur(self.mask, 3), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
        _, radius, _, (column, row) = cv2.minMaxLoc(cv2.distanceTransform(solid, cv2.DIST_L2, cv2.DIST_MASK_5))
        (left, top), step = self.origin_px, self.step
        return Circle(
            x_px=left + (x + column - 1) * step, y_px=top + (y + row - 1) * step, radius_px=float(radius) * step
        )

    @property
    def outline_px(self) -> Points:
        """Points along its outlines, shape ``(n, 2)``."""
        points = np.concatenate(self.contours) if len(self.contours) > 1 else self.contours[0]
        return np.asarray(points, np.float64).reshape(-1, 2) * self.step + self.origin_px

    @property
    def thinned_px(self) -> Points:
        """No more than `MOST_POINTS` points of its outlines, evenly spaced."""
        outline_px = self.outline_px
        return outline_px[:: max(1, math.ceil(len(outline_px) / MOST_POINTS))]


def search_step(min_radius_px: float) -> int:
    """Return the k of "every k-th pixel"."""
    return max(1, min(GREATEST_STEP, int(min_radius_px / SMALLEST_SEARCHED_RADIUS_PX)))


def find_blobs(image: Image, colour: HsvRange, step: int, region: Region | None = None) -> list[Blob]:
    """Find the largest blobs of a colour, `MOST_BLOBS` at most, the largest first; looks at every step-th pixel."""
    region = region or Region.whole(image)
    mask = colour.mask(thinned(region.of(image), step))
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if len(contours) > MOST_BLOBS:
        # Of texture, blobs are wide but thin; that of a ball is solid.
        contours = sorted(contours, key=cv2.contourArea, reverse=True)[:MOST_BLOBS]
    boxed = [(contour, cv2.boundingRect(contour)) for contour in contours]
    boxed.sort(key=lambda pair: (-max(pair[1][2:]), pair[1]))
    return [_blob(contour, box, mask, step, (region.left, region.top)) for contour, box in boxed]


def together(blobs: Sequence[Blob], most: int) -> list[Blob]:
    """Return each of the largest blobs with those near it as one: stripes part a ball into patches."""
    found: list[Blob] = []
    for blob in blobs[:most]:
        patches = [each for each in blobs if _may_be_one(blob, each)]
        if len(patches) > 1 and not any(blob.contours[0] is known for one in found for known in one.contours):
            found.append(_joined(patches))
    return found


def _may_be_one(blob: Blob, other: Blob) -> bool:
    """Return whether a blob and one that is no larger may be patches of the same ball."""
    one, two = blob.circle, other.circle
    gap_px = math.hypot(one.x_px - two.x_px, one.y_px - two.y_px) - one.radius_px - two.radius_px
    return gap_px < PATCH_GAP * one.radius_px and LEAST_PATCH * one.radius_px <= two.radius_px <= one.radius_px


def _joined(patches: Sequence[Blob]) -> Blob:
    circles = [patch.circle for patch in patches]
    left, right = (min(c.x_px - c.radius_px for c in circles), max(c.x_px + c.radius_px for c in circles))
    top, bottom = (min(c.y_px - c.radius_px for c in circles), max(c.y_px + c.radius_px for c in circles))
    return Blob(
        circle=Circle(x_px=(left + right) / 2, y_px=(top + bottom) / 2, radius_px=max(right - left, bottom - top) / 2),
        contours=tuple(contour for patch in patches for contour in patch.contours),
        mask=patches[0].mask,
        coloured_px2=sum(patch.coloured_px2 for patch in patches),
        step=patches[0].step,
        origin_px=patches[0].origin_px,
    )


def thinned(image: Image, step: int) -> Image:
    """Return every k-th pixel of every k-th row."""
    if step == 1:
        return image
    height, width = image.shape[:2]
    # OpenCV's nearest neighbour takes the first pixel of each cell, and is four times as fast as slicing and copying.
    whole = image[: height - height % step or height, : width - width % step or width]
    size = (max(1, width // step), max(1, height // step))
    return np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_NEAREST), np.uint8)


def colour_share(image: Image, circle: Circle, colour: HsvRange) -> float:
    """Return how much of a circle has a colour, 0 to 1, from a grid of the pixels in its inner square."""
    half_px = max(1.0, circle.radius_px * math.sqrt(0.5))
    left, top = max(int(circle.x_px - half_px), 0), max(int(circle.y_px - half_px), 0)
    right, bottom = max(int(circle.x_px + half_px + 1), 0), max(int(circle.y_px + half_px + 1), 0)
    part = image[top:bottom, left:right]
    if part.size == 0:
        return 0.0
    grid = np.asarray(cv2.resize(part, (GRID, GRID), interpolation=cv2.INTER_NEAREST), np.uint8)
    return cv2.countNonZero(colour.mask(grid)) / (GRID * GRID)


def colour_share_beside(image: Image, points_px: Points, centre_px: Points, off_px: float, colour: HsvRange) -> float:
    """Return at how many of the points, this much further from a centre, a colour is seen: 0 to 1."""
    out = points_px - centre_px
    out *= 1 + off_px / np.maximum(np.hypot(out[:, :1], out[:, 1:]), 1.0)
    places = np.rint(np.nan_to_num(centre_px + out))
    inside = ((places >= 0) & (places < (image.shape[1], image.shape[0]))).all(axis=1)
    x, y = places[inside].astype(np.intp).T
    return cv2.countNonZero(colour.mask(image[None, y, x])) / len(points_px) if len(x) else 0.0


def _blob(contour: cv2.typing.MatLike, box: cv2.typing.Rect, mask: Mask, step: int, origin_px: tuple[int, int]) -> Blob:
    (x, y, width, height), (left, top) = box, origin_px
    # The pixel that was looked at is the first of its cell; the blob reaches half a cell beyond it on average.
    circle = Circle(
        x_px=left + (x + (width - 1) / 2) * step,
        y_px=top + (y + (height - 1) / 2) * step,
        radius_px=max(width, height) * step / 2,
    )
    part = mask[y : y + height, x : x + width]
    return Blob(
        circle=circle,
        contours=(contour,),
        mask=part,
        coloured_px2=cv2.countNonZero(part) * step**2,
        step=step,
        origin_px=origin_px,
    )


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
    """

    lower: tuple[int, int, int]
    upper: tuple[int, int, int]

    def mask(self, image: Image) -> Mask:
        """Return which pixels have such a colour: 255 where one has, 0 elsewhere, shape ``(height, width)``.

        A pixel that is all but grey has no hue, so it counts only where every hue does.
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
