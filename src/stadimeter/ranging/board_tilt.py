"""Which way the boards of a calibration are tilted, before the camera is known.

Boards that face the camera say nothing about the focal length, so whoever holds one must know which tilts are missing.
A rough focal length is enough for that: it changes a tilt of 30 degrees by some degrees, and no direction.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from stadimeter.ranging.board_calibration import BoardView

TILTED_RAD = math.radians(20)
"""From this angle on a board counts as tilted."""

EDGES = ("left", "right", "upper", "lower")
"""The edges of a board that can be turned away from the camera, as the picture shows them."""


def edges_away(view: BoardView, width_px: int, height_px: int) -> frozenset[str]:
    """Return which edges of a board are turned away from the camera.

    Args:
        view: The board.
        width_px: The picture's width.
        height_px: The picture's height.

    Returns:
        One or two of `EDGES`; none of a board that faces the camera, or whose pose cannot be told.
    """
    rough_px = float(max(width_px, height_px))
    camera = np.array([[rough_px, 0, (width_px - 1) / 2], [0, rough_px, (height_px - 1) / 2], [0, 0, 1]])
    board = np.column_stack((view.board_m, np.zeros(len(view.board_m))))
    try:
        found, turn, shift = cv2.solvePnP(board, view.corners_px.reshape(-1, 1, 2), camera, None)
    except cv2.error:
        return frozenset()
    normal = np.asarray(cv2.Rodrigues(turn)[0], np.float64)[:, 2]
    if not found or not np.isfinite(normal).all():
        return frozenset()
    # Seen from the camera the depth grows to where the normal that points at the camera leans.
    towards = -normal if float(normal @ np.asarray(shift).ravel()) > 0 else normal
    return frozenset(_leaning(float(towards[0]), -float(towards[2]), "left", "right")) | frozenset(
        _leaning(float(towards[1]), -float(towards[2]), "upper", "lower")
    )


def _leaning(across: float, towards_camera: float, less: str, more: str) -> tuple[str, ...]:
    if abs(math.atan2(across, towards_camera)) < TILTED_RAD:
        return ()
    return (more,) if across > 0 else (less,)
