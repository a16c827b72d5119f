"""Whether a shape is cut off by the border of the picture, so that its size is not known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points


def touches_border(points_px: Points, width_px: int, height_px: int, margin_px: float) -> bool:
    """Say whether a shape reaches the border of the picture, or passes it.

    Args:
        points_px: The outline, shape ``(n, 2)``, x and y.
        width_px: Width of the picture.
        height_px: Height of the picture.
        margin_px: How near to the outermost pixels counts as reaching the border.

    Returns:
        True if any point is nearer to the border than the margin, or beyond it.
    """
    left, top = points_px.min(axis=0).tolist()
    right, bottom = points_px.max(axis=0).tolist()
    return bool(
        left < margin_px or top < margin_px or right > width_px - 1 - margin_px or bottom > height_px - 1 - margin_px
    )


def sides_on_border(corners_px: Points, shape: tuple[int, ...], margin_px: float) -> NDArray[np.bool_]:
    """Say which sides of outlines run along one border of the picture.

    Args:
        corners_px: Their corners in order around each, shape ``(c, n, 2)``; side i leads from corner i to corner i + 1.
        shape: Height and width of the picture.
        margin_px: How near to the outermost pixels counts as on the border.

    Returns:
        For each side whether both ends are at the same border, shape ``(c, n)``.
    """
    last_px = np.array((shape[1], shape[0])) - 1 - margin_px
    low, high = corners_px < margin_px, corners_px > last_px
    after = [*range(1, corners_px.shape[1]), 0]
    return np.asarray(((low & low[:, after]) | (high & high[:, after])).any(axis=2))


def corners_on_border(corners_px: Points, shape: tuple[int, ...], margin_px: float) -> NDArray[np.bool_]:
    """Say which outlines reach the border of the picture, or pass it.

    Args:
        corners_px: Their corners, shape ``(c, n, 2)``.
        shape: Height and width of the picture.
        margin_px: How near to the outermost pixels counts as reaching the border.

    Returns:
        Shape ``(c,)``.
    """
    last_px = np.array((shape[1], shape[0])) - 1 - margin_px
    return np.asarray(((corners_px < margin_px) | (corners_px > last_px)).any(axis=(1, 2)))
