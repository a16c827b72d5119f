"""Balls that move while they are exposed, in rendered pictures that are smeared accordingly."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame
from stadimeter.detectors.ball import BallDetector, BallOptions
from stadimeter.perception.perceiver import Perceiver
from stadimeter.simulation.silhouette import paint_ball

pytestmark = pytest.mark.vision

LENS = CameraModel(width_px=320, height_px=240, fx_px=600.0, fy_px=600.0, cx_px=159.5, cy_px=119.5)
RATE_HZ = 30.0
STEPS = 8


def frames(exposure_s: float, across_mps: float, *, depth_m: float = 2.0, count: int = 12) -> Iterator[Frame]:
    """Draw a ball that moves across the picture: the mean of what is seen during the exposure."""
    for number in range(count):
        light = np.zeros((240, 320, 3))
        for step in range(STEPS):
            at_s = (number - count / 2) / RATE_HZ + exposure_s * step / STEPS
            view = np.full(light.shape, (96, 88, 80), np.uint8)
            paint_ball(view, LENS, (across_mps * at_s, 0.0, depth_m), 0.1)
            light += view / STEPS
        noise = np.random.default_rng(number).normal(0, 2, light.shape)
        image = np.clip(light + noise, 0, 255).astype(np.uint8)
        yield Frame(image, number / RATE_HZ, number, exposure_s=exposure_s)


def advice(seen: Iterator[Frame]) -> tuple[str, ...]:
    options = BallOptions.model_validate({"diameter": "20 cm", "hsv": "29,86,6:64,255,255"})
    perceiver = Perceiver({"ball": BallDetector("ball", options)}, LENS)
    for frame in seen:
        (found,), _ = perceiver.look(frame)
        assert found.status == "found", found.reason
    return perceiver.motion_blur.advice()


@pytest.mark.long
def test_a_ball_that_is_smeared_is_told_with_the_exposure_that_would_do() -> None:
    (words,) = advice(frames(0.02, 0.8))
    assert words == (
        "ball: blurred by 4.9 px at 0.8 m/s, 8% of its size, with an exposure of 20 ms (in 100 % of the frames): its"
        ' distance is unsure then. Write exposure = "4.9 ms" in [camera], with more light'
    )
    assert advice(frames(0.0049, 0.8)) == ()


def test_a_ball_that_rests_is_not_blurred_however_long_it_is_exposed() -> None:
    assert advice(frames(0.1, 0.0)) == ()


def test_where_the_exposure_is_not_known_nothing_is_said() -> None:
    smeared = frames(0.02, 0.8)
    assert advice(Frame(frame.image, frame.captured_at_s, frame.sequence) for frame in smeared) == ()


def test_a_blur_in_few_frames_is_not_worth_a_word() -> None:
    resting, moving = list(frames(0.02, 0.0)), list(frames(0.02, 0.8, count=4))
    seen = [*moving, *resting * 8]
    later = (
        Frame(frame.image, number / RATE_HZ, number, exposure_s=frame.exposure_s) for number, frame in enumerate(seen)
    )
    assert advice(later) == ()


def test_sightings_far_apart_or_before_a_gap_tell_no_speed() -> None:
    seldom = (
        Frame(each.image, math.floor(each.sequence / 2) + each.captured_at_s, each.sequence, exposure_s=0.02)
        for each in list(frames(0.02, 0.8))[::2]
    )
    assert advice(seldom) == ()
