"""Whether a shape is cut off by the border of the picture, so that its size is not known."""

from __future__ import annotations

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
    low = points_px.min(axis=0)
    high = points_px.max(axis=0)
    return bool(
        low[0] < margin_px
        or low[1] < margin_px
        or high[0] > width_px - 1 - margin_px
        or high[1] > height_px - 1 - margin_px
    )


def side_on_border(start_px: Points, end_px: Points, width_px: int, height_px: int, margin_px: float) -> bool:
    """Say whether a side of a shape runs along one border of the picture.

    Args:
        start_px: One end of the side, x and y.
        end_px: Its other end.
        width_px: Width of the picture.
        height_px: Height of the picture.
        margin_px: How near to the outermost pixels counts as on the border.

    Returns:
        True if both ends are at the same border.
    """
    for axis, size_px in ((0, width_px), (1, height_px)):
        ends = (float(start_px[axis]), float(end_px[axis]))
        if max(ends) < margin_px or min(ends) > size_px - 1 - margin_px:
            return True
    return False
