"""The meaning of the outputs of YOLOX, YOLOv8 and NanoDet-Plus: a row of figures for each cell of grids over the input.

A grid of stride s has a cell for each s by s pixels of the input, row by row; the grids of a family follow each other,
the finest first. Every function takes the outputs of one picture and returns boxes in pixels of the input, with the
scores of one class where no other class scores higher.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Indices, Points, Values
from stadimeter.detectors.object.boxes import Boxes, centred

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
