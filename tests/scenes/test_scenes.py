"""Scenes are drawn as they say: where everything is, and what each trouble does."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.simulation.camera import silhouette
from support.scenes.backdrop import ClutterBackdrop, PlainBackdrop
from support.scenes.ball import BallSurface, BallTarget
from support.scenes.cut_sheet import CutSheetTarget, HandCut
from support.scenes.draw import CAMERA, tag_scene
from support.scenes.nuisances import BARREL
from support.scenes.occluder import Occluder
from support.scenes.plane import DiscTarget, Pose, SheetTarget
from support.scenes.render import render
from support.scenes.scene import Scene
from support.scenes.sensor import Blur, Sensor
from support.scenes.target import Target
from support.scenes.tone import Tone

pytestmark = pytest.mark.vision


# Pictures in which a code value is a share of cover: white on black, linear, without blur and noise.

LENS = CameraModel.with_focal_length(600.0, 640, 480)
WHITE, BLACK = (255, 255, 255), (0, 0, 0)
Cover = NDArray[np.float64]


def bare(target: Target | None, camera: CameraModel = LENS, **changes: Any) -> Scene:
    table = {
        "backdrop": PlainBackdrop(bgr=BLACK, stains=0.0),
        "blur": Blur(sigma_px=0.0),
        "sensor": Sensor(noise=0.0, tone=Tone.LINEAR),
        **changes,
    }
    return Scene(camera=camera, target=target, seed=1, **table)


def ball(position_m: tuple[float, float, float], diameter_m: float) -> BallTarget:
    return BallTarget(position_m=position_m, diameter_m=diameter_m, bgr=WHITE, ambient=1.0)


def sheet(pose: Pose, width_m: float = 0.297, height_m: float = 0.21) -> SheetTarget:
    return SheetTarget(pose=pose, width_m=width_m, height_m=height_m, bgr=WHITE)


def cover(scene: Scene) -> Cover:
    return render(scene).image[:, :, 1].astype(np.float64) / 255


def edge_errors(covered: Cover, edge_px: NDArray[np.float64], outwards: NDArray[np.float64]) -> NDArray[np.float64]:
    """Walk across an edge and return how much further out than the given points it is.

    The cover along a walk adds up to the length of its part inside.
    """
    reach = 3.0
    steps = np.linspace(-reach, reach, 241)
    walk = (edge_px[:, None, :] + outwards[:, None, :] * steps[None, :, None]).astype(np.float32)
    profiles = cv2.remap(covered.astype(np.float32), walk[..., 0], walk[..., 1], cv2.INTER_LINEAR)
    return (profiles[:, 1:] + profiles[:, :-1]).sum(axis=1) / 2 * (steps[1] - steps[0]) - reach


def spread(scene: Scene, across: bool) -> float:
    """Return the standard deviation of what a sharp vertical or horizontal edge of a large sheet becomes."""
    covered = cover(scene)
    profile = covered[240, :] if across else covered[:, 320]
    steps = np.diff(profile[: 320 if across else 240])
    places = np.arange(len(steps))
    mean = float((steps * places).sum() / steps.sum())
    return math.sqrt(float((steps * (places - mean) ** 2).sum() / steps.sum()))


# What is drawn is where geometry has it.

SQUARE = CameraModel.with_focal_length(600.0, 640, 480)
OBLONG = CameraModel(width_px=640, height_px=480, fx_px=500.0, fy_px=700.0, cx_px=300.0, cy_px=260.0)
TURNED = Pose(position_m=(0.13, -0.08, 1.1), tilt_rad=0.9, tilt_towards_rad=0.4, roll_rad=0.3)


@pytest.mark.parametrize("camera", [SQUARE, OBLONG], ids=["square pixels", "oblong pixels"])
@pytest.mark.parametrize(
    "place",
    [((0.0, 0.0, 1.0), 0.2), ((0.013, -0.027, 3.0), 0.2), ((0.6, 0.25, 1.6), 0.2), ((-0.31, 0.1, 1.0), 0.3)],
    ids=["on the axis", "far", "in a corner", "wide off"],
)
def test_the_limb_of_a_ball_is_where_the_exact_cone_has_it(camera, place) -> None:
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
def test_the_corners_of_a_sheet_are_where_opencv_projects_them(distortion) -> None:
    matrix = np.array(((600.0, 0, 319.5), (0, 600.0, 239.5), (0, 0, 1)))
    target = sheet(TURNED)
    rotation, _ = cv2.Rodrigues(TURNED.rotation())
    own = np.array(((-0.1485, -0.105, 0), (0.1485, -0.105, 0), (0.1485, 0.105, 0), (-0.1485, 0.105, 0)))
    expected, _ = cv2.projectPoints(own, rotation, np.array(TURNED.position_m), matrix, np.array(distortion))
    truth = render(bare(target, replace(SQUARE, distortion=distortion))).truth
    assert truth.outline_px == pytest.approx(expected.reshape(-1, 2), abs=1e-6)


@pytest.mark.parametrize("distortion", [(0.0,) * 5, BARREL], ids=["pinhole", "barrel"])
@pytest.mark.parametrize("skew_px", [(0.0, 0.0), (24.0, 0.0), (0.0, 16.0)], ids=["still", "sideways", "down"])
def test_the_sides_of_a_sheet_are_drawn_where_its_points_are_projected(distortion, skew_px) -> None:
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


def test_a_tilted_disc_covers_the_ellipse_through_its_rim() -> None:
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


# Each trouble does to the picture what it says.

LENS = CameraModel.with_focal_length(600.0, 640, 480)
FACING = Pose(position_m=(0.0, 0.0, 1.0))


@pytest.mark.parametrize(("tone", "code"), [(Tone.SRGB, 188), (Tone.LINEAR, 128), (Tone.GAMMA_1_8, 173)])
def test_a_pixel_half_covered_by_white_has_the_code_value_of_half_the_light(tone, code) -> None:
    # The right edge goes through the middle of column 400.
    right_m = (400 - 319.5) / 600
    target = sheet(Pose(position_m=(right_m - 0.1, 0.0, 1.0)), 0.2, 0.2)
    image = render(bare(target, sensor=Sensor(noise=0.0, tone=tone))).image
    assert image[240, 398:403, 1].tolist() == [255, 255, code, 0, 0]


@pytest.mark.parametrize("sigma_px", [0.7, 1.2, 2.5])
def test_the_point_spread_has_its_standard_deviation(sigma_px) -> None:
    scene = bare(sheet(FACING), blur=Blur(sigma_px=sigma_px))
    # A pixel is a square of its own, whose variance is 1/12, and so is the step from one to the next.
    assert spread(scene, across=True) == pytest.approx(math.hypot(sigma_px, math.sqrt(1 / 6)), abs=0.03)


def test_motion_blurs_along_its_direction_only() -> None:
    scene = bare(sheet(FACING), blur=Blur(sigma_px=0.7, motion_px=10.0, direction_rad=0.0))
    still = spread(replace(scene, blur=Blur()), across=True)
    assert spread(scene, across=True) == pytest.approx(math.hypot(still, 10 / math.sqrt(12)), abs=0.05)
    assert spread(scene, across=False) == pytest.approx(still, abs=0.03)


@pytest.mark.parametrize("blur", [Blur(), Blur(motion_px=9.0, direction_rad=0.6)], ids=["point spread", "motion"])
def test_the_patch_around_a_target_has_no_seam(blur) -> None:
    backdrop = ClutterBackdrop()
    scene = bare(ball((0.02, 0.01, 2.0), 0.067), backdrop=backdrop, blur=blur)
    with_ball, empty = render(scene).image.astype(int), render(replace(scene, target=None)).image.astype(int)
    centre, radius = render(scene).truth.outline_px.mean(axis=0), 11.0
    rows, columns = np.indices(with_ball.shape[:2])
    away = np.hypot(columns - centre[0], rows - centre[1]) > radius + blur.reach_px + 1
    assert np.abs(with_ball - empty)[away].max() <= 1


@pytest.mark.parametrize(("share", "from_rad"), [(0.1, 0.0), (0.4, 2.1)])
def test_an_occluder_hides_its_share_of_the_target(share, from_rad) -> None:
    scene = bare(ball((0.1, 0.05, 1.0), 0.2))
    board = Occluder(share=share, from_rad=from_rad, bgr=(0, 0, 0))
    visible = cover(replace(scene, occluder=board)).sum() / cover(scene).sum()
    assert visible == pytest.approx(1 - share, abs=0.002)


# Hard balls and flat things are drawn as they say.

# Hard balls are drawn as they say: where they are, what is on them, and what cameras do to them.

HALF = 188
"""The code value of half the light of white."""

DARK = PlainBackdrop(bgr=(20, 20, 20))


def scene_of(surface: BallSurface, **changes: object) -> Scene:
    ball = BallTarget(position_m=(0.02, 0.01, 0.5), diameter_m=0.067, bgr=surface.bgr, ambient=1.0, surface=surface)
    clean = Sensor(noise=0.0)
    scene = Scene(camera=CAMERA, target=ball, seed=1, backdrop=DARK, blur=Blur(sigma_px=0.0), sensor=clean)
    return replace(scene, **changes)


@pytest.mark.parametrize("felt", [0.0, 0.01])
def test_a_ball_covers_the_area_of_its_outline_whether_smooth_or_felt(felt):
    made = render(scene_of(BallSurface(bgr=(255, 255, 255), felt=felt, seed=3), sensor=Sensor(noise=0.0)))
    covered = (made.image[:, :, 1] > HALF).sum()
    assert covered == pytest.approx(cv2.contourArea(made.truth.outline_px.astype(np.float32)), rel=0.015)


# Hard flat things are drawn as they say: how they are cut, curled and shaded, and what rooms are free of.

ALONG = np.linspace(-1, 1, 129)
POSE = Pose(position_m=(0.02, -0.03, 0.5), tilt_rad=0.5, tilt_towards_rad=0.7, roll_rad=0.2)
WHITE = (255, 255, 255)


def card(**changes) -> CutSheetTarget:
    return CutSheetTarget(**{"pose": POSE, "width_m": 0.1, "height_m": 0.075, "bgr": WHITE} | changes)


def outline_area_px(points_m) -> float:
    return cv2.contourArea(CAMERA.project(points_m[:, :2] / points_m[:, 2:]).astype(np.float32))


def test_cut_sides_are_off_by_the_most_over_the_square_root_of_three_in_all() -> None:
    cuts = [HandCut(ends_m=0.001, sides_m=0.002, seed=seed) for seed in range(300)]
    for side, most in ((0, 0.001), (1, 0.002)):
        off = np.array([cut.deviation_m(side, ALONG) for cut in cuts])
        assert math.sqrt((off**2).mean()) == pytest.approx(most / math.sqrt(3), rel=0.05)
        assert abs(off.mean()) < 0.1 * most


@pytest.mark.parametrize("cut_m", [0.0, 0.002])
def test_a_cut_sheet_covers_the_area_of_its_true_sides(cut_m) -> None:
    target = card(cut=HandCut(ends_m=cut_m, sides_m=cut_m, seed=4))
    assert cover(bare(target)).sum() == pytest.approx(outline_area_px(target.cut_outline_m()), rel=0.002)


def test_the_sides_of_a_cut_sheet_are_where_its_outline_has_them() -> None:
    target = card(cut=HandCut(ends_m=0.002, sides_m=0.002, seed=9))
    points_m = target.cut_outline_m()
    places = CAMERA.project(points_m[:, :2] / points_m[:, 2:])
    tangents = np.roll(places, -3, 0) - np.roll(places, 3, 0)
    outwards = np.column_stack((tangents[:, 1], -tangents[:, 0])) / np.linalg.norm(tangents, axis=1)[:, None]
    outwards *= np.sign((outwards * (places - places.mean(axis=0))).sum(axis=1))[:, None]
    # Away from the corners, where the walk leaves over the other side.
    middle = np.tile((np.abs(ALONG) < 0.8), 4)
    errors = edge_errors(cover(bare(target)), places[middle], outwards[middle])
    assert np.abs(errors).max() < 0.1
