"""Which way boards are tilted."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.ranging.board_calibration import EDGES, BoardView, edges_away
from support.each_case import each_case

pytestmark = pytest.mark.vision

CORNERS = np.column_stack([axis.ravel() for axis in np.meshgrid(np.arange(9), np.arange(6))]) * 0.025
LENS = CameraModel.with_focal_length(700.0, 640, 480)


def seen(turn: tuple[float, float, float], camera: CameraModel = LENS) -> BoardView:
    rotation, _ = cv2.Rodrigues(np.array(turn))
    flat = np.column_stack((CORNERS - CORNERS.mean(axis=0), np.zeros(len(CORNERS))))
    points = flat @ rotation.T + (0.01, -0.02, 0.5)
    return BoardView(picture="a", board_m=CORNERS, corners_px=camera.project(points[:, :2] / points[:, 2:]))


# The camera frame has x to the right, y down and z forward: turning about x by a positive angle takes the lower edge
# away, and about y brings it nearer on the right.
@each_case(
    ("turn", "away"),
    [
        ((0.6, 0.0, 0.0), {"lower"}),
        ((-0.6, 0.0, 0.0), {"upper"}),
        ((0.0, 0.6, 0.0), {"left"}),
        ((0.0, -0.6, 0.0), {"right"}),
        ((0.5, -0.5, 0.0), {"lower", "right"}),
        ((0.1, -0.1, 0.0), set()),
        ((0.0, 0.0, 0.7), set()),
    ],
)
@each_case("focal_px", [450.0, 700.0, 1000.0])
def test_the_edges_that_are_away_are_named_whatever_the_focal_length(
    turn: tuple[float, float, float], away: set[str], focal_px: float
) -> None:
    camera = replace(LENS, fx_px=focal_px, fy_px=focal_px)
    assert edges_away(seen(turn, camera), 640, 480) == away


@given(
    corners=st.lists(st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4)), min_size=54, max_size=54),
)
def test_whatever_the_corners_are_there_is_an_answer(corners: list[tuple[float, float]]) -> None:
    view = BoardView(picture="a", board_m=CORNERS, corners_px=np.array(corners))
    assert edges_away(view, 640, 480) <= set(EDGES)
