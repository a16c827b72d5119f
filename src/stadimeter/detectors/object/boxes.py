"""Boxes of a network: how a picture is fitted to its input, and which of many boxes are one thing each.

A network's coordinates begin at the outer edge of its first pixel, so pixel i reaches from i to i + 1. Those of a
picture begin at the centre of that pixel, half a pixel further in.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Indices, Points, Values
from stadimeter.core.frame import Image

# The meaning of the outputs of YOLOX, YOLOv8 and NanoDet-Plus: a row of figures for each cell of grids over the
# input.
#
# A grid of stride s has a cell for each s by s pixels of the input, row by row; the grids of a family follow each
# other, the finest first. Every function takes the outputs of one picture and returns boxes in pixels of the input,
# with the scores of one class where no other class scores higher.

Outputs = Sequence[NDArray[np.float32]]

STRIDES = (8, 16, 32)
NANODET_STRIDES = (8, 16, 32, 64)

# NanoDet-Plus gives the distance to each side as the probabilities of 0 to 7 strides.
DISTANCE_BINS = 8

# exp() of more than this is a box of a thousand cells.
MAX_LOG_SIZE = 7.0


class WantedClass(NamedTuple):
    """The class to look for in the outputs: by its number, from a score on, in an input of this size."""

    number: int
    min_score: float
    width: int
    height: int


def count_cells(width: int, height: int, strides: Sequence[int]) -> int:
    """Count the cells that the grids of an input have."""
    return sum(-(-width // stride) * -(-height // stride) for stride in strides)


@lru_cache(maxsize=8)
def grid_cells(width: int, height: int, strides: tuple[int, ...]) -> tuple[Points, Values]:
    """Return column and row of each cell, shape ``(n, 2)``, and its stride, shape ``(n,)``; not to be changed."""
    cells, sizes = [], []
    for stride in strides:
        rows, columns = np.mgrid[: -(-height // stride), : -(-width // stride)]
        cells.append(np.column_stack((columns.ravel(), rows.ravel())).astype(np.float64))
        sizes.append(np.full(rows.size, float(stride)))
    return np.concatenate(cells), np.concatenate(sizes)


def decode_yolox(outputs: Outputs, wanted: WantedClass) -> Boxes:
    """Read ``(1, n, 5 + classes)``: offset in the cell, logarithm of the size, probability of a thing, classes.

    Z. Ge et al., "YOLOX: Exceeding YOLO Series in 2021", arXiv 2107.08430: centre = (cell + offset) · stride,
    size = exp(figure) · stride, score = probability of a thing · probability of the class.
    """
    rows = outputs[0][0]
    which, scores = _likely(rows[:, 5:], wanted, rows[:, 4])
    cells, strides = grid_cells(wanted.width, wanted.height, STRIDES)
    figures, stride = rows[which, :4].astype(np.float64), strides[which, None]
    sizes = np.exp(figures[:, 2:].clip(max=MAX_LOG_SIZE)) * stride
    return Boxes(centred((cells[which] + figures[:, :2]) * stride, sizes), scores)


def decode_yolov8(outputs: Outputs, wanted: WantedClass) -> Boxes:
    """Read ``(1, 4 + classes, n)``: centre and size in pixels of the input, and the score of each class."""
    rows = outputs[0][0].T
    which, scores = _likely(rows[:, 4:], wanted)
    figures = rows[which, :4].astype(np.float64)
    return Boxes(centred(figures[:, :2], figures[:, 2:]), scores)


def decode_nanodet(outputs: Outputs, wanted: WantedClass) -> Boxes:
    """Read ``(1, n, classes + 4 · 8)``: the score of each class, and how far off each side of the box is.

    X. Li et al., "Generalized Focal Loss", arXiv 2006.04388: the distance to a side is the mean of 0 to 7 strides,
    weighted by the softmax of its eight figures.
    """
    rows = outputs[0][0]
    classes = rows.shape[1] - 4 * DISTANCE_BINS
    which, scores = _likely(rows[:, :classes], wanted)
    cells, strides = grid_cells(wanted.width, wanted.height, NANODET_STRIDES)
    figures, stride = rows[which, classes:].astype(np.float64).reshape(-1, 4, DISTANCE_BINS), strides[which, None]
    weights = np.exp(figures - figures.max(axis=2, keepdims=True))
    distances = weights @ np.arange(DISTANCE_BINS) / weights.sum(axis=2) * stride
    centres = cells[which] * stride
    return Boxes(np.hstack((centres - distances[:, :2], centres + distances[:, 2:])), scores)


def _likely(
    classes: NDArray[np.float32], wanted: WantedClass, things: NDArray[np.float32] | None = None
) -> tuple[Indices, Values]:
    """Return the rows in which the class scores enough and best, and its score there."""
    scores = classes[:, wanted.number] if things is None else classes[:, wanted.number] * things
    which = np.flatnonzero(scores >= wanted.min_score)
    which = which[classes[which, wanted.number] >= classes[which].max(axis=1, initial=0.0)]
    return which, scores[which].astype(np.float64)


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
