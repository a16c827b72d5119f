"""The picture detector on rendered posters, whose truth is exact."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.config.plugins import DriverContext
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import DetectionStatus
from stadimeter.core.measurement import MeasurementStatus
from stadimeter.detectors.picture import PictureDetector, PictureOptions
from stadimeter.errors import PictureError
from stadimeter.testing.rig import ManualClock
from support.detector_rigs import poster_file
from support.scenes import draw
from support.scenes.nuisances import noise
from support.scenes.occluder import Occluder
from support.scenes.poster import poster_scene
from support.scenes.render import render
from support.through_lens import ThroughLens

pytestmark = [pytest.mark.vision, pytest.mark.oldest_opencv]

BENT = replace(draw.CAMERA, distortion=(-0.15, 0.03, 0.0, 0.0, 0.0))


def detector(seed: int, camera: CameraModel = draw.CAMERA, **options: object) -> ThroughLens:
    table = {"file": str(poster_file(seed)), "width": "40 cm", **options}
    return ThroughLens(PictureDetector("poster", PictureOptions.model_validate(table)), camera)


def frame_of(made):
    from stadimeter.core.frame import Frame

    return Frame(made.image, 0.0, 0)


@pytest.mark.long
@pytest.mark.parametrize(("seed", "side_px", "tilt_deg"), [(1, 80, 0), (2, 120, 30), (3, 250, 50)])
def test_a_poster_is_measured_to_half_a_percent_and_within_its_interval(seed, side_px, tilt_deg):
    made = render(poster_scene(seed, side_px, math.radians(tilt_deg)))
    measured = detector(seed).measure(frame_of(made))
    assert measured.distance_m == pytest.approx(made.truth.distance_m, rel=0.005)
    assert abs(measured.distance_m - made.truth.distance_m) < 4 * measured.sigma_m


def test_a_small_poster_is_found_where_a_place_of_the_clutter_is_like_many_of_its_key_points():
    made = render(poster_scene(5055, 60, math.radians(8)))
    measured = detector(5055, min_side_px=24).measure(frame_of(made))
    assert measured.distance_m == pytest.approx(made.truth.distance_m, rel=0.01)


@pytest.mark.long
def test_a_lens_that_bends_lines_changes_nothing():
    made = render(poster_scene(4, 200, math.radians(20), BENT))
    measured = detector(4, BENT).measure(frame_of(made))
    assert measured.distance_m == pytest.approx(made.truth.distance_m, rel=0.003)


@pytest.mark.long
def test_a_poster_of_which_a_tenth_is_hidden_is_measured():
    scene = replace(poster_scene(5, 200, 0.3), occluder=Occluder(share=0.1))
    made = render(scene)
    measured = detector(5).measure(frame_of(made))
    assert measured.distance_m == pytest.approx(made.truth.distance_m, rel=0.01)


@pytest.mark.long
def test_another_poster_is_not_taken_for_it():
    for seed in range(10, 16):
        found = detector(5).detect(frame_of(render(poster_scene(seed, 250, 0.2))))
        assert found.status is DetectionStatus.NOT_FOUND, f"poster {seed}: {found}"


def test_a_small_one_is_refused_with_its_size():
    made = render(poster_scene(6, 80, 0.0))
    measured = detector(6, min_side_px=100).measure(frame_of(made))
    assert measured.status is MeasurementStatus.NOT_FOUND
    assert "too small: 6" in measured.reason


@pytest.mark.long
def test_noise_is_in_the_standard_deviation():
    scene = poster_scene(7, 120, 0.3)
    clean, noisy = (detector(7).measure(frame_of(render(each))) for each in (scene, noise(12)(scene)))
    assert noisy.noise_m > 1.5 * clean.noise_m


@pytest.mark.long
def test_the_height_follows_from_the_file_and_the_width():
    assert detector(5).target_shape.height_m == pytest.approx(0.30)
    only_height = PictureOptions.model_validate({"file": str(poster_file(5)), "height": "30 cm"})
    built = only_height.build(DriverContext(name="p", clock=ManualClock()))
    assert built.target_shape.width_m == pytest.approx(0.40)


@pytest.mark.long
@pytest.mark.parametrize(
    ("make", "said"),
    [
        (None, "cannot be read"),
        (lambda path: path.write_bytes(b"no picture"), "not a picture|is not|cannot be decoded"),
        (lambda path: cv2.imwrite(str(path), np.full((300, 400, 3), 200, np.uint8)), "too plain"),
    ],
    ids=["missing", "text", "plain"],
)
def test_a_file_that_cannot_be_used_is_said_at_once(tmp_path, make, said):
    path = tmp_path / "poster.png"
    if make is not None:
        make(path)
    options = PictureOptions.model_validate({"file": str(path), "width": "40 cm"})
    with pytest.raises(PictureError, match=said) as caught:
        options.build(DriverContext(name="poster", clock=ManualClock()))
    assert str(path) in str(caught.value)
    assert options.lacks() == (str(caught.value),)


def test_proportions_that_are_not_those_of_the_file_are_refused():
    with pytest.raises(PictureError, match="other proportions"):
        detector(5, height="20 cm")
