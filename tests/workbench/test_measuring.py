"""Measuring picture files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.app.detectors import NamedDetector, build_detectors
from stadimeter.config.loader import DriverChoice
from stadimeter.config.plugins import DETECTORS, load_driver
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import MeasurementStatus
from stadimeter.workbench.measuring import Measuring, measure_picture
from support.crossing_balls import BLANK, PretendBalls

CAMERA = CameraModel.with_focal_length(600.0, 640, 480)


@pytest.fixture
def targets() -> tuple[NamedDetector, ...]:
    model = load_driver(DETECTORS, "ball")
    options = model.model_validate({"diameter": "10 cm", "hsv": "170,100,60:10,255,255"})
    choices = [DriverChoice(name=name, driver="ball", options=options) for name in ("left", "right")]
    return build_detectors(choices, CAMERA)


@pytest.fixture
def ball_picture(tmp_path: Path) -> Path:
    image = np.full((480, 640, 3), (120, 110, 100), np.uint8)
    cv2.circle(image, (320, 240), 30, (40, 30, 200), -1, cv2.LINE_AA)
    cv2.imwrite(str(tmp_path / "ball.png"), image)
    return tmp_path / "ball.png"


def test_each_target_has_a_result_for_each_picture(ball_picture: Path, targets) -> None:
    result = measure_picture(ball_picture, targets, CAMERA)
    assert [each.measurement.target for each in result.targets] == ["left", "right"]
    assert result.file == str(ball_picture)
    assert result.frame is not None
    for each in result.targets:
        assert each.measurement.status is MeasurementStatus.MEASURED
        assert each.measurement.distance_m == pytest.approx(0.1 * 600 / 60, rel=0.03)
        assert each.detection is not None


def test_a_record_has_exactly_the_keys_that_programs_read(ball_picture: Path, targets) -> None:
    record = measure_picture(ball_picture, targets, CAMERA).targets[0].record()
    assert list(record) == [
        "file",
        "target",
        "status",
        "perhaps",
        "distance_m",
        "depth_m",
        "sigma_m",
        "bearing_rad",
        "elevation_rad",
        "tilt_rad",
        "ambiguity",
        "reason",
        "x_m",
        "y_m",
        "z_m",
        "bearing_sigma_rad",
        "elevation_sigma_rad",
        "outline_px",
        "id",
        "frame",
        "time_s",
    ]
    assert record["status"] == "measured"
    assert record["reason"] == ""


def test_a_picture_of_another_size_is_measured_through_the_scaled_camera(ball_picture: Path, targets) -> None:
    large = ball_picture.with_name("large.png")
    cv2.imwrite(str(large), cv2.resize(cv2.imread(str(ball_picture)), (1280, 960), interpolation=cv2.INTER_CUBIC))
    small_m = measure_picture(ball_picture, targets, CAMERA).targets[0].measurement.distance_m
    assert measure_picture(large, targets, CAMERA).targets[0].measurement.distance_m == pytest.approx(small_m, rel=0.01)


def test_a_picture_of_another_aspect_is_an_error_with_a_reason(ball_picture: Path, targets) -> None:
    cut = ball_picture.with_name("cut.png")
    cv2.imwrite(str(cut), cv2.imread(str(ball_picture))[:360])
    for each in measure_picture(cut, targets, CAMERA).targets:
        assert each.measurement.status is MeasurementStatus.ERROR
        assert "another aspect" in each.measurement.reason
        assert each.measurement.distance_m is None


class Steady(PretendBalls):
    """Finds every ball in every frame."""

    def _is_found(self, seen: object) -> bool:
        return True


class Film:
    """A source of blank frames, thirty a second."""

    def frames(self, note: object) -> Iterator[Frame]:
        for number in range(60):
            yield Frame(BLANK, number / 30, number)


def test_several_of_one_kind_keep_their_names_through_a_video() -> None:
    """The left one goes away and the right one comes nearer, which makes it the largest."""
    far_m = np.linspace(1.0, 1.6, 60)
    left, right = (
        np.stack([0 * far_m + x_m, 0 * far_m, z_m], axis=1) for x_m, z_m in ((-0.2, far_m), (0.2, far_m[::-1]))
    )
    balls = Steady(np.stack([left, right], axis=1), seed=1)
    target = NamedDetector(name="balls", detector=balls, members=("balls-1", "balls-2"))
    named = [
        {each.measurement.target: (each.measurement.position_m or (0.0,))[0] > 0 for each in result.targets}
        for result in Measuring([target], CAMERA).measure_all(Film(), "film.mp4", print)
    ]
    assert len(named) == 60
    assert all(each == named[0] for each in named)
    assert set(named[0]) == {"balls-1", "balls-2"}
