"""Calibrating before a camera, with rendered targets at exactly known distances on a double of a device."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from stadimeter.config.plugins import CAMERAS, DETECTORS, DriverChoice, load_driver
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from stadimeter.errors import CalibrationError
from stadimeter.ranging.calibration import Calibration
from stadimeter.workbench.calibration.live_distance import Take, fit_distances, take_at
from stadimeter.workbench.frame_source import Source, open_camera
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.render import render
from support.scenes.scene import Scene
from support.v4l2_double import V4l2Double

pytestmark = pytest.mark.vision


BALL_M = 0.2


@cache
def ball_at(near_side_m: float, focal_px: float = 600.0) -> Image:
    """Return a picture of a ball whose nearest point is that far from the lens."""
    lens = CameraModel.with_focal_length(focal_px, 640, 480)
    ball = BallTarget(position_m=(0.0, 0.0, near_side_m + BALL_M / 2), diameter_m=BALL_M)
    return render(Scene(camera=lens, target=ball, seed=1, backdrop=PlainBackdrop())).image


def _target(driver: str, **table: object) -> DriverChoice:
    model = load_driver(DETECTORS, driver)
    return DriverChoice(name=driver, driver=driver, options=model.model_validate(table))


BALL = _target("ball", diameter="20 cm", hsv="20,60,40:50,255,255")


@pytest.fixture
def device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> V4l2Double:
    return V4l2Double.plugged_in(tmp_path / "video0", ball_at(1.0), monkeypatch)


@contextmanager
def _camera(device: V4l2Double) -> Iterator[Source]:
    model = load_driver(CAMERAS, "opencv")
    table = {"device": str(device.node)}
    with open_camera(DriverChoice(name="camera", driver="opencv", options=model.model_validate(table))) as source:
        yield source


def _takes(device: V4l2Double, *shown: tuple[float, Image]) -> list[Take]:
    """Take each picture as one at a distance."""
    taken = []
    with _camera(device) as source:
        for distance_m, image in shown:
            device.show(image)
            taken.append(take_at(source, BALL, distance_m))
    return taken


def _fit(takes: Sequence[Take]) -> Calibration:
    frames = {each.known.picture: each.frame for each in takes}
    known = [each.known for each in takes]
    made = fit_distances(known, frames.__getitem__, [BALL], distance_relative_sigma=0.01)
    assert made.calibration is not None
    return made.calibration


def test_a_ball_is_measured_to_its_near_side_and_gives_the_focal_length(device: V4l2Double) -> None:
    takes = _takes(device, (1.0, ball_at(1.0)), (3.0, ball_at(3.0)))
    made = _fit(takes)
    assert made.camera_model.fx_px == pytest.approx(600.0, rel=0.01)
    found = re.fullmatch(r"found in 9 of 9 frames, (\d+) px, spread 0\.\d%", takes[0].words)
    assert found is not None
    assert float(found[1]) == pytest.approx(600 * BALL_M / 1.1, rel=0.02)
    assert [each.picture for each in made.pictures] == ["at 1 m", "at 3 m"]
    assert not device.isOpened(), "the camera is left closed"


def test_a_focus_that_moved_is_a_contradiction_and_gives_no_camera_model(device: V4l2Double) -> None:
    takes = _takes(device, (1.0, ball_at(1.0)), (3.0, ball_at(3.0, focal_px=660.0)))
    with pytest.raises(CalibrationError) as raised:
        _fit(takes)
    words = str(raised.value)
    assert re.match(r"at 1 m and at 3 m contradict each other: their focal lengths are (9|10)\.\d% apart", words)
    assert "the focus moved (switch autofocus off)" in words


def test_distances_from_another_point_contradict_each_other_and_the_offset_is_said(device: V4l2Double) -> None:
    takes = _takes(device, (0.6, ball_at(0.7)), (2.0, ball_at(2.1)))
    with pytest.raises(CalibrationError, match=r"if both distances were (9|10|11)\.\d cm longer"):
        _fit(takes)


def test_a_target_that_is_not_there_is_said(device: V4l2Double) -> None:
    with pytest.raises(CalibrationError, match="at 3 m the target was found in 0 of 9 frames: the picture is grey"):
        _takes(device, (3.0, np.full((480, 640, 3), 90, np.uint8)))
