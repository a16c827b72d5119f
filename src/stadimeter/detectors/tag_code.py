"""Reading the code of a tag from its four corners.

OpenCV finds outlines fast but compares each with every member of a family, in version 5 a millisecond for each
outline. Here the code is read at full resolution, however much the picture was reduced for the search, and compared
with all members in all four directions by one product of matrices.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.detectors.tag_families import TagFamily

Plane = NDArray[np.uint8]
Cells = NDArray[np.float32]

SAMPLES = 4
"""Samples along a cell; the outermost are left out, since neighbouring cells blur into them."""

LEAST_CONTRAST = 12.0
"""How much brighter the white cells must be than the black ones, in levels of 8 bits."""

MOST_BORDER_ERRORS = 0.12
"""The share of the border's cells that may look white: three of 28."""

MOST_BORDER_DOUBTS = 0.4
"""Where more of the border looks white, better corners would not help."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SeenTag:
    """A tag whose code was read.

    Attributes:
        number: Which member of the family it is.
        errors: How many of its cells are wrong.
        corners_px: Its corners clockwise on the screen, starting with its own top left one, shape ``(4, 2)``.
    """

    number: int
    errors: int
    corners_px: Points

    @property
    def side_px(self) -> float:
        """Its longest side."""
        return float(np.linalg.norm(self.corners_px[[1, 2, 3, 0]] - self.corners_px, axis=1).max())


def read_tag(grey: Plane, corners_px: Points, family: TagFamily, *, inverted: bool = False) -> SeenTag | None:
    """Read the code inside an outline.

    Args:
        grey: The picture, shape ``(height, width)``.
        corners_px: The outline's corners clockwise on the screen.
        family: Whose codes to compare with.
        inverted: Whether a white border on black counts too.

    Returns:
        The tag; None if it is none of the family.
    """
    white = _white_cells(grey, corners_px, family, inverted=inverted)
    if white is None or _border(white).mean() > MOST_BORDER_ERRORS:
        return None
    return _closest(white[1:-1, 1:-1], corners_px, family)


def may_be_tag(grey: Plane, corners_px: Points, family: TagFamily, *, inverted: bool = False) -> bool:
    """Say whether an outline whose code cannot be read may still be a tag, if its corners were known better.

    Args:
        grey: The picture, shape ``(height, width)``.
        corners_px: The outline's corners clockwise on the screen.
        family: The family.
        inverted: Whether a white border on black counts too.

    Returns:
        True if there is contrast, and most of the border is black.
    """
    white = _white_cells(grey, corners_px, family, inverted=inverted)
    return white is not None and bool(_border(white).mean() < MOST_BORDER_DOUBTS)


def _white_cells(grey: Plane, corners: Points, family: TagFamily, *, inverted: bool) -> NDArray[np.bool_] | None:
    """Return which cells are white, or black for a white border on black; None where there is no contrast."""
    cells = _cells(grey, corners, family.cells)
    threshold, contrast = _two_levels(cells)
    if contrast < LEAST_CONTRAST:
        return None
    white = cells > threshold
    return ~white if inverted and _border(white).mean() > 0.5 else white


def _cells(grey: Plane, corners: Points, count: int) -> Cells:
    """Return how bright each cell is, shape ``(count, count)``."""
    side = count * SAMPLES
    square = np.array(((0, 0), (side, 0), (side, side), (0, side)), np.float32) - np.float32(0.5)
    turned = cv2.getPerspectiveTransform(square, corners.astype(np.float32))
    flat = cv2.warpPerspective(
        grey, turned, (side, side), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE
    )
    samples = np.asarray(flat, np.float32).reshape(count, SAMPLES, count, SAMPLES)
    return np.asarray(samples[:, 1:-1, :, 1:-1].mean(axis=(1, 3)))


def _two_levels(cells: Cells) -> tuple[float, float]:
    """Return what parts black from white, and how far apart they are, by Otsu's criterion.

    N. Otsu, A threshold selection method from gray-level histograms, IEEE Transactions on Systems, Man, and
    Cybernetics 9, 1979: the variance between the two classes is the largest.
    """
    levels = np.sort(cells, axis=None).astype(np.float64)
    dark = np.arange(1, levels.size)
    sums = np.cumsum(levels)
    dark_mean, bright_mean = sums[:-1] / dark, (sums[-1] - sums[:-1]) / (levels.size - dark)
    best = int(np.argmax(dark * (levels.size - dark) * (bright_mean - dark_mean) ** 2))
    return float(levels[best] + levels[best + 1]) / 2, float(bright_mean[best] - dark_mean[best])


def _border(white: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.concatenate((white[0], white[-1], white[1:-1, 0], white[1:-1, -1]))


def _closest(inner: NDArray[np.bool_], corners: Points, family: TagFamily) -> SeenTag | None:
    """Return the member with the fewest wrong cells, whichever way it is turned."""
    signs = inner.reshape(-1).astype(np.float32) * 2 - 1
    agreement = family.codes @ signs
    quarter, number = divmod(int(np.argmax(agreement)), family.members)
    errors = round((signs.size - float(agreement.max())) / 2)
    if errors > family.most_errors:
        return None
    # Turned clockwise by so many quarters, its own top left corner is that many further on.
    return SeenTag(number=number, errors=errors, corners_px=corners[[i - 4 + quarter for i in range(4)]])
