from __future__ import annotations

import math

import numpy as np
import pytest

from stadimeter.config.plugins import CAMERAS, DETECTORS
from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.errors import CalibrationError, ConfigError
from stadimeter.ranging.ball import BallShape

BLANK = np.zeros((480, 640, 3), np.uint8)


def ball_at(x: str, y: str, **more):
    return {"path": [{"at": "0 s", "x": x, "y": y}], "camera_height": "25 cm", "ball_height": "25 cm", **more}


def detect(run, sequence: int = 0, **options):
    detector = run.build(DETECTORS, "ideal", name="ball", **options)
    return detector.detect(Frame(BLANK, run.clock.now_s(), sequence))


def test_without_noise_the_ball_is_where_the_truth_says(make_run) -> None:
    found = detect(make_run(**ball_at("2 m", "-0.4 m")), noise_px=0)
    assert found.status is DetectionStatus.FOUND
    assert found.target == "ball"
    assert found.reason == ""
    assert found.width_px == found.height_px == pytest.approx(2 * 600 * 0.1 / math.sqrt(2**2 - 0.1**2))
    assert found.centre_px[0] == pytest.approx(319.5 + 600 * 0.4 * 2 / (2**2 - 0.1**2))
    assert found.centre_px[1] == pytest.approx(239.5)
    assert found.size_sigma_px == 0


def test_the_outline_is_the_balls_limb(make_run) -> None:
    run = make_run(**ball_at("2 m", "-0.4 m"))
    found = detect(run, noise_px=0)
    assert len(found.outline_px) >= 8
    for x_px, y_px in found.outline_px:
        ray = np.array((*run.lens.direction(x_px, y_px), 1.0))
        assert np.linalg.norm(np.cross(ray / np.linalg.norm(ray), (0.4, 0.0, 2.0))) == pytest.approx(0.1)


def test_the_noise_is_as_large_as_asked_and_told(make_run) -> None:
    run = make_run(**ball_at("2 m", "-0.4 m"))
    exact = detect(run, noise_px=0)
    detector = run.build(DETECTORS, "ideal", noise_px=0.5)
    found = [detector.detect(Frame(BLANK, 100.0, sequence)) for sequence in range(4000)]
    errors = np.array([(one.width_px - exact.width_px, *np.subtract(one.centre_px, exact.centre_px)) for one in found])
    assert errors.std(axis=0) == pytest.approx([0.5] * 3, rel=0.05)
    assert np.abs(errors.mean(axis=0)).max() < 0.04
    assert np.abs(np.corrcoef(errors.T) - np.eye(3)).max() < 0.06
    assert {one.size_sigma_px for one in found} == {0.5}


def test_a_frame_always_gives_the_same_answer(make_run) -> None:
    run = make_run()
    run.world.robot.drive_wheels(0.1, 0.12)
    detector = run.build(DETECTORS, "ideal")
    camera = run.build(CAMERAS, render=False)
    camera.open()
    frames = [camera.read() for _ in range(20)]
    at_once = [detector.detect(frame).width_px for frame in frames]
    run.world.robot.drive_wheels(0.0, 0.0)
    run.clock.advance_s(3.0)
    assert [detector.detect(frame).width_px for frame in reversed(frames)] == at_once[::-1]


def test_two_runs_with_one_seed_detect_the_same_and_another_seed_something_else(make_run) -> None:
    sizes = [[detect(make_run(seed=seed), sequence).width_px for sequence in range(5)] for seed in (5, 5, 6)]
    assert sizes[0] == sizes[1]
    assert sizes[0] != sizes[2]


def test_a_hidden_ball_is_not_found(run) -> None:
    run.world.faults.target_hidden = True
    hidden = detect(run)
    assert (hidden.status, hidden.reason) == (DetectionStatus.NOT_FOUND, "the ball is hidden")


@pytest.mark.parametrize(
    ("x", "y"), [("-2 m", "0 m"), ("2 m", "3 m"), ("2 m", "-3 m"), ("0 m", "2 m"), ("-5 cm", "0 m")]
)
def test_a_ball_out_of_view_is_not_found(make_run, x: str, y: str) -> None:
    gone = detect(make_run(**ball_at(x, y)))
    assert (gone.status, gone.reason) == (DetectionStatus.NOT_FOUND, "the ball is out of view")


@pytest.mark.parametrize(
    ("x", "y", "border"),
    [
        ("2 m", "1.05 m", "left"),
        ("2 m", "-1.05 m", "right"),
        ("2 m", "1.12 m", "left"),
        ("15 cm", "0 m", "left and top and right and bottom"),
        ("9 cm", "-12 cm", "whole"),
    ],
)
def test_a_ball_cut_off_by_the_border_is_truncated_and_has_no_size(make_run, x: str, y: str, border: str) -> None:
    cut = detect(make_run(**ball_at(x, y)))
    assert cut.status is DetectionStatus.TRUNCATED
    assert cut.reason == f"cut off by the {border} border of the picture"
    assert cut.width_px == 0.0
    assert not len(cut.outline_px)


def test_a_ball_too_far_to_see_is_not_found_and_the_reason_has_the_figures(make_run) -> None:
    far = detect(make_run(**ball_at("60 m", "0 m")), noise_px=0)
    assert (far.status, far.reason) == (DetectionStatus.NOT_FOUND, "a ball of 2.0 px, limit 3.0 px")


def test_a_frame_of_another_resolution_is_looked_at_through_the_same_lens(make_run) -> None:
    run = make_run(**ball_at("2 m", "0 m"))
    detector = run.build(DETECTORS, "ideal", noise_px=0)
    half = detector.detect(Frame(BLANK[:240, :320], 100.0, 0))
    assert half.width_px == pytest.approx(detector.detect(Frame(BLANK, 100.0, 0)).width_px / 2)
    with pytest.raises(CalibrationError):
        detector.detect(Frame(BLANK[:, :320], 100.0, 0))


def test_the_size_is_the_worlds_unless_the_same_is_stated(make_run) -> None:
    run = make_run(ball_diameter="20 cm")
    assert run.build(DETECTORS, "ideal").target_shape == BallShape(diameter_m=0.2)
    assert run.build(DETECTORS, "ideal", diameter="200 mm").target_shape == BallShape(diameter_m=0.2)
    with pytest.raises(ConfigError, match=r"diameter is 0\.067 m, but the ball in \[world\] has 0\.2 m"):
        run.build(DETECTORS, "ideal", diameter="6.7 cm")


@pytest.mark.long
def test_the_real_ball_detector_sees_in_the_drawn_picture_what_the_ideal_one_says(run) -> None:
    camera = run.build(CAMERAS, rate="2 Hz")
    ideal = run.build(DETECTORS, "ideal", noise_px=0)
    real = run.build(DETECTORS, "ball", diameter="20 cm", hsv="29,86,6:64,255,255")
    camera.open()
    for _ in range(36):
        frame = camera.read()
        said, seen = ideal.detect(frame), real.detect(frame)
        assert seen.status is said.status is DetectionStatus.FOUND
        assert seen.width_px == pytest.approx(said.width_px, abs=1.0)
        assert seen.centre_px == pytest.approx(said.centre_px, abs=0.5)
