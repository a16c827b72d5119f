"""One lens for detector and ranging, when the whole frame is searched, and balls that are smeared."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Prediction
from stadimeter.core.frame import SUBSAMPLINGS, Frame, Optics
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.tracking.life_cycle import new_track, step
from stadimeter.core.tracking.motion import Tracking
from stadimeter.detectors.ball import BallDetector, BallOptions
from stadimeter.detectors.protocol import Detector
from stadimeter.errors import CalibrationError
from stadimeter.perception.perceiver import Perceiver
from stadimeter.perception.prediction import SEARCH_EVERY_S, Expectations
from stadimeter.ranging.ball import BallShape
from stadimeter.simulation.camera import paint_ball
from support.scenes.draw import CAMERA, TENNIS_M, ball_scene
from support.scenes.nuisances import BALL_NUISANCES
from support.scenes.on_floor import ball_on_floor
from support.scenes.render import render

pytestmark = pytest.mark.vision


# One lens for detector and ranging and when the whole frame is searched.

# One lens for detector and ranging, at whatever resolution the frames have.

SMALL = CAMERA
CALIBRATED = SMALL.scaled_to(1280, 960)
BLANK = np.zeros((480, 640, 3), np.uint8)


class Watched:
    """A detector that notes the lenses it is given."""

    def __init__(self, detector: Detector) -> None:
        self._detector = detector
        self.target_shape = detector.target_shape
        self.lenses: list[CameraModel | None] = []

    def detect(
        self, frame: Frame, prediction: Prediction | None = None, *, lens: CameraModel | None = None
    ) -> Detection:
        self.lenses.append(lens)
        return self._detector.detect(frame, prediction, lens=lens)


def ball() -> BallDetector:
    return BallDetector("ball", BallOptions.model_validate({"diameter": f"{TENNIS_M} m", "hsv": "29,86,6:64,255,255"}))


def partly_hidden(seed: int) -> Frame:
    """Draw a ball of which 40 % are hidden: some of what looks like its edge is that of the thing before it."""
    return Frame(render(BALL_NUISANCES["hidden 40 %"](ball_scene(seed))).image, 0.0, 0)


@pytest.mark.long
def test_a_ball_is_as_far_away_whatever_resolution_the_camera_was_calibrated_at() -> None:
    for seed in (3, 5, 8):
        frame = partly_hidden(seed)
        (at_calibrated,), (at_double,) = (
            Perceiver({"ball": ball()}, model).look(frame)[1] for model in (SMALL, CALIBRATED)
        )
        assert at_calibrated.distance_m is not None, at_calibrated.reason
        assert at_double == at_calibrated


def test_the_lens_is_scaled_once_for_all_frames_of_one_resolution() -> None:
    first, second = Watched(ball()), Watched(ball())
    perceiver = Perceiver({"first": first, "second": second}, CALIBRATED)
    for sequence in range(3):
        perceiver.look(Frame(BLANK, sequence / 30, sequence))
    lenses = first.lenses + second.lenses
    assert all(lens is lenses[0] for lens in lenses)
    assert lenses[0] == replace(SMALL, subsampling="4:4:4")


def test_a_frame_of_another_aspect_is_refused() -> None:
    with pytest.raises(CalibrationError, match="another aspect"):
        Perceiver({"ball": ball()}, SMALL).look(Frame(np.zeros((360, 640, 3), np.uint8), 0.0, 0))


def test_the_lens_says_how_coarsely_the_frame_stores_colour_unless_the_camera_file_does() -> None:
    image = np.zeros((480, 640, 3), np.uint8)
    given: list[tuple[int, int]] = []
    for model in (SMALL, replace(SMALL, subsampling="4:2:2")):
        detector = Watched(ball())
        perceiver = Perceiver({"ball": detector}, model)
        for number, subsampling in enumerate(SUBSAMPLINGS):
            perceiver.look(Frame(image, number / 30, number, subsampling=subsampling))
        given += [lens.chroma_pitch_px for lens in detector.lenses if lens]
    assert given == [(1, 1), (2, 1), (2, 2), (2, 1), (2, 1), (2, 1)]


OPTICS = Optics(sensor="imx708", sensor_size_px=(2304, 1296), crop_px=(0, 0, 4608, 2592), lens_position_dpt=1.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"sensor": "imx219"}, "the camera file is for the sensor imx708, and this is imx219"),
        ({"upside_down": True}, r"set upside_down = false in \[camera\]"),
        (
            {"crop_px": (0, 0, 2304, 1296)},
            r"set crop_px = \[0, 0, 4608, 2592\], sensor_width_px = 2304 and sensor_height_px = 1296 in \[camera\]",
        ),
        ({"lens_position_dpt": 2.0}, "lens at 1 dioptres, now it is at 2; set lens_position_dpt = 1 in"),
    ],
)
def test_a_camera_that_was_set_otherwise_than_when_it_was_calibrated_is_refused(
    change: dict[str, object], words: str
) -> None:
    perceiver = Perceiver({"ball": ball()}, replace(SMALL, optics=OPTICS))
    assert perceiver.lens_of(Frame(BLANK, 0.0, 0, optics=OPTICS))
    with pytest.raises(CalibrationError, match=words):
        perceiver.look(Frame(BLANK, 0.0, 1, optics=replace(OPTICS, **change)))


@pytest.mark.parametrize(
    ("calibrated", "now"),
    [
        (None, OPTICS),
        (OPTICS, None),
        (OPTICS, replace(OPTICS, crop_px=(4, 2, 4600, 2588), sensor_size_px=(4608, 2592), lens_position_dpt=1.02)),
        (OPTICS, replace(OPTICS, lens_position_dpt=None)),
    ],
)
def test_what_is_not_known_or_only_rounded_otherwise_is_no_difference(
    calibrated: Optics | None, now: Optics | None
) -> None:
    perceiver = Perceiver({"ball": ball()}, replace(SMALL, optics=calibrated))
    assert perceiver.lens_of(Frame(BLANK, 0.0, 0, optics=now)).optics == calibrated


def test_a_target_on_the_floor_is_measured_by_it_too_and_a_track_says_where_it_contradicts_the_size() -> None:
    drawn = ball_on_floor(5, 1.0)
    frame = Frame(render(drawn.scene).image, 0.0, 0)
    detectors = {
        name: BallDetector(name, BallOptions.model_validate({"diameter": size, "hsv": drawn.hsv}))
        for name, size in (("right", "12 cm"), ("wrong", "6 cm"))
    }
    footings = dict.fromkeys(detectors, drawn.footing)
    right, wrong = Perceiver(detectors, drawn.camera, footings).look(frame)[1]
    by_size, _ = Perceiver(detectors, drawn.camera).look(frame)[1]
    assert right.sigma_m is not None
    assert by_size.sigma_m is not None
    assert right.sigma_m < by_size.sigma_m
    state = new_track("wrong")
    for number in range(4):
        seen = replace(wrong, target="wrong", captured_at_s=number / 30)
        state = step(state, seen, number / 30, Tracking())
    assert "σ apart: it is not on the floor" in state.track.reason


# When the whole frame is searched.

LENS = CameraModel.with_focal_length(600.0, 640, 480)
BALL = BallShape(diameter_m=0.065)


def seen(at_s: float, target: str = "ball", status: TrackStatus = TrackStatus.TRACKING) -> Track:
    return Track(
        target=target,
        status=status,
        distance_m=2.0,
        sigma_m=0.01,
        bearing_rad=0.0,
        elevation_rad=0.0,
        as_of_s=at_s,
        measured_at_s=at_s,
    )


def test_a_tracked_target_is_looked_for_in_the_whole_frame_once_a_second_only() -> None:
    expectations = Expectations()
    times_s = [number / 30 for number in range(300)]
    searched_s = [at_s for at_s in times_s if expectations.of(seen(at_s - 1 / 30), BALL, LENS, at_s) is None]
    assert len(searched_s) == 10
    assert min(after - before for before, after in itertools.pairwise(searched_s)) >= SEARCH_EVERY_S


def test_a_target_that_is_searched_for_anyway_is_not_searched_for_again_soon() -> None:
    expectations = Expectations()
    assert expectations.of(seen(0.0), BALL, LENS, 0.0) is None
    assert expectations.of(seen(0.9, status=TrackStatus.LOST), BALL, LENS, 0.9) is None
    assert expectations.of(seen(1.4), BALL, LENS, 1.5) is not None


@pytest.mark.parametrize("back_s", [0.1, 100.0])
def test_a_recording_that_starts_over_is_searched_whole(back_s: float) -> None:
    expectations = Expectations()
    expectations.of(seen(200.0), BALL, LENS, 200.0)
    assert expectations.of(seen(200.0 - back_s), BALL, LENS, 200.0 - back_s) is None


# Balls that move while they are exposed, in rendered pictures that are smeared accordingly.

BLUR_LENS = CameraModel(width_px=320, height_px=240, fx_px=600.0, fy_px=600.0, cx_px=159.5, cy_px=119.5)
RATE_HZ = 30.0
STEPS = 8


def frames(exposure_s: float, across_mps: float, *, depth_m: float = 2.0, count: int = 12) -> Iterator[Frame]:
    """Draw a ball that moves across the picture: the mean of what is seen during the exposure."""
    for number in range(count):
        light = np.zeros((240, 320, 3))
        for part in range(STEPS):
            at_s = (number - count / 2) / RATE_HZ + exposure_s * part / STEPS
            view = np.full(light.shape, (96, 88, 80), np.uint8)
            paint_ball(view, BLUR_LENS, (across_mps * at_s, 0.0, depth_m), 0.1)
            light += view / STEPS
        noise = np.random.default_rng(number).normal(0, 2, light.shape)
        image = np.clip(light + noise, 0, 255).astype(np.uint8)
        yield Frame(image, number / RATE_HZ, number, exposure_s=exposure_s)


def advice(seen: Iterator[Frame]) -> tuple[str, ...]:
    options = BallOptions.model_validate({"diameter": "20 cm", "hsv": "29,86,6:64,255,255"})
    perceiver = Perceiver({"ball": BallDetector("ball", options)}, BLUR_LENS)
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


def test_sightings_far_apart_or_before_a_gap_tell_no_speed() -> None:
    seldom = (
        Frame(each.image, math.floor(each.sequence / 2) + each.captured_at_s, each.sequence, exposure_s=0.02)
        for each in list(frames(0.02, 0.8))[::2]
    )
    assert advice(seldom) == ()
