"""Boxes of a network: how a picture is fitted to its input, and which of many boxes are one thing each.

A network's coordinates begin at the outer edge of its first pixel, so pixel i reaches from i to i + 1. Those of a
picture begin at the centre of that pixel, half a pixel further in.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from stadimeter.core.detection import Indices, Points, Values
from stadimeter.core.frame import Image

# Boxes that share more of their common area than this are one thing: the usual limit of all five families.
MAX_OVERLAP = 0.45

# Only so many of the likeliest boxes are compared. A crowd of a hundred has some thousand, most of one thing each.
MAX_BOXES = 300

# Below this scale the mean of all pixels is taken; above it four neighbours do, in a third of the time.
MEAN_BELOW = 0.5


class Boxes(NamedTuple):
    """Boxes with the score of each.

    Attributes:
        corners: Left, top, right and bottom, shape ``(n, 4)``.
        scores: How sure the network is of each, 0 to 1, shape ``(n,)``.
        eyes: Of faces, where both eyes are, shape ``(n, 2, 2)``; None of other things.
    """

    corners: Values
    scores: Values
    eyes: Points | None = None

    def take(self, which: Indices) -> Boxes:
        """Return some of them, in this order."""
        return Boxes(self.corners[which], self.scores[which], None if self.eyes is None else self.eyes[which])


class FittedPicture(NamedTuple):
    """A picture in the upper left of a network's input; what is left over is filled with one level."""

    image: Image
    scale_x: float
    scale_y: float

    def in_picture(self, boxes: Boxes) -> Boxes:
        """Return boxes in the pixels of the picture."""
        scale = np.array((self.scale_x, self.scale_y))
        corners = boxes.corners.reshape(-1, 2, 2) / scale - 0.5
        eyes = None if boxes.eyes is None else boxes.eyes / scale - 0.5
        return Boxes(corners.reshape(-1, 4), boxes.scores, eyes)


def fit_picture(image: Image, width: int, height: int, fill: int) -> FittedPicture:
    """Scale a picture to a network's input without changing its aspect."""
    rows, columns = image.shape[:2]
    scale = min(width / columns, height / rows)
    inner = min(width, max(1, round(columns * scale))), min(height, max(1, round(rows * scale)))
    how = cv2.INTER_AREA if scale < MEAN_BELOW else cv2.INTER_LINEAR
    small = np.asarray(cv2.resize(image, inner, interpolation=how), np.uint8)
    if inner != (width, height):
        around = height - inner[1], width - inner[0]
        small = np.asarray(
            cv2.copyMakeBorder(small, 0, around[0], 0, around[1], cv2.BORDER_CONSTANT, value=(fill, fill, fill)),
            np.uint8,
        )
    return FittedPicture(small, inner[0] / columns, inner[1] / rows)


def centred(centres: Points, sizes: Points) -> Values:
    """Return the corners of boxes by centre and size, both of shape ``(n, 2)``."""
    return np.hstack((centres - sizes / 2, centres + sizes / 2))


def one_each(boxes: Boxes) -> Boxes:
    """Return the likeliest box of each thing, the likeliest first: non-maximum suppression.

    A box is left out if its overlap with a likelier one, the area that both cover as a share of the area that either
    covers, is above `MAX_OVERLAP`. Boxes that are no numbers, or have no area, are left out too.
    """
    sides = boxes.corners[:, 2:] - boxes.corners[:, :2]
    usable = np.flatnonzero(np.isfinite(boxes.corners).all(axis=1) & (sides > 0).all(axis=1))
    # Stable, so that of equal scores the first box comes first on every machine.
    rest = usable[np.argsort(-boxes.scores[usable], kind="stable")][:MAX_BOXES]
    kept = []
    while len(rest):
        kept.append(rest[0])
        rest = rest[1:][overlaps(boxes.corners[rest[0]], boxes.corners[rest[1:]]) <= MAX_OVERLAP]
    return boxes.take(np.array(kept, np.intp))


def overlaps(one: Values, others: Values) -> Values:
    """Return the overlap of a box with each of others, 0 to 1: intersection over union."""
    low, high = np.maximum(one[:2], others[:, :2]), np.minimum(one[2:], others[:, 2:])
    common = (high - low).clip(0.0).prod(axis=1)
    areas = (others[:, 2:] - others[:, :2]).prod(axis=1)
    return np.asarray(common / (np.prod(one[2:] - one[:2]) + areas - common))
