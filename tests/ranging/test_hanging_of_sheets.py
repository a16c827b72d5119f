"""Which way a sheet hangs, where its corners hardly tell."""

from __future__ import annotations

import math

import cv2
import numpy as np

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection
from stadimeter.ranging.flat import SheetShape
from stadimeter.ranging.plane_pose import rectangle
from support.corners import detection_of_corners

CAMERA = CameraModel.with_focal_length(600.0, 640, 480)
CARD = SheetShape(width_m=0.1, height_m=0.075)


def seen_roughly(
    rng: np.random.Generator, tilt_rad: float, corner_sigma_px: float, depth_m: float
) -> tuple[Detection, float]:
    """Return a card whose corners are off by noise, and how far away it truly is: at 3 m it appears 20 px wide."""
    towards = float(rng.uniform(0, 2 * math.pi))
    turn = cv2.Rodrigues(np.array((math.cos(towards), math.sin(towards), 0.0)) * tilt_rad)[0] @ np.diag((1, -1, -1))
    placed = rectangle(CARD.width_m, CARD.height_m) @ turn.T + (0.1, 0.05, depth_m)
    corners = CAMERA.project(placed[:, :2] / placed[:, 2:]) + rng.normal(0, corner_sigma_px, (4, 2))
    return detection_of_corners(corners, math.sqrt(2) * corner_sigma_px), math.hypot(0.1, 0.05, depth_m)


def test_a_small_card_is_not_taken_to_hang_the_other_way_and_to_be_turned_far_away() -> None:
    """Either way explains its corners; the wrong one is 15 to 25 % nearer."""
    rng = np.random.default_rng(5)
    errors = []
    for _ in range(200):
        found, true_m = seen_roughly(rng, math.radians(rng.uniform(0, 30)), 0.25, rng.uniform(2.0, 3.5))
        x, y, z = CARD.locate(found, CAMERA).position_m
        errors.append(math.hypot(x, y, z) / true_m - 1)
    assert np.mean(np.abs(errors) > 0.1) < 0.06


def test_a_sheet_that_is_turned_far_away_is_measured_so_where_its_corners_tell() -> None:
    rng = np.random.default_rng(6)
    for _ in range(50):
        found, true_m = seen_roughly(rng, math.radians(60), 0.01, rng.uniform(0.3, 0.6))
        x, y, z = CARD.locate(found, CAMERA).position_m
        assert abs(math.hypot(x, y, z) / true_m - 1) < 0.01
