"""Meaning of the outputs of YuNet and CenterFace: faces with five landmarks, of which the first two are the eyes."""

from __future__ import annotations

import numpy as np

from stadimeter.detectors.object.boxes import Boxes, centred
from stadimeter.detectors.object.grids import MAX_LOG_SIZE, STRIDES, Outputs, WantedClass, grid_cells

# A cell of CenterFace's maps is this many pixels of the input.
CENTERFACE_STRIDE = 4

# The kinds of YuNet's outputs, each with how many figures a cell has; one output for each kind and stride.
YUNET_OUTPUTS = {"cls": 1, "obj": 1, "bbox": 4, "kps": 10}

EYES = 2


def decode_yunet(outputs: Outputs, wanted: WantedClass) -> Boxes:
    """Read twelve outputs ``(1, n, figures)``: those of each kind for the strides 8, 16 and 32.

    W. Wu et al., "YuNet: A Tiny Millisecond-level Face Detector", 2023: score = √(face · thing), centre = (cell +
    offset) · stride, size = exp(figure) · stride, landmark = (cell + offset) · stride.
    """
    faces, things, boxes, marks = (
        np.concatenate([each[0] for each in outputs[first : first + len(STRIDES)]]).astype(np.float64)
        for first in range(0, len(YUNET_OUTPUTS) * len(STRIDES), len(STRIDES))
    )
    scores = np.sqrt(faces[:, 0].clip(0, 1) * things[:, 0].clip(0, 1))
    which = np.flatnonzero(scores >= wanted.min_score)
    cells, strides = grid_cells(wanted.width, wanted.height, STRIDES)
    cell, stride = cells[which], strides[which, None]
    sizes = np.exp(boxes[which, 2:].clip(max=MAX_LOG_SIZE)) * stride
    corners = centred((cell + boxes[which, :2]) * stride, sizes)
    eyes = (cell[:, None] + marks[which, : 2 * EYES].reshape(-1, EYES, 2)) * stride[:, None]
    return Boxes(corners, scores[which], eyes)


def decode_centerface(outputs: Outputs, wanted: WantedClass) -> Boxes:
    """Read four maps ``(1, c, rows, columns)``: score, size, offset, and landmarks, each as y and x.

    Y. Xu et al., "CenterFace: Joint Face Detection and Alignment Using Face as Point", arXiv 1911.03599: size =
    exp(figure) · 4, centre = (cell + offset + 1/2) · 4, landmarks in shares of the box.
    """
    score, log_size, offset, marks = (each[0] for each in outputs)
    rows, columns = np.nonzero(score[0] >= wanted.min_score)
    sizes = np.exp(log_size[::-1, rows, columns].T.astype(np.float64).clip(max=MAX_LOG_SIZE)) * CENTERFACE_STRIDE
    cells = np.column_stack((columns, rows)) + offset[::-1, rows, columns].T + 0.5
    corners = centred(cells * CENTERFACE_STRIDE, sizes)
    shares = marks[: 2 * EYES, rows, columns].T.astype(np.float64).reshape(-1, EYES, 2)[:, :, ::-1]
    eyes = corners[:, None, :2] + shares * sizes[:, None]
    return Boxes(corners, score[0, rows, columns].astype(np.float64), eyes)
