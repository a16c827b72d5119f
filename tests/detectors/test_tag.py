"""The tag detector on rendered scenes, whose truth is exact, and on drawn tags."""

from __future__ import annotations

import math
import re
import subprocess
import sys

import cv2
import numpy as np
import pytest
from msgspec.structs import replace
from pydantic import ValidationError

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Prediction
from stadimeter.core.frame import Frame, Image
from stadimeter.detectors.sampling import light_table
from stadimeter.detectors.tag import TagDetector, TagOptions
from stadimeter.detectors.tag.search import DICTIONARIES, distinct, tag_family
from stadimeter.detectors.tag.sides import measure_sides
from support.each_case import each_case
from support.scenes.draw import tag_scene
from support.scenes.nuisances import distorted, motion, noise, tone
from support.scenes.render import render
from support.scenes.tone import Tone, encode
from support.through_lens import ThroughLens

pytestmark = [pytest.mark.vision, pytest.mark.oldest_opencv]


def detector(camera: CameraModel | None = None, **options: object) -> ThroughLens:
    return ThroughLens(TagDetector("tag", TagOptions.model_validate({"side": "10 cm", **options})), camera)


def seen(image: Image, prediction: Prediction | None = None, **options: object) -> Detection:
    return detector(**options).detect(Frame(image, 0.0, 0), prediction)


def pasted(
    *tags: tuple[int, int, int, int], family: str = "apriltag-36h11", quarters: int = 0, white: int = 1
) -> Image:
    """Draw tags, each given as number, left, top and side; pixel columns left to left + side - 1 are its own."""
    light = np.full((480, 640), white, np.float32)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARIES[family]))
    for number, left, top, side in tags:
        marker = np.rot90(cv2.aruco.generateImageMarker(dictionary, number, side), -quarters)
        light[top : top + side, left : left + side] = np.where(marker > 0, white, 1 - white)
    code = encode(cv2.GaussianBlur(0.03 + 0.6 * light, (0, 0), 0.8), Tone.SRGB)
    return cv2.cvtColor(np.rint(code).astype(np.uint8), cv2.COLOR_GRAY2BGR)


def square(left: int, top: int, side: int) -> np.ndarray:
    right, bottom = left + side - 0.5, top + side - 0.5
    return np.array([(left - 0.5, top - 0.5), (right, top - 0.5), (right, bottom), (left - 0.5, bottom)])


def worst_px(found: Detection, truth: np.ndarray) -> float:
    """Return how far the worst corner is off, whichever corner is called the first."""
    return min(float(np.abs(np.roll(found.outline_px, turn, axis=0) - truth).max()) for turn in range(4))


@pytest.mark.parametrize(
    ("side_px", "tilt_deg", "limit_px"), [(48, 0, 0.15), (48, 40, 0.25), (100, 20, 0.1), (200, 50, 0.1)]
)
def test_the_corners_are_found_to_a_fraction_of_a_pixel(side_px: int, tilt_deg: int, limit_px: float) -> None:
    made = render(tag_scene(11, side_px, math.radians(tilt_deg)))
    found = seen(made.image)
    assert found.status is DetectionStatus.FOUND
    assert (found.target, found.reason) == ("tag", "")
    assert worst_px(found, made.truth.outline_px) < limit_px
    assert 0 < found.size_sigma_px < 0.1
    assert 0.5 < found.quality <= 1


def test_without_a_number_the_largest_tag_is_taken_and_the_reason_says_so() -> None:
    found = seen(pasted((3, 60, 60, 60), (9, 300, 200, 120), (5, 60, 300, 80)))
    assert worst_px(found, square(300, 200, 120)) < 0.1
    assert found.reason == "tag 9, one of 3 of apriltag-36h11 in view; name one with id"


def test_a_number_that_is_not_in_view_is_missed_by_name() -> None:
    found = seen(pasted((3, 60, 60, 60), (9, 300, 200, 120)), id=4)
    assert found.status is DetectionStatus.NOT_FOUND
    assert found.reason == "no tag 4 of apriltag-36h11, only 3, 9"


def test_tags_of_another_family_are_not_taken() -> None:
    found = seen(pasted((3, 200, 200, 120), family="aruco-6x6-250"))
    assert found.status is DetectionStatus.NOT_FOUND
    assert found.reason.startswith("no tag of apriltag-36h11 of at least 10 px among ")


@pytest.mark.long
@each_case("family", sorted(DICTIONARIES))
def test_every_family_is_read_whichever_way_it_is_turned(family: str) -> None:
    first = []
    for quarters in range(4):
        found = seen(pasted((17, 200, 150, 120), family=family, quarters=quarters), family=family, id=17)
        assert found.status is DetectionStatus.FOUND, quarters
        first.append(np.asarray(found.outline_px[0]))
    corners = square(200, 150, 120)
    turned_back = corners[[2, 3, 0, 1]] if family.startswith("apriltag") else corners
    assert np.array(first) == pytest.approx(turned_back, abs=0.1)


@pytest.mark.parametrize("family", ["apriltag-16h5", "apriltag-25h9", "apriltag-36h11"])
def test_corners_start_where_the_authors_of_apriltag_say(family: str) -> None:
    library = pytest.importorskip("pyapriltags")
    picture = pasted((5, 200, 150, 120), family=family)
    other = library.Detector(families="tag" + family.removeprefix("apriltag-"))
    (theirs,) = other.detect(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))
    assert np.asarray(seen(picture, family=family).outline_px) == pytest.approx(theirs.corners[::-1] - 0.5, abs=0.8)


def test_white_on_black_counts_only_where_it_is_asked_for() -> None:
    negative = pasted((3, 200, 200, 120), white=0)
    assert seen(negative).status is DetectionStatus.NOT_FOUND
    assert worst_px(seen(negative, inverted=True), square(200, 200, 120)) < 0.1
    assert seen(pasted((3, 200, 200, 120)), inverted=True).status is DetectionStatus.FOUND


def test_a_bent_picture_of_a_tag_has_its_corners_where_the_lens_puts_them() -> None:
    scene = distorted(tag_scene(40, 150, 0.3))
    made = render(scene)
    found = detector(scene.camera).detect(Frame(made.image, 0.0, 0))
    assert worst_px(found, made.truth.outline_px) < 0.1
    assert worst_px(seen(made.image), made.truth.outline_px) > 0.2, "the lens matters in this picture"


def test_a_linear_camera_is_believed_to_be_one() -> None:
    scene = tone(Tone.LINEAR)(tag_scene(41, 80, 0.2))
    made = render(scene)
    found = detector(replace(scene.camera, tone_curve="linear")).detect(Frame(made.image, 0.0, 0))
    assert worst_px(found, made.truth.outline_px) < 0.1
    assert worst_px(seen(made.image), made.truth.outline_px) > 0.3, "the tone curve matters in this picture"


@pytest.mark.parametrize("inverted", [False, True])
def test_an_edge_bias_makes_a_black_tag_larger_and_a_white_one_smaller(inverted: bool) -> None:
    picture = pasted((3, 200, 200, 120), white=0 if inverted else 1)
    camera = CameraModel.with_focal_length(600.0, 640, 480)
    plain = detector(camera, inverted=inverted).detect(Frame(picture, 0.0, 0))
    biased = detector(replace(camera, edge_bias_px=0.25), inverted=inverted).detect(Frame(picture, 0.0, 0))
    assert biased.width_px - plain.width_px == pytest.approx(-0.5 if inverted else 0.5, abs=1e-6)
    assert biased.centre_px == pytest.approx(plain.centre_px)


@pytest.mark.parametrize("trouble", [noise(8), motion(4), motion(8)])
def test_noise_and_motion_move_the_corners_by_less_than_a_third_of_a_pixel(trouble) -> None:
    made = render(trouble(tag_scene(14, 110, 0.3)))
    found = seen(made.image)
    assert found.status is DetectionStatus.FOUND
    assert worst_px(found, made.truth.outline_px) < 0.3


def test_a_tag_whose_cells_are_two_pixels_wide_is_read_and_its_sigma_says_how_small_it_is() -> None:
    family = "aruco-4x4-50"
    for number in range(1, 8):
        found = seen(pasted((number, 300, 200, 12), family=family), family=family)
        assert (found.status, found.number) == (DetectionStatus.FOUND, number)
        assert abs(found.width_px - 12) < 2 * found.size_sigma_px < 1.5


def test_a_large_picture_is_searched_from_its_smallest_copy_on() -> None:
    picture = cv2.resize(pasted((3, 200, 200, 120)), (4000, 3000), interpolation=cv2.INTER_CUBIC)
    truth = (square(200, 200, 120) + 0.5) * 6.25 - 0.5
    assert worst_px(seen(picture), truth) < 0.5


def chequered(width: int, height: int, cell: int) -> Image:
    y, x = np.mgrid[:height, :width]
    grey = np.where((x // cell + y // cell) % 2, 230, 30).astype(np.uint8)
    return cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)


def test_a_large_tag_on_a_chequered_floor_is_found() -> None:
    picture = chequered(1280, 960, 16)
    picture[330:570, 430:670] = pasted((3, 200, 200, 120))[140:380, 140:380]
    assert worst_px(seen(picture), square(490, 390, 120)) < 0.1


def test_colour_at_half_the_resolution_makes_the_size_less_certain() -> None:
    frame, camera = Frame(pasted((3, 200, 200, 120)), 0.0, 0), CameraModel.with_focal_length(600.0, 640, 480)
    full, halved = (
        detector(replace(camera, subsampling=each)).detect(frame).size_sigma_px for each in ("4:4:4", "4:2:0")
    )
    assert halved > full > 0
    assert halved > 0.02


@pytest.mark.parametrize(
    ("written", "meant"),
    [("36h11", "apriltag-36h11"), ("4x4-50", "aruco-4x4-50"), ("ArUco_Original", "aruco-original")],
)
def test_a_family_may_be_written_shortly(written: str, meant: str) -> None:
    assert TagOptions.model_validate({"side": "8 cm", "family": written}).family == meant


@each_case(
    ("options", "said"),
    [
        ({"family": "apriltag-36h12"}, "did you mean 'apriltag-36h1"),
        ({"family": "april-36h11"}, "did you mean 'apriltag-36h11'?"),
        ({"family": "qr"}, "There are: aruco-4x4-50, "),
        ({"family": 36}, "is not a family of tags"),
        ({"family": "4x4-50", "id": 50}, "50 is not in aruco-4x4-50, whose tags are numbered 0 to 49"),
        ({"id": -1}, "greater than or equal to 0"),
        ({"side": "0 cm"}, "not a length above zero"),
        ({"min_side_px": 4}, "greater than or equal to 8"),
        ({"size": "8 cm"}, "Extra inputs"),
    ],
)
def test_wrong_options_are_refused_with_a_reason(options: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError) as caught:
        TagOptions.model_validate({"side": "8 cm", **options})
    assert said in str(caught.value)


def test_other_tags_and_outlines_without_a_tag_are_told_with_the_test_that_they_failed() -> None:
    picture = pasted((3, 60, 60, 60), (9, 300, 200, 120))
    cv2.rectangle(picture, (60, 300), (140, 380), (20, 20, 20), -1)
    cv2.rectangle(picture, (75, 315), (125, 365), (240, 240, 240), -1)
    found = seen(picture, id=9)
    assert worst_px(found, square(300, 200, 120)) < 0.1
    by_reason = {each.reason: each for each in found.rejected}
    assert by_reason["is tag 3, not 9"].centre_px == pytest.approx((89.5, 89.5), abs=1)
    assert by_reason["is tag 3, not 9"].size_px == pytest.approx(60, abs=3)
    others = [each.reason for each in found.rejected if each.centre_px == pytest.approx((100, 340), abs=2)]
    assert any(re.search(r"differs from every tag in \d+ cells or more, limit 3", reason) for reason in others)
    assert len(found.rejected) <= 8


@pytest.mark.parametrize("sigma_px", [0.6, 2.0, 4.5])
def test_sides_are_where_they_are_however_blurred_and_wherever_the_search_starts(sigma_px: float) -> None:
    """A wide edge fills the first look, which must not take the edge's own grey for black and white."""
    light = np.full((480, 640), 0.7, np.float32)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARIES["apriltag-36h11"]))
    light[100:340, 200:440] = np.where(cv2.aruco.generateImageMarker(dictionary, 5, 240) > 0, 0.7, 0.03)
    grey = np.rint(encode(cv2.GaussianBlur(light, (0, 0), sigma_px), Tone.SRGB)).astype(np.uint8)
    truth = square(200, 100, 240)
    for off_px in (-4.0, -1.0, 0.0, 2.0, 4.0):
        start = truth + off_px * np.array(((-1, -1), (1, -1), (1, 1), (-1, 1)))
        sides = measure_sides(grey, start, 8, light_table("srgb"))
        assert sides is not None
        assert np.abs(sides.corners_px - truth).max() < 0.02 * sigma_px
        assert sides.edge_px == pytest.approx([math.sqrt(2 * math.pi) * sigma_px] * 4, rel=0.15)


def test_so_many_wrong_cells_are_accepted_as_leave_no_doubt_whatever_the_version_of_opencv() -> None:
    """Six tenths of what a family could correct: half of the least distance that its authors state, rounded down."""
    accepted = {name: tag_family(name).max_errors for name in ("apriltag-16h5", "apriltag-36h11", "aruco-mip-36h12")}
    assert accepted == {"apriltag-16h5": 1, "apriltag-36h11": 3, "aruco-mip-36h12": 3}


@pytest.mark.parametrize("bow_px", [0.6, -1.5, 3.0])
def test_a_tag_with_a_bent_side_owns_up_to_it(bow_px: float) -> None:
    """The upper side is bowed between its corners, which stay, as if the paper curled there."""
    flat = pasted((3, 260, 180, 120))
    down, along = np.mgrid[:480, :640].astype(np.float32)
    from_middle, below = (along - 319.5) / 60, (down - 179.5) / 120
    moved = bow_px * np.clip(1 - from_middle**2, 0, 1) * np.clip(1 - np.abs(below), 0, 1)
    bent = cv2.remap(flat, along, down + moved, cv2.INTER_CUBIC)
    straight_side, bent_side = seen(flat), seen(bent)
    assert bent_side.size_sigma_px > 5 * straight_side.size_sigma_px
    off_px = abs(math.sqrt(bent_side.width_px * bent_side.height_px) - 120)
    assert 0.3 * bent_side.size_sigma_px < off_px < 2.5 * bent_side.size_sigma_px


MAX_MEGABYTES = 2000
MEASURE_PEAK = """
import re
from pathlib import Path
import numpy as np
from stadimeter.core.frame import Frame
from stadimeter.detectors.tag import TagDetector, TagOptions

detector = TagDetector("tag", TagOptions.model_validate({"side": "53 mm"}))
noise = np.random.default_rng(3).integers(0, 256, (6250, 8000, 3), np.uint8)
detector.detect(Frame(noise, 0.0, 0))
# Not `ru_maxrss`: that begins with the memory of the program that started this one, which may have pictures in it.
print(int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]) // 1024)
"""


def _wall_with_tag(side_px: int, left_px: int, top_px: int) -> Frame:
    """Return 24 megapixels of a light wall with a tag on it."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    grey = np.full((4000, 6000), 200, np.uint8)
    grey[top_px : top_px + side_px, left_px : left_px + side_px] = cv2.aruco.generateImageMarker(dictionary, 5, side_px)
    return Frame(np.repeat(grey[..., None], 3, axis=2), 0.0, 0)


@pytest.mark.parametrize("side_px", [32, 80, 800])
def test_a_tag_in_a_very_large_picture_is_measured_in_full(side_px: int) -> None:
    found = detector().detect(_wall_with_tag(side_px, 4100, 2300))
    assert found.status is DetectionStatus.FOUND
    assert found.number == 5
    assert found.width_px == pytest.approx(side_px, abs=0.3)


@pytest.mark.long
def test_fifty_megapixels_of_noise_are_searched_in_bounded_memory() -> None:
    peak = subprocess.run([sys.executable, "-c", MEASURE_PEAK], check=True, capture_output=True, text=True).stdout
    assert int(peak) < MAX_MEGABYTES


SQUARE_PX = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0]])


@pytest.mark.long
def test_a_chequered_floor_has_tens_of_thousands_of_outlines_and_each_counts_once() -> None:
    places = np.stack(np.meshgrid(np.arange(200.0), np.arange(200.0)), axis=-1).reshape(-1, 1, 2) * 20
    floor = SQUARE_PX + places
    assert np.array_equal(distinct(np.concatenate([floor, floor + 0.5])), floor)
