"""A sheet that is looked for where its outline is expected, on rendered pictures whose truth is exact."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

import stadimeter.detectors.sheet as sheet_package
from stadimeter.core.detection import DetectionStatus, Prediction
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import MeasurementStatus, Track, TrackStatus
from stadimeter.detectors.sheet import SheetDetector, SheetOptions, follow
from stadimeter.perception.perceiver import Perceiver
from support.scenes.draw import CAMERA, empty_scene, sheet_scene
from support.scenes.nuisances import SHEET_NUISANCES
from support.scenes.plane import Pose
from support.scenes.render import render
from support.scenes.scene import Truth

pytestmark = pytest.mark.vision

MOVED_PX = np.array((2.0, -1.5))


def detector(**options: object) -> SheetDetector:
    return SheetDetector("paper", SheetOptions.model_validate({"width": "29.7 cm", "height": "21 cm", **options}))


def expected_near(truth: Truth, moved_px: np.ndarray = MOVED_PX, sigma_px: float = 2.0) -> Prediction:
    """Return what a tracker would expect of a sheet that was seen a moment ago, a few pixels from where it is now."""
    outline = truth.outline_px + moved_px
    longest_px = float(np.linalg.norm(np.roll(outline, 1, axis=0) - outline, axis=1).max())
    x, y = outline.mean(axis=0).tolist()
    return Prediction(centre_px=(x, y), size_px=longest_px, sigma_px=sigma_px, outline_px=outline)


def worst_px(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.abs(found[:, None] - truth[None]).max(axis=2).min(axis=0).max())


@pytest.fixture
def no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail where the picture is searched: the prediction has to do."""

    def refuse(*_: object) -> None:
        raise AssertionError("the picture was searched")

    monkeypatch.setattr(sheet_package, "SheetSearch", refuse)


@pytest.mark.usefixtures("no_search")
@pytest.mark.parametrize("name", SHEET_NUISANCES)
def test_a_tracked_sheet_is_as_exact_as_a_found_one_and_nothing_is_searched(name: str) -> None:
    for seed, tilt in ((3, 0.0), (6, 1.0)):
        made = render(SHEET_NUISANCES[name](sheet_scene(seed, tilt, plain=True)))
        found = detector().detect(Frame(made.image, 0.0, 0), expected_near(made.truth), lens=CAMERA)
        assert found.status is DetectionStatus.FOUND
        assert worst_px(found.outline_px, made.truth.outline_px) < (0.15 if name == "clean" else 0.4), (seed, tilt)
        assert 0 < found.size_sigma_px < 0.5


@pytest.mark.usefixtures("no_search")
def test_a_sheet_that_moved_by_three_standard_deviations_is_still_tracked() -> None:
    made = render(sheet_scene(4, 0.5, plain=True))
    expected = expected_near(made.truth, np.array((4.0, 4.0)), sigma_px=2.0)
    found = detector().detect(Frame(made.image, 0.0, 0), expected, lens=CAMERA)
    assert worst_px(found.outline_px, made.truth.outline_px) < 0.15


def test_a_lock_on_something_of_another_shape_is_left_at_once() -> None:
    """Something with four clear straight sides, but not those of the sheet, stands where the sheet is expected."""
    made = render(sheet_scene(4, 0.5, plain=True))
    size, lens = detector().target_shape, CAMERA
    for name in ("square", "ribbon", "kite"):
        image = np.full((480, 640, 3), 70, np.uint8)
        shapes = {
            "square": [(300, 200), (400, 200), (400, 300), (300, 300)],
            "ribbon": [(200, 200), (440, 200), (440, 240), (200, 240)],
            "kite": [(300, 150), (380, 200), (300, 330), (220, 200)],
        }
        corners = np.array(shapes[name], np.int32)
        cv2.fillPoly(image, [corners], (220, 225, 222))
        outline = corners.astype(np.float64)
        longest_px = float(np.linalg.norm(np.roll(outline, 1, axis=0) - outline, axis=1).max())
        expected = Prediction(centre_px=(320.0, 240.0), size_px=longest_px, sigma_px=2.0, outline_px=outline)
        assert follow(image, expected, size, 14.0, lens) is None, name
    # And elsewhere in the picture the sheet itself is found.
    wrong = replace(expected_near(made.truth), outline_px=np.array(shapes["kite"], np.float64))
    found = detector().detect(Frame(made.image, 0.0, 0), wrong, lens=CAMERA)
    assert worst_px(found.outline_px, made.truth.outline_px) < 0.15


@pytest.mark.long
def test_where_the_sheet_has_gone_nothing_is_followed() -> None:
    size = detector().target_shape
    for seed in range(8):
        truth = render(sheet_scene(seed, 0.4)).truth
        assert follow(render(empty_scene(seed)).image, expected_near(truth), size, 14.0, CAMERA) is None, seed


numbers = st.one_of(st.floats(-50, 700), st.sampled_from([math.nan, math.inf, -math.inf, 1e300]))


@settings(max_examples=60, deadline=None)
@given(corners=st.lists(numbers, min_size=8, max_size=8), sigma_px=st.one_of(st.floats(0.5, 50), numbers))
def test_whatever_outline_is_expected_the_sheet_is_found(corners: list[float], sigma_px: float) -> None:
    image, truth = PLAIN.image, PLAIN.truth
    expected = replace(expected_near(truth), outline_px=np.array(corners).reshape(4, 2), sigma_px=sigma_px)
    found = detector().detect(Frame(image, 0.0, 0), expected, lens=CAMERA)
    assert worst_px(found.outline_px, truth.outline_px) < 0.15


PLAIN = render(sheet_scene(4, 0.5, plain=True))


def track_of(truth: Truth, at_s: float) -> Track:
    x, y, z = truth.position_m
    return Track(
        target="paper",
        status=TrackStatus.TRACKING,
        as_of_s=at_s,
        measured_at_s=at_s,
        distance_m=truth.distance_m,
        sigma_m=0.005,
        bearing_rad=math.atan2(x, z),
        elevation_rad=-math.atan2(y, math.hypot(x, z)),
    )


def test_a_run_expects_the_outline_where_the_sheet_has_moved_to(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second frame is measured along the sides of the first one, moved to where the track expects the sheet."""
    scene = sheet_scene(4, 0.5, plain=True)
    pose: Pose = scene.target.pose
    x, y, z = pose.position_m
    later = replace(scene, target=replace(scene.target, pose=replace(pose, position_m=(x + 0.03, y, 0.98 * z))))
    first, second = render(scene), render(later)
    perceiver = Perceiver({"paper": detector()}, CAMERA)
    tracks = {"paper": track_of(second.truth, 0.0)}
    (before,) = perceiver.look(Frame(first.image, 0.0, 0), tracks)[1]
    assert before.status is MeasurementStatus.MEASURED
    monkeypatch.setattr(sheet_package, "SheetSearch", None)
    ((_,), (after,)) = perceiver.look(Frame(second.image, 0.05, 1), tracks)
    assert after.distance_m == pytest.approx(second.truth.distance_m, rel=0.002)
