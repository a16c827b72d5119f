"""Reading a picture between its pixels, and at a smaller size.

Written out with numpy where OpenCV's own functions round differently from one version to the next.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.core.frame import Image

Samples = NDArray[np.float32]


def sample(image: Image, x_px: Points, y_px: Points) -> Samples:
    """Read a picture between its pixels, bilinearly. Outside, the outermost pixels go on for ever.

    Args:
        image: The picture, shape ``(height, width, channels)``.
        x_px: Horizontal coordinates, any shape.
        y_px: Vertical coordinates, the same shape.

    Returns:
        The values, of that shape with the channels added.
    """
    height, width = image.shape[:2]
    x = np.clip(x_px, 0, width - 1)
    y = np.clip(y_px, 0, height - 1)
    left = np.minimum(x.astype(np.intp), width - 2) if width > 1 else np.zeros(x.shape, np.intp)
    top = np.minimum(y.astype(np.intp), height - 2) if height > 1 else np.zeros(y.shape, np.intp)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    share_x = (x - left).astype(np.float32)[..., np.newaxis]
    share_y = (y - top).astype(np.float32)[..., np.newaxis]
    above = image[top, left] * (1 - share_x) + image[top, right] * share_x
    below = image[bottom, left] * (1 - share_x) + image[bottom, right] * share_x
    values: Samples = above * (1 - share_y) + below * share_y
    return values


def reduced(image: Image, long_side_px: int) -> tuple[Image, float]:
    """Return a picture with its long side no longer than that, each pixel the mean of those that it replaces.

    Args:
        image: The picture.
        long_side_px: The longest that a side may be.

    Returns:
        The picture, the same one if it is small enough, and its scale: 0.5 for half the size.
    """
    height, width = image.shape[:2]
    scale = min(1.0, long_side_px / max(width, height))
    if scale == 1.0:
        return image, scale
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8), scale


def to_full_scale(points_px: Points, scale: float) -> Points:
    """Return where points of a reduced picture are in the full one.

    Args:
        points_px: Points in the reduced picture, shape ``(n, 2)``, with (0, 0) at the centre of its first pixel.
        scale: The scale of the reduced picture.

    Returns:
        The points in the full picture.
    """
    return (points_px + 0.5) / scale - 0.5
