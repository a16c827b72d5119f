"""A computer's own figures."""

import os
import platform

import cv2
import pytest
from boards_table import read_figures

from stadimeter.workbench.bench import exercises, lens_for, measure, room_frames, with_patch
from stadimeter.workbench.board_figures import this_computer, to_json


@pytest.fixture(scope="module")
def figures():
    return measure(0.5, sizes_px=((320, 240), (640, 480)))


@pytest.mark.long
def test_every_detector_of_ours_is_measured_at_every_size(figures):
    assert [(speed.width_px, speed.detector) for speed in figures.detectors] == [
        (width, name) for width in (320, 640) for name in exercises()
    ]


@pytest.mark.long
def test_every_detector_finds_what_it_is_measured_on(figures):
    assert {speed.detector: speed.found for speed in figures.detectors if speed.width_px == 640} == dict.fromkeys(
        exercises(), 1.0
    )


@pytest.mark.long
def test_speeds_are_positive_and_tracking_was_measured(figures):
    assert all(speed.search.median_ms > 0 for speed in figures.detectors)
    assert all(speed.track is not None and speed.track.median_ms > 0 for speed in figures.detectors if speed.found)


def test_the_latency_is_that_of_a_run(figures):
    latency = figures.latency
    assert latency.frames > 0
    assert 0 < latency.p50_ms <= latency.p95_ms <= latency.p99_ms


def test_a_run_of_the_program_acts_and_takes_the_memory_of_a_program_with_opencv(figures):
    assert figures.run.first_command_s > 0
    assert 40 < figures.run.peak_memory_mb < 4000


def test_what_was_measured_can_be_sent(figures, tmp_path):
    file = tmp_path / "board.json"
    file.write_text(to_json(figures))
    assert read_figures(file).computer == figures.computer


def test_what_was_measured_on_is_named():
    computer = this_computer()
    assert computer.board
    assert computer.cores == len(os.sched_getaffinity(0))
    assert computer.python == platform.python_version()
    assert computer.opencv == cv2.__version__


def test_the_pictures_differ_and_have_the_size_that_was_asked_for():
    frames = room_frames(lens_for(320, 240))
    assert {frame.image.shape for frame in frames} == {(240, 320, 3)}
    assert len({frame.image.tobytes() for frame in frames}) == len(frames)


def test_a_patch_changes_a_copy():
    frames = room_frames(lens_for(320, 240), count=2)
    before = [frame.image.copy() for frame in frames]
    changed = with_patch(frames, exercises()["sheet"][1].patch)
    assert all((frame.image == image).all() for frame, image in zip(frames, before, strict=True))
    assert all((new.image != image).any() for new, image in zip(changed, before, strict=True))
