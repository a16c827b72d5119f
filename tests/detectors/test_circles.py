"""The circles detector on rendered triangles of discs, whose truth is exact."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace
from pydantic import ValidationError

from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import MeasurementStatus
from stadimeter.detectors.circles import CirclesDetector, CirclesOptions
from stadimeter.detectors.disc import DiscDetector, DiscOptions
from support.scenes import draw
from support.scenes.circles import circles_scene
from support.scenes.nuisances import noise, soft
from support.scenes.plane import DiscTarget, Pose
from support.scenes.render import render
from support.through_lens import ThroughLens

pytestmark = pytest.mark.vision

BENT = replace(draw.CAMERA, distortion=(-0.15, 0.03, 0.0, 0.0, 0.0))
TABLE = {"diameter": "5 cm", "spacing": "10 cm"}


def detector(camera=draw.CAMERA, **options):
    return ThroughLens(CirclesDetector("mark", CirclesOptions.model_validate({**TABLE, **options})), camera)


def frame_of(made):
    return Frame(made.image, 0.0, 0, subsampling=made.subsampling)


@pytest.mark.long
@pytest.mark.parametrize(("seed", "spacing_px", "tilt_deg"), [(1, 60, 0), (2, 100, 30), (3, 200, 50)])
def test_circles_are_measured_to_a_tenth_of_a_percent_and_within_their_interval(seed, spacing_px, tilt_deg):
    scene = circles_scene(seed, spacing_px, math.radians(tilt_deg))
    made = render(scene)
    measured = detector().measure(frame_of(made))
    assert measured.distance_m == pytest.approx(made.truth.distance_m, rel=0.001)
    assert abs(measured.distance_m - made.truth.distance_m) < 4 * measured.sigma_m
    sight = np.array(made.truth.position_m) / made.truth.distance_m
    tilt_rad = math.acos(abs(float(scene.target.pose.rotation()[:, 2] @ sight)))
    assert measured.tilt_rad == pytest.approx(tilt_rad, abs=math.radians(1))


@pytest.mark.long
def test_a_lens_that_bends_lines_changes_nothing():
    made = render(circles_scene(4, 150, math.radians(20), BENT))
    assert detector(BENT).measure(frame_of(made)).distance_m == pytest.approx(made.truth.distance_m, rel=0.001)


@pytest.mark.long
def test_circles_larger_than_stated_measure_the_same_where_one_disc_is_nearer_by_as_much():
    made = render(circles_scene(5, 150, 0.3))
    frame, true_m = frame_of(made), made.truth.distance_m
    assert detector(diameter="4.9 cm").measure(frame).distance_m == pytest.approx(true_m, rel=0.001)
    disc = DiscTarget(pose=Pose(position_m=(0.0, 0.0, 0.4)), diameter_m=0.05)
    alone = render(replace(made_scene(), target=disc))
    one = ThroughLens(DiscDetector("disc", DiscOptions.model_validate({"diameter": "4.9 cm"})), draw.CAMERA)
    measured = one.measure(frame_of(alone))
    assert measured.distance_m == pytest.approx(0.4 * 0.98, rel=0.003)


def made_scene():
    from support.scenes.backdrop import PlainBackdrop

    return replace(circles_scene(5, 150, 0.3), backdrop=PlainBackdrop(bgr=(70, 75, 80)))


@pytest.mark.long
def test_noise_is_in_the_standard_deviation_and_blur_does_not_shift_the_distance():
    scene = circles_scene(6, 100, 0.4)
    clean, noisy, blurred = (
        detector().measure(frame_of(render(each(scene)))) for each in (noise(2), noise(12), soft(2.0))
    )
    assert noisy.noise_m > 2 * clean.noise_m
    assert blurred.distance_m == pytest.approx(clean.distance_m, rel=0.001)


def test_of_two_mirrored_tilts_the_ellipses_tell_the_true_one():
    made = render(circles_scene(7, 100, math.radians(40)))
    assert detector().measure(frame_of(made)).ambiguity < 0.1


@pytest.mark.long
def test_circles_of_another_spacing_are_not_taken():
    made = render(circles_scene(8, 120, 0.2))
    measured = detector(spacing="14 cm").measure(frame_of(made))
    assert measured.status is MeasurementStatus.NOT_FOUND
    assert "as far apart as stated" in measured.reason


@pytest.mark.long
def test_clutter_alone_is_never_taken_for_them():
    for seed in range(20, 26):
        found = detector().detect(frame_of(render(draw.empty_scene(seed))))
        assert found.status is not DetectionStatus.FOUND, f"seed {seed}"


def test_discs_that_nearly_touch_are_refused_with_both_sizes():
    with pytest.raises(ValidationError, match=r"0\.09 m whose centres are 0\.1 m apart"):
        CirclesOptions.model_validate({**TABLE, "diameter": "9 cm"})


def test_an_outline_of_fewer_points_is_measured_by_the_side_of_the_triangle():
    made = render(circles_scene(9, 100, 0.0))
    finder = detector()
    found = finder.detect(frame_of(made))
    reading = finder.target_shape.locate(replace(found, outline_px=found.outline_px[:10]), draw.CAMERA)
    assert math.dist(reading.position_m, (0, 0, 0)) == pytest.approx(made.truth.distance_m, rel=0.1)
