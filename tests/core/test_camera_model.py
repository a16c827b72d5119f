"""Camera models: pixels to directions and back, how sure that is, and what water changes of it."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.config.camera_file import camera_model_from_table
from stadimeter.core.camera_model import PARAMETERS, REFRACTIONS, CameraModel, LensUncertainty, behind_flat_port
from stadimeter.errors import CalibrationError, ConfigError
from support.each_case import each_case

# Camera models: pixels to directions and back as OpenCV has them, and scaling that keeps the view.

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


def test_where_the_lens_does_not_reach_there_is_no_direction() -> None:
    lens = replace(BARREL, distortion=(-0.2, 0.0, 0.0, 0.0))
    assert np.isnan(lens.directions(np.array([[5000.0, 240.0]]))).all()
    assert np.isnan(lens.project(np.array([[2.5, 0.0]]))).all()
    assert all(math.isnan(each) for each in lens.direction(5000.0, 240.0))


@each_case(
    ("key", "value"),
    [
        ("distortion", (0.1, math.nan, 0.0, 0.0)),
        ("distortion", (1e9, 0.0, 0.0, 0.0)),
        ("edge_bias_px", math.nan),
        ("tone_curve", "gamma"),
        ("fx_px", math.nan),
        ("fx_px", 4.12),
        ("fx_px", 1e17),
        ("cx_px", math.inf),
        ("focal_relative_sigma", -1.0),
        ("width_px", 0),
    ],
)
def test_what_is_no_camera_is_refused_with_the_value(key: str, value: object) -> None:
    with pytest.raises(CalibrationError, match=r"nan|inf|gamma|-1|0x480|that no lens has|is not that of a lens"):
        replace(BARREL, **{key: value})


@pytest.mark.parametrize("focal_px", [20.0, 600000.0])
def test_the_shortest_lenses_and_long_telescopes_are_cameras_too(focal_px: float) -> None:
    assert CameraModel.with_focal_length(focal_px, 640, 480).fx_px == focal_px


def test_a_larger_picture_of_the_same_view_looks_the_same_way() -> None:
    larger = BARREL.scaled_to(1280, 960)
    here = np.array([[10.0, 20.0]])
    there = (here + 0.5) * 2 - 0.5
    assert larger.directions(there) == pytest.approx(BARREL.directions(here), abs=1e-12)
    assert larger.distortion == BARREL.distortion


def test_another_aspect_is_refused() -> None:
    with pytest.raises(CalibrationError, match="another aspect"):
        BARREL.scaled_to(640, 360)


@pytest.mark.parametrize("size_px", [(480, 640), (960, 1280)])
def test_a_picture_from_a_camera_on_its_side_is_refused_as_one(size_px: tuple[int, int]) -> None:
    with pytest.raises(CalibrationError, match="turned by a quarter: hold it as at its calibration"):
        BARREL.scaled_to(*size_px)


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


# What the uncertainty of a lens does to distances, at each place in the picture.

LENS = CameraModel(
    width_px=640,
    height_px=480,
    fx_px=612.0,
    fy_px=610.0,
    cx_px=315.0,
    cy_px=246.0,
    distortion=(-0.2, 0.06, 0.001, -0.0005, 0.01),
)
SIGMAS = (3.0, 3.0, 1.5, 1.5, 0.02, 0.1, 0.001, 0.001, 0.1)
NO_CORRELATION = (0.0,) * 36


def with_parameter(index: int, off: float) -> CameraModel:
    if index < 4:
        name = PARAMETERS[index] + "_px"
        return replace(LENS, **{name: getattr(LENS, name) + off})
    distortion = list(LENS.distortion)
    distortion[index - 4] += off
    return replace(LENS, distortion=tuple(distortion))


def solid_angle(model: CameraModel, place_px: np.ndarray) -> float:
    """Return how large a small round spot at a place is on the sphere of directions that the model gives it."""
    angles = np.linspace(0, 2 * np.pi, 181)[:-1]
    rim = model.directions(place_px + 0.5 * np.column_stack((np.cos(angles), np.sin(angles))))
    rays = np.column_stack((rim, np.ones(len(rim)))) / np.sqrt(1 + (rim**2).sum(axis=1))[:, None]
    axis = rays.mean(axis=0) / np.linalg.norm(rays.mean(axis=0))
    across = np.cross(axis, [0, 0, 1]) / np.linalg.norm(np.cross(axis, [0, 0, 1]))
    x, y = rays @ across / (rays @ axis), rays @ np.cross(axis, across) / (rays @ axis)
    return 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))


@each_case("index", range(9), ids=PARAMETERS)
def test_an_error_of_a_parameter_changes_distance_and_direction_as_predicted(index: int) -> None:
    off = 1e-3 if index < 4 else 1e-6
    more, less = (with_parameter(index, sign * off) for sign in (1, -1))
    for place in ((600.0, 50.0), (40.0, 430.0), (330.0, 200.0)):
        place_px = np.array(place)
        nearer = np.log(solid_angle(more, place_px) / solid_angle(less, place_px)) / (4 * off)
        turned = (more.directions(place_px[None]) - less.directions(place_px[None]))[0] / (2 * off)
        predicted = LENS.sensitivities(place_px[None])[0, :, index]
        assert predicted == pytest.approx([-nearer, *turned], rel=5e-3, abs=1e-7)


def test_without_it_the_focal_length_alone_counts_everywhere() -> None:
    plain = replace(LENS, focal_relative_sigma=0.004)
    assert plain.distance_share(3.0, 4.0) == plain.distance_share(320.0, 240.0) == 0.004


def test_the_share_is_that_of_the_covariance_and_never_less_than_the_focal_length_s() -> None:
    known = replace(LENS, uncertainty=LensUncertainty(sigmas=SIGMAS, correlations=NO_CORRELATION))
    for place in ((12.0, 20.0), (601.5, 33.0), (320.0, 240.0), (639.0, 479.0)):
        slopes = LENS.sensitivities(np.array([place]))[0, 0]
        assert known.distance_share(*place) == pytest.approx(float(np.linalg.norm(slopes * SIGMAS)), rel=0.02)
    assert replace(known, focal_relative_sigma=0.3).distance_share(12.0, 20.0) == 0.3


def test_it_is_the_same_at_another_resolution() -> None:
    known = replace(LENS, uncertainty=LensUncertainty(sigmas=SIGMAS, correlations=NO_CORRELATION))
    double = known.scaled_to(1280, 960)
    for x, y in ((10, 12), (500, 300)):
        assert double.distance_share(2 * x + 0.5, 2 * y + 0.5) == pytest.approx(known.distance_share(x, y), rel=0.01)


@given(seed=st.integers(0, 10_000), spread=st.floats(0, 6))
def test_a_covariance_survives_being_written_as_sigmas_and_correlations(seed: int, spread: float) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(9, 12)) * 10.0 ** rng.uniform(-spread, 1, 9)[:, None]
    covariance = root @ root.T
    scale = np.sqrt(np.diag(covariance))
    kept = LensUncertainty.of(covariance).covariance()
    assert kept / np.outer(scale, scale) == pytest.approx(covariance / np.outer(scale, scale), abs=1e-5)


@pytest.mark.parametrize(
    ("sigmas", "correlations", "complaint"),
    [
        (SIGMAS[:5], NO_CORRELATION, "lens_sigmas has to hold 9 numbers"),
        ((-1.0, *SIGMAS[1:]), NO_CORRELATION, "zero or more"),
        (SIGMAS, NO_CORRELATION[:35], "36 numbers"),
        (SIGMAS, (1.0, 1.0, *(0.0,) * 34), "contradict"),
        (SIGMAS, (float("nan"), *NO_CORRELATION[1:]), "36 numbers"),
    ],
)
def test_what_cannot_be_a_covariance_is_refused(
    sigmas: tuple[float, ...], correlations: tuple[float, ...], complaint: str
) -> None:
    with pytest.raises(CalibrationError, match=complaint):
        LensUncertainty(sigmas=sigmas, correlations=correlations)


# A camera under water, against rays that are traced by Snell's law.

AIR = CameraModel.with_focal_length(600.0, 640, 480)
PIXELS = np.array([[x, y] for x in (0.0, 100.0, 319.5, 500.0, 639.0) for y in (0.0, 239.5, 479.0)])


def traced(model, pixels, index):
    """Return where pixels look to in water: each ray turned at the window, so that sines are as the index."""
    air = model.directions(pixels)
    sine_water = np.sin(np.arctan(np.hypot(*air.T))) / index
    tangent = sine_water / np.sqrt(1 - sine_water**2)
    return air / np.maximum(np.hypot(*air.T), 1e-12)[:, None] * tangent[:, None]


@pytest.mark.parametrize("distortion", [(), (-0.2, 0.05, 0.001, -0.0005, 0.0)])
@pytest.mark.parametrize("medium", ["water", "sea water"])
def test_pixels_look_where_snell_s_law_sends_them(distortion, medium):
    model = replace(AIR, distortion=distortion)
    wet = behind_flat_port(model, medium, 0.0)
    off_px = (wet.directions(PIXELS) - traced(model, PIXELS, REFRACTIONS[medium].n)) * wet.fx_px
    assert np.abs(off_px).max() < 0.3
    assert np.abs(off_px[np.hypot(*(PIXELS - 300).T) < 150]).max(initial=0) < 0.1


def test_a_window_ahead_of_the_lens_moves_the_point_that_rays_come_from():
    index = REFRACTIONS["water"].n
    port_m, angle = 0.02, 1e-4
    # A ray near the axis, from the pupil to the window and on into the water, at a target 1 m from the pupil.
    at_window_m = port_m * math.tan(angle)
    beyond = math.tan(math.asin(math.sin(angle) / index))
    height_m = at_window_m + (1 - port_m) * beyond
    from_where_it_seems_to_come_m = height_m / beyond
    wet = behind_flat_port(AIR, "water", port_m)
    assert from_where_it_seems_to_come_m - wet.pupil_ahead_m == pytest.approx(1.0, abs=1e-6)


def test_a_lens_that_is_too_wide_is_refused():
    wide = CameraModel.with_focal_length(180.0, 640, 480)
    with pytest.raises(CalibrationError, match="cannot be described behind a flat port"):
        behind_flat_port(wide, "water", 0.0)


def test_a_camera_file_names_the_medium():
    table = {"width_px": 640, "height_px": 480, "fx_px": 600.0, "medium": "water", "port_m": 0.01}
    model = camera_model_from_table(table)
    assert model.fx_px == pytest.approx(600 * 1.334)
    with pytest.raises(ConfigError, match="medium"):
        camera_model_from_table(table | {"medium": "oil"})
