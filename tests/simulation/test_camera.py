from __future__ import annotations

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from stadimeter.config.plugins import CAMERAS
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame
from stadimeter.errors import CaptureTimeoutError
from stadimeter.simulation.camera import SimulatedCameraOptions
from stadimeter.simulation.silhouette import silhouette

SMALL = CameraModel.with_focal_length(150.0, 160, 120)


def balls_in(frame: Frame) -> int:
    hsv = cv2.cvtColor(frame.image, cv2.COLOR_BGR2HSV)
    return cv2.countNonZero(cv2.inRange(hsv, (29, 86, 6), (64, 255, 255)))


@pytest.fixture
def small(make_run):
    """Return a run through a small lens, which draws quickly."""
    return make_run(lens=SMALL)


def opened(run, **options):
    camera = run.build(CAMERAS, **options)
    camera.open()
    return camera


def test_reading_moves_the_clock_from_frame_to_frame(small) -> None:
    camera = opened(small, rate="20 Hz")
    frames = [camera.read() for _ in range(3)]
    assert [frame.captured_at_s for frame in frames] == pytest.approx([100.05, 100.1, 100.15])
    assert [frame.sequence for frame in frames] == [0, 1, 2]
    assert small.clock.now_s() == frames[-1].captured_at_s


def test_frame_times_do_not_drift(small) -> None:
    camera = opened(small, rate="30 Hz", render=False)
    for _ in range(30 * 60):
        frame = camera.read()
    assert frame.captured_at_s == pytest.approx(160.0, abs=1e-9)


def test_a_picture_shows_the_ball_where_it_truly_is_at_its_time(make_run) -> None:
    run = make_run(path=[{"at": "0 s", "x": "1.5 m", "y": "-1 m"}, {"at": "4 s", "x": "2 m", "y": "1 m"}], loop=False)
    run.world.robot.drive_wheels(0.02, 0.05)
    camera = opened(run, rate="2 Hz")
    for _ in range(6):
        frame = camera.read()
        hsv = cv2.cvtColor(frame.image, cv2.COLOR_BGR2HSV)
        moments = cv2.moments(cv2.inRange(hsv, (29, 86, 6), (64, 255, 255)), binaryImage=True)
        seen = silhouette(run.lens, run.world.target_in_camera(frame.captured_at_s), 0.1)
        left, top, right, bottom = seen.extent_px
        if left > 0 and right < 639:
            centre_px = (moments["m10"] / moments["m00"], moments["m01"] / moments["m00"])
            assert centre_px == pytest.approx(seen.centre_px, abs=0.4)
            assert moments["m00"] == pytest.approx(np.pi / 4 * (right - left) * (bottom - top), rel=0.05)
    assert left > 0, "the last frame at least must show the whole ball"


def test_two_runs_with_one_seed_see_the_same_and_another_seed_something_else(make_run) -> None:
    runs = [make_run(lens=SMALL, seed=seed) for seed in (5, 5, 6)]
    pictures = []
    for run in runs:
        run.world.robot.drive_wheels(0.1, 0.2)
        camera = opened(run)
        pictures.append([camera.read().image for _ in range(4)])
    assert np.array_equal(pictures[0], pictures[1])
    assert not np.array_equal(pictures[0], pictures[2])


def test_without_rendering_frames_are_black_and_share_one_picture_that_cannot_be_written(small) -> None:
    camera = opened(small, render=False)
    first, second = camera.read(), camera.read()
    assert first.image is second.image
    assert first.image.shape == (120, 160, 3)
    assert not first.image.any()
    with pytest.raises(ValueError, match="read-only"):
        first.image[0, 0] = 1


def test_a_frozen_camera_delivers_the_same_old_frame_while_time_passes(small) -> None:
    camera = opened(small, rate="10 Hz")
    last = camera.read()
    small.world.faults.camera_frozen = True
    for _ in range(5):
        assert camera.read() is last
    assert small.clock.now_s() == pytest.approx(last.captured_at_s + 0.5)
    small.world.faults.camera_frozen = False
    next_frame = camera.read()
    assert next_frame.captured_at_s == pytest.approx(last.captured_at_s + 0.6)
    assert next_frame.sequence == last.sequence + 6


def test_a_blocked_camera_lets_time_pass_and_says_so(small) -> None:
    camera = opened(small, rate="10 Hz")
    small.world.faults.camera_blocked = True
    with pytest.raises(CaptureTimeoutError, match="blocked"):
        camera.read()
    assert small.clock.now_s() == pytest.approx(100.1)
    small.world.faults.camera_blocked = False
    assert camera.read().captured_at_s >= 100.1


def test_frames_that_nobody_read_in_time_are_passed_over(small) -> None:
    camera = opened(small, rate="10 Hz")
    camera.read()
    small.clock.advance_s(1.04)
    late = camera.read()
    assert late.captured_at_s == pytest.approx(101.2)
    assert late.sequence == 11
    assert small.clock.now_s() == pytest.approx(101.2)


def test_a_scheduled_fault_is_seen_by_the_camera(make_run) -> None:
    run = make_run(lens=SMALL, faults=[{"at": "1 s", "for": "1 s", "kind": "hide-target"}])
    camera = opened(run, rate="4 Hz")
    seen = [balls_in(camera.read()) > 0 for _ in range(12)]
    assert seen == [True] * 3 + [False] * 4 + [True] * 5


@pytest.mark.parametrize("options", [{"rate": "0 Hz"}, {"rate": "30"}, {"noise": -1}, {"noise": "nan"}, {"fps": 30}])
def test_a_wrong_option_is_refused(options) -> None:
    with pytest.raises(ValidationError):
        SimulatedCameraOptions.model_validate(options)
