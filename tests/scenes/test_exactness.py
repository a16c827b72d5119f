"""What is drawn is where geometry has it."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.simulation.silhouette import silhouette
from support.scenes.draw import disc_scene, empty_scene, sheet_scene, tag_scene
from support.scenes.nuisances import BARREL
from support.scenes.plane import DiscTarget, Pose
from support.scenes.render import render

pytestmark = pytest.mark.vision

SQUARE = CameraModel.with_focal_length(600.0, 640, 480)
OBLONG = CameraModel(width_px=640, height_px=480, fx_px=500.0, fy_px=700.0, cx_px=300.0, cy_px=260.0)
TURNED = Pose(position_m=(0.13, -0.08, 1.1), tilt_rad=0.9, tilt_towards_rad=0.4, roll_rad=0.3)


@pytest.mark.parametrize("camera", [SQUARE, OBLONG], ids=["square pixels", "oblong pixels"])
@pytest.mark.parametrize(
    "place",
    [
        ((0.0, 0.0, 1.0), 0.2),
        ((0.013, -0.027, 3.0), 0.2),
        ((0.6, 0.25, 1.6), 0.2),
        ((-0.31, 0.1, 1.0), 0.3),
    ],
    ids=["on the axis", "far", "in a corner", "wide off"],
)
def test_the_limb_of_a_ball_is_where_the_exact_cone_has_it(bare, ball, cover, edge_errors, camera, place) -> None:
    position_m, diameter_m = place
    seen = silhouette(camera, position_m, diameter_m / 2)
    angles = np.linspace(0, 2 * math.pi, 180, endpoint=False)
    limb = seen.outline_px(np.column_stack((np.cos(angles), np.sin(angles))))
    normals = seen.outline_px(np.column_stack((np.cos(angles), np.sin(angles))), 1.001) - limb
    tangents = np.roll(limb, -1, 0) - np.roll(limb, 1, 0)
    outwards = np.column_stack((tangents[:, 1], -tangents[:, 0]))
    outwards *= np.sign((outwards * normals).sum(axis=1))[:, None] / np.linalg.norm(outwards, axis=1)[:, None]
    errors = edge_errors(cover(bare(ball(position_m, diameter_m), camera)), limb, outwards)
    # Walking straight into a curve is longer on the outside by the square over the diameter, most for small balls.
    assert abs(errors.mean()) < 0.02
    assert np.abs(errors).max() < 0.08


@pytest.mark.parametrize("distortion", [(0.0,) * 5, BARREL], ids=["pinhole", "barrel"])
def test_the_corners_of_a_sheet_are_where_opencv_projects_them(bare, sheet, distortion) -> None:
    matrix = np.array(((600.0, 0, 319.5), (0, 600.0, 239.5), (0, 0, 1)))
    target = sheet(TURNED)
    rotation, _ = cv2.Rodrigues(TURNED.rotation())
    own = np.array(((-0.1485, -0.105, 0), (0.1485, -0.105, 0), (0.1485, 0.105, 0), (-0.1485, 0.105, 0)))
    expected, _ = cv2.projectPoints(own, rotation, np.array(TURNED.position_m), matrix, np.array(distortion))
    truth = render(bare(target, replace(SQUARE, distortion=distortion))).truth
    assert truth.outline_px == pytest.approx(expected.reshape(-1, 2), abs=1e-6)


@pytest.mark.parametrize("distortion", [(0.0,) * 5, BARREL], ids=["pinhole", "barrel"])
@pytest.mark.parametrize("skew_px", [(0.0, 0.0), (24.0, 0.0), (0.0, 16.0)], ids=["still", "sideways", "down"])
def test_the_sides_of_a_sheet_are_drawn_where_its_points_are_projected(
    bare, sheet, cover, edge_errors, distortion, skew_px
) -> None:
    scene = bare(sheet(TURNED), replace(SQUARE, distortion=distortion), rolling_shutter_px=skew_px)
    shares = np.linspace(0.15, 0.85, 40)[:, None]
    own = np.array(((-0.1485, -0.105), (0.1485, -0.105), (0.1485, 0.105), (-0.1485, 0.105)))
    drawn = cover(scene)
    middle = render(scene).truth.outline_px.mean(axis=0)
    for start, end in zip(own, np.roll(own, -1, 0), strict=True):
        # A sheet whose first two corners are two points of the side projects them with the same lens.
        side = np.vstack([_projected(scene, start + (end - start) * share) for share in shares])
        tangent = np.gradient(side, axis=0)
        outwards = np.column_stack((tangent[:, 1], -tangent[:, 0]))
        outwards *= np.sign((outwards * (side - middle)).sum(axis=1))[:, None]
        outwards /= np.linalg.norm(outwards, axis=1)[:, None]
        errors = edge_errors(drawn, side, outwards)
        assert abs(errors.mean()) < 0.01
        assert np.abs(errors).max() < 0.06


def _projected(scene, own_m):
    """Project a point of the sheet by hand: OpenCV's distortion, then the shift of the row that shows it."""
    point = TURNED.placed(np.array([own_m]))
    matrix = np.array(((600.0, 0, 319.5), (0, 600.0, 239.5), (0, 0, 1)))
    places = [
        cv2.projectPoints(each, np.zeros(3), np.zeros(3), matrix, np.array(scene.camera.distortion))[0].reshape(2)
        for each in (point, np.array([TURNED.position_m]))
    ]
    (u, v), (_, reference) = places
    right, down = scene.rolling_shutter_px
    row = v
    for _ in range(50):
        row = v + down * (row - reference) / 480
    return np.array((u + right * (row - reference) / 480, row))


def test_a_tilted_disc_covers_the_ellipse_through_its_rim(bare, cover) -> None:
    scene = bare(DiscTarget(pose=TURNED, diameter_m=0.3, bgr=(255, 255, 255)))
    rim = render(scene).truth.outline_px
    x, y = rim.T
    polygon_px2 = abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2
    assert math.sqrt(cover(scene).sum()) == pytest.approx(math.sqrt(polygon_px2), abs=0.02)


def test_opencv_reads_a_tag_and_finds_its_corners_where_the_truth_has_them() -> None:
    scene = tag_scene(41, 120.0, 0.4)
    made = render(replace(scene, sensor=replace(scene.sensor, noise=0.0)))
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    corners, numbers, _ = detector.detectMarkers(made.image)
    assert numbers.ravel().tolist() == [41]
    assert corners[0].reshape(4, 2) == pytest.approx(made.truth.outline_px, abs=1.5)


def test_a_tag_is_as_large_as_asked_and_a_sheet_as_tilted_as_asked() -> None:
    assert render(tag_scene(1, 48.0, 0.5)).truth.apparent_px == pytest.approx(48.0)
    assert render(sheet_scene(1, 0.7)).truth.tilt_rad == 0.7
    assert render(disc_scene(1, 0.3)).truth.tilt_rad == 0.3
    assert render(empty_scene(1)).truth is None
