"""Scenes are drawn as they say: where everything is, and what each trouble does."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.detectors.hsv import parse_hsv_range
from stadimeter.simulation.camera import silhouette
from support.each_case import each_case
from support.scenes import hard_flats
from support.scenes.backdrop import ClutterBackdrop, PlainBackdrop
from support.scenes.ball import BallSurface, BallTarget, Marking
from support.scenes.cut_sheet import CutSheetTarget, GroupTarget, HandCut
from support.scenes.draw import CAMERA, MARGIN_PX, ball_scene, disc_scene, empty_scene, sheet_scene, tag_scene
from support.scenes.hard_balls import BALLS, picked_range
from support.scenes.nuisances import BARREL, distractors
from support.scenes.occluder import Hand, Occluder
from support.scenes.plane import DiscTarget, Pose, SheetTarget, TagTarget
from support.scenes.render import render
from support.scenes.scene import Scene
from support.scenes.sensor import Blur, Sensor
from support.scenes.tone import Tone

pytestmark = pytest.mark.vision


# What is drawn is where geometry has it.

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


# Each trouble does to the picture what it says.

LENS = CameraModel.with_focal_length(600.0, 640, 480)
FACING = Pose(position_m=(0.0, 0.0, 1.0))


@pytest.mark.parametrize(("tone", "code"), [(Tone.SRGB, 188), (Tone.LINEAR, 128), (Tone.GAMMA_1_8, 173)])
def test_a_pixel_half_covered_by_white_has_the_code_value_of_half_the_light(bare, sheet, tone, code) -> None:
    # The right edge goes through the middle of column 400.
    right_m = (400 - 319.5) / 600
    target = sheet(Pose(position_m=(right_m - 0.1, 0.0, 1.0)), 0.2, 0.2)
    image = render(bare(target, sensor=Sensor(noise=0.0, tone=tone))).image
    assert image[240, 398:403, 1].tolist() == [255, 255, code, 0, 0]


def test_a_trouble_keeps_the_target_and_the_clutter() -> None:
    scene = ball_scene(7)
    quiet, noisy = (render(replace(scene, sensor=Sensor(noise=level))).image.astype(float) for level in (0.0, 8.0))
    difference = noisy - quiet
    inside = (quiet > 40) & (quiet < 215)
    assert difference[inside].std() == pytest.approx(8.0, rel=0.02)
    assert abs(difference[inside].mean()) < 0.05


@pytest.mark.parametrize("sigma_px", [0.7, 1.2, 2.5])
def test_the_point_spread_has_its_standard_deviation(bare, sheet, spread, sigma_px) -> None:
    scene = bare(sheet(FACING), blur=Blur(sigma_px=sigma_px))
    # A pixel is a square of its own, whose variance is 1/12, and so is the step from one to the next.
    assert spread(scene, across=True) == pytest.approx(math.hypot(sigma_px, math.sqrt(1 / 6)), abs=0.03)


def test_motion_blurs_along_its_direction_only(bare, sheet, spread) -> None:
    scene = bare(sheet(FACING), blur=Blur(sigma_px=0.7, motion_px=10.0, direction_rad=0.0))
    still = spread(replace(scene, blur=Blur()), across=True)
    assert spread(scene, across=True) == pytest.approx(math.hypot(still, 10 / math.sqrt(12)), abs=0.05)
    assert spread(scene, across=False) == pytest.approx(still, abs=0.03)


@pytest.mark.parametrize("blur", [Blur(), Blur(motion_px=9.0, direction_rad=0.6)], ids=["point spread", "motion"])
def test_the_patch_around_a_target_has_no_seam(bare, ball, blur) -> None:
    backdrop = ClutterBackdrop()
    scene = bare(ball((0.02, 0.01, 2.0), 0.067), backdrop=backdrop, blur=blur)
    with_ball, empty = render(scene).image.astype(int), render(replace(scene, target=None)).image.astype(int)
    centre, radius = render(scene).truth.outline_px.mean(axis=0), 11.0
    rows, columns = np.indices(with_ball.shape[:2])
    away = np.hypot(columns - centre[0], rows - centre[1]) > radius + blur.reach_px + 1
    assert np.abs(with_ball - empty)[away].max() <= 1


@pytest.mark.parametrize(("share", "from_rad"), [(0.1, 0.0), (0.4, 2.1)])
def test_an_occluder_hides_its_share_of_the_target(bare, ball, cover, share, from_rad) -> None:
    scene = bare(ball((0.1, 0.05, 1.0), 0.2))
    board = Occluder(share=share, from_rad=from_rad, bgr=(0, 0, 0))
    visible = cover(replace(scene, occluder=board)).sum() / cover(scene).sum()
    assert visible == pytest.approx(1 - share, abs=0.002)


def test_distractors_have_the_targets_colour_and_keep_away_from_it() -> None:
    def of_the_colour(scene: Scene) -> np.ndarray:
        hsv = cv2.cvtColor(render(scene).image, cv2.COLOR_BGR2HSV)
        return cv2.inRange(hsv, (34, 180, 150), (40, 210, 255)) > 0

    scene = ball_scene(2)
    more = of_the_colour(distractors(12)(scene)) & ~of_the_colour(scene)
    assert more.sum() > 200
    outline = render(scene).truth.outline_px
    rows, columns = np.indices(more.shape)
    off = np.hypot(columns - outline[:, 0].mean(), rows - outline[:, 1].mean())
    assert off[more].min() > 1.2 * np.ptp(outline[:, 0]) / 2


@each_case(
    "wrong",
    [
        lambda: BallTarget(position_m=(0, 0, 0.05), diameter_m=0.2),
        lambda: BallTarget(position_m=(0, 0, 1.0), diameter_m=float("nan")),
        lambda: Pose(position_m=(0, 0, -1.0)),
        lambda: Pose(position_m=(0, 0, 1.0), tilt_rad=1.6),
        lambda: SheetTarget(pose=FACING, width_m=0.2, height_m=0.0),
        lambda: DiscTarget(pose=FACING, diameter_m=float("inf")),
        lambda: TagTarget(pose=FACING, side_m=0.1, number=587),
        lambda: TagTarget(pose=FACING, side_m=0.1, family="apriltag-1h1"),
        lambda: Occluder(share=1.0),
        lambda: Blur(sigma_px=-1.0),
        lambda: Sensor(jpeg_quality=0),
        lambda: Sensor(noise=float("nan")),
        lambda: Scene(camera=LENS, target=None, seed=1, finer=0),
    ],
)
def test_what_cannot_be_drawn_is_refused(wrong) -> None:
    with pytest.raises(ValueError, match=r"\d|nan|inf"):
        wrong()


# Hard balls and flat things are drawn as they say.

# Hard balls are drawn as they say: where they are, what is on them, and what cameras do to them.

GREEN = BALLS["green"]
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


@pytest.mark.parametrize("marking", [each for each in Marking if each is not Marking.NONE])
def test_every_marking_shows_its_own_colour_beside_the_ball_s(marking):
    shown = set()
    for seed in range(6):  # some logos are on the far side
        image = render(scene_of(BallSurface(bgr=GREEN, marking=marking, marking_bgr=(255, 255, 255), seed=seed))).image
        inside = image[205:295, 270:395].reshape(-1, 3).astype(int)
        shown |= {"pale"} if (inside.min(axis=1) > 200).any() else set()
        shown |= {"green"} if (np.abs(inside - GREEN).max(axis=1) < 25).any() else set()
    assert shown == {"pale", "green"}


def test_fingers_cover_a_part_of_the_ball_and_leave_the_rest():
    surface = BallSurface(bgr=(255, 255, 255))
    free = render(scene_of(surface)).image[:, :, 0] > 240
    held = render(scene_of(surface, occluder=Hand(depth=0.4, bgr=(60, 80, 120)))).image[:, :, 0] > 240
    assert 0.5 * free.sum() < held.sum() < 0.95 * free.sum()
    assert not (held & ~free).any()


def test_the_range_that_a_user_picks_holds_most_of_the_ball_and_none_of_its_markings():
    for colour in BALLS.values():
        picked = parse_hsv_range(picked_range(colour))
        assert picked.mask(np.full((4, 4, 3), colour, np.uint8)).all()
        assert not picked.mask(np.full((4, 4, 3), (225, 230, 228), np.uint8)).any()


# Hard flat things are drawn as they say: how they are cut, curled and shaded, and what rooms are free of.

ALONG = np.linspace(-1, 1, 129)
POSE = Pose(position_m=(0.02, -0.03, 0.5), tilt_rad=0.5, tilt_towards_rad=0.7, roll_rad=0.2)
WHITE = (255, 255, 255)


def card(**changes) -> CutSheetTarget:
    return CutSheetTarget(**{"pose": POSE, "width_m": 0.1, "height_m": 0.075, "bgr": WHITE} | changes)


def outline_area_px(points_m) -> float:
    return cv2.contourArea(CAMERA.project(points_m[:, :2] / points_m[:, 2:]).astype(np.float32))


@given(seed=st.integers(0, 10**6), most_mm=st.floats(0.1, 3.0), side=st.integers(0, 3))
@settings(max_examples=40)
def test_no_place_of_a_cut_side_is_off_by_more_than_the_most(seed, most_mm, side) -> None:
    cut = HandCut(ends_m=most_mm / 1000, sides_m=most_mm / 1000, seed=seed)
    assert np.abs(cut.deviation_m(side, ALONG)).max() <= most_mm / 1000


def test_cut_sides_are_off_by_the_most_over_the_square_root_of_three_in_all() -> None:
    cuts = [HandCut(ends_m=0.001, sides_m=0.002, seed=seed) for seed in range(300)]
    for side, most in ((0, 0.001), (1, 0.002)):
        off = np.array([cut.deviation_m(side, ALONG) for cut in cuts])
        assert math.sqrt((off**2).mean()) == pytest.approx(most / math.sqrt(3), rel=0.05)
        assert abs(off.mean()) < 0.1 * most


@pytest.mark.parametrize("cut_m", [0.0, 0.002])
def test_a_cut_sheet_covers_the_area_of_its_true_sides(bare, cover, cut_m) -> None:
    target = card(cut=HandCut(ends_m=cut_m, sides_m=cut_m, seed=4))
    assert cover(bare(target)).sum() == pytest.approx(outline_area_px(target.cut_outline_m()), rel=0.002)


def test_the_sides_of_a_cut_sheet_are_where_its_outline_has_them(bare, cover, edge_errors) -> None:
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


def test_of_two_strips_both_are_drawn_and_the_first_is_the_truth(bare, cover) -> None:
    first = card(pose=Pose(position_m=(-0.08, 0.0, 0.5)))
    pair = GroupTarget(first=first, others=(card(pose=Pose(position_m=(0.08, 0.0, 0.5))),))
    seen = cover(bare(pair))
    assert seen.sum() == pytest.approx(2 * cover(bare(first)).sum(), rel=0.01)
    assert render(bare(pair)).truth.outline_px == pytest.approx(render(bare(first)).truth.outline_px)


@pytest.mark.parametrize("make", [hard_flats.hard_sheet, hard_flats.hard_tape, hard_flats.hard_disc])
def test_a_drawn_target_is_whole_and_not_smaller_than_asked_for(make) -> None:
    for seed in range(12):
        scene = make(seed).scene
        corners = scene.target.outline_m()
        places = CAMERA.project(corners[:, :2] / corners[:, 2:])
        assert (places >= MARGIN_PX - 1).all()
        assert (places <= np.array((640, 480)) - MARGIN_PX + 1).all()
        if len(places) == 4:
            assert np.linalg.norm(np.roll(places, -1, 0) - places, axis=1).min() >= hard_flats.LEAST_SIDE_PX


@each_case("bgr", hard_flats.SHEET_BGRS + hard_flats.TAPE_BGRS)
def test_the_range_that_a_user_picks_holds_the_colour_of_the_target(bgr) -> None:
    flat = replace(hard_flats.hard_sheet(1), bgr=bgr)
    low, high = (np.array(part.split(","), int) for part in flat.hsv.split(":"))
    colour = cv2.cvtColor(np.array([[bgr]], np.uint8), cv2.COLOR_BGR2HSV)[0, 0]
    assert (low <= colour).all()
    assert (colour <= high).all()
