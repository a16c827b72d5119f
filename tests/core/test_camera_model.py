"""Camera models: pixels to directions and back as OpenCV has them, and scaling that keeps the view."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.errors import CalibrationError
from support.each_case import each_case

BARREL = CameraModel(
    width_px=640,
    height_px=480,
    fx_px=532.8,
    fy_px=532.9,
    cx_px=342.5,
    cy_px=233.9,
    distortion=(-0.2811, 0.0252, 0.0012, -0.0001, 0.1635),
    edge_bias_px=0.3,
)
"""OpenCV's left camera."""
WAVY = CameraModel(
    width_px=1008,
    height_px=756,
    fx_px=819.74,
    fy_px=824.46,
    cx_px=512.62,
    cy_px=363.64,
    distortion=(0.36255, -3.26793, -0.002184, 0.005111, 9.29969),
)
"""A telephone's camera with a polynomial that goes up, down and up."""
PLAIN = replace(BARREL, distortion=())


def grid(camera: CameraModel, steps: int = 9) -> np.ndarray:
    xs, ys = np.meshgrid(np.linspace(0, camera.width_px - 1, steps), np.linspace(0, camera.height_px - 1, steps))
    return np.column_stack((xs.ravel(), ys.ravel()))


def opencv_directions(camera: CameraModel, points_px: np.ndarray) -> np.ndarray:
    """OpenCV's own iteration, run until it stands still."""
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-14)
    undistort = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)  # OpenCV 5 has merged the two
    found = undistort(
        points_px.reshape(-1, 1, 2),
        camera.matrix(),
        np.array(camera.distortion),
        R=np.eye(3),
        P=np.eye(3),
        criteria=criteria,
    )
    return found.reshape(-1, 2)


def lens_or_none(distortion: tuple[float, ...]) -> CameraModel | None:
    try:
        return replace(BARREL, distortion=distortion)
    except CalibrationError:
        return None


@pytest.mark.parametrize("camera", [PLAIN, BARREL, replace(BARREL, distortion=(-0.26, 0.07, 0.001, 0.0))])
def test_directions_are_those_of_opencv(camera: CameraModel) -> None:
    assert camera.directions(grid(camera)) == pytest.approx(opencv_directions(camera, grid(camera)), abs=1e-9)


@pytest.mark.parametrize("camera", [PLAIN, BARREL, WAVY])
def test_projections_are_those_of_opencv(camera: CameraModel) -> None:
    directions = camera.directions(grid(camera))
    points = np.column_stack((directions, np.ones(len(directions)))).reshape(-1, 1, 3)
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix(), np.array(camera.distortion))
    assert camera.project(directions) == pytest.approx(theirs.reshape(-1, 2), abs=1e-8)


@given(
    k1=st.floats(-0.5, 0.5),
    k2=st.floats(-0.5, 0.5),
    p1=st.floats(-0.01, 0.01),
    p2=st.floats(-0.01, 0.01),
    k3=st.floats(-0.5, 0.5),
)
def test_any_lens_that_is_accepted_can_be_undone_everywhere_in_the_picture(
    k1: float, k2: float, p1: float, p2: float, k3: float
) -> None:
    camera = lens_or_none((k1, k2, p1, p2, k3))
    assume(camera)
    assert camera is not None
    assert camera.project(camera.directions(grid(camera))) == pytest.approx(grid(camera), abs=1e-6)


@pytest.mark.parametrize("camera", [PLAIN, BARREL])
def test_one_pixel_looks_where_it_looks_among_many(camera: CameraModel) -> None:
    x, y = camera.directions(np.array([[12.25, 470.5]]))[0]
    assert camera.direction(12.25, 470.5) == (x, y)


def test_no_points_have_no_directions() -> None:
    assert BARREL.directions(np.empty((0, 2))).shape == (0, 2)


def test_where_the_lens_does_not_reach_there_is_no_direction() -> None:
    lens = replace(BARREL, distortion=(-0.2, 0.0, 0.0, 0.0))
    assert np.isnan(lens.directions(np.array([[5000.0, 240.0]]))).all()
    assert np.isnan(lens.project(np.array([[2.5, 0.0]]))).all()
    assert all(math.isnan(each) for each in lens.direction(5000.0, 240.0))


def test_a_lens_that_folds_the_picture_is_refused() -> None:
    with pytest.raises(CalibrationError, match="folds the picture before its corner"):
        replace(BARREL, distortion=(-0.9, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("count", [1, 2, 3, 6, 8])
def test_a_wrong_number_of_coefficients_is_refused(count: int) -> None:
    with pytest.raises(CalibrationError, match=f"has {count} coefficients"):
        replace(BARREL, distortion=(0.0,) * count)


@each_case(
    ("key", "value"),
    [
        ("distortion", (0.1, math.nan, 0.0, 0.0)),
        ("edge_bias_px", math.nan),
        ("tone_curve", "gamma"),
        ("fx_px", math.nan),
        ("cx_px", math.inf),
        ("focal_relative_sigma", -1.0),
        ("width_px", 0),
    ],
)
def test_what_is_no_camera_is_refused_with_the_value(key: str, value: object) -> None:
    with pytest.raises(CalibrationError, match=r"nan|inf|gamma|-1|0x480"):
        replace(BARREL, **{key: value})


def test_a_larger_picture_of_the_same_view_looks_the_same_way() -> None:
    larger = BARREL.scaled_to(1280, 960)
    here = np.array([[10.0, 20.0]])
    there = (here + 0.5) * 2 - 0.5
    assert larger.directions(there) == pytest.approx(BARREL.directions(here), abs=1e-12)
    assert larger.distortion == BARREL.distortion


def test_the_edge_bias_grows_with_the_picture() -> None:
    assert BARREL.scaled_to(1280, 960).edge_bias_px == pytest.approx(0.6)


def test_another_aspect_is_refused() -> None:
    with pytest.raises(CalibrationError, match="another aspect"):
        BARREL.scaled_to(640, 360)


@pytest.mark.parametrize(
    ("cx_px", "cy_px", "key"),
    [(4000.0, 239.5, "cx_px"), (-1.0, 239.5, "cx_px"), (319.5, 480.0, "cy_px"), (math.nan, 0.0, "cx_px")],
)
def test_an_optical_centre_outside_the_picture_is_refused(cx_px: float, cy_px: float, key: str) -> None:
    with pytest.raises(CalibrationError, match=f"optical centre {key} = .* is outside the 640x480 px") as raised:
        CameraModel(width_px=640, height_px=480, fx_px=600.0, fy_px=600.0, cx_px=cx_px, cy_px=cy_px)
    assert raised.value.key == key


def test_an_optical_centre_more_than_a_tenth_from_the_middle_is_remarked_on() -> None:
    def words(cx_px: float, cy_px: float) -> str:
        lens = CameraModel(width_px=640, height_px=480, fx_px=600.0, fy_px=600.0, cx_px=cx_px, cy_px=cy_px)
        return lens.off_centre_words

    assert words(319.5 + 63, 239.5 - 47) == ""
    assert "is 30% of the picture from its middle" in words(319.5, 239.5 - 144)
