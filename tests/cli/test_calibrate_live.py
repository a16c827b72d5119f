"""`calibrate distance --live`, with pictures for a camera: each distance takes the next nine of them."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.config.camera_file import load_camera_model
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from stadimeter.workbench.calibration.live_distance import FRAMES
from support.command_line import Typed, typed
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.render import render
from support.scenes.scene import Scene
from support.v4l2_double import V4l2Double

pytestmark = pytest.mark.vision

BALL = ("--ball", "20cm", "--hsv", "20,60,40:50,255,255")
NOTHING = np.full((480, 640, 3), 90, np.uint8)


@cache
def _ball_at(near_side_m: float, focal_px: float = 600.0) -> Image:
    lens = CameraModel.with_focal_length(focal_px, 640, 480)
    ball = BallTarget(position_m=(0.0, 0.0, near_side_m + 0.1), diameter_m=0.2)
    return render(Scene(camera=lens, target=ball, seed=1, backdrop=PlainBackdrop())).image


def _run(folder: Path, images: list[Image], answers: str, *options: str) -> Typed:
    for number, image in enumerate(images):
        for frame in range(FRAMES):
            cv2.imwrite(str(folder / f"{number}-{frame}.png"), image)
    config = folder / "room.toml"
    config.write_text(f'[camera]\ndriver = "images"\npaths = ["{folder}/*.png"]\nrate = "10 Hz"\n')
    output = folder / "camera.toml"
    return typed("calibrate", "distance", "--live", config, *BALL, "-o", output, *options, answers=answers)


@pytest.mark.long
def test_two_distances_asked_for_and_proved_give_a_camera_file(tmp_path: Path) -> None:
    result = _run(tmp_path, [_ball_at(1.0), _ball_at(3.0)], "\n\n")
    assert result.returncode == 0, result
    lines = result.stdout.splitlines()
    assert lines[0].startswith("Measure with a tape, from the lens to the nearest point of the ball.")
    assert [line for line in lines if line.endswith((" 1 m.", " 3 m."))] == ["Put it at 1 m.", "Now put it at 3 m."]
    assert re.search(r"at 3 m: \d+\.\d px, spread 0\.00%, found in 9 of 9 frames\n", result.stdout)
    assert re.search(r"    from what came before: \d+\.\d cm \([+-]0\.\d%\)\n", result.stdout)
    assert lines[-1] == f"wrote {tmp_path / 'camera.toml'}"
    model = load_camera_model(tmp_path / "camera.toml")
    assert model.fx_px == pytest.approx(600, rel=0.01)
    assert "at 3 m" in model.provenance.notes[1]


def test_settings_that_the_camera_did_not_take_are_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    device = V4l2Double.plugged_in(tmp_path / "video0", _ball_at(1.0), monkeypatch)
    device.kept[cv2.CAP_PROP_AUTOFOCUS] = 1.0
    config = tmp_path / "room.toml"
    config.write_text(f'[camera]\ndriver = "opencv"\ndevice = "{device.node}"\n')
    output = str(tmp_path / "camera.toml")
    result = typed("calibrate", "distance", "--live", config, *BALL, "-o", output)
    assert "note: asked for a fixed focus, the camera keeps refocusing: distances will drift\n" in result.stderr
    assert not device.isOpened(), "the camera is left closed"


@pytest.mark.long
def test_the_distance_that_it_really_has_can_be_typed_and_a_wrong_unit_is_asked_again(tmp_path: Path) -> None:
    result = _run(tmp_path, [_ball_at(1.0), _ball_at(2.5)], "\n3 apples\n2.5m\n", "--at", "1m", "--at", "2m")
    assert result.returncode == 0, result
    assert "error: the distance: '3 apples'" in result.stderr
    assert result.stdout.count("Now put it at 2m.") == 2
    assert "at 2.5m" in load_camera_model(tmp_path / "camera.toml").provenance.notes[1]


def test_distances_that_contradict_each_other_leave_no_file(tmp_path: Path) -> None:
    result = _run(tmp_path, [_ball_at(1.0), _ball_at(3.0, 660.0)], "\n\n")
    assert result.returncode == 2
    assert "at 1 m and at 3 m contradict each other" in result.stderr
    assert result.stderr.endswith("error: nothing was written\n")
    assert not (tmp_path / "camera.toml").exists()


@pytest.mark.long
def test_a_target_that_is_not_seen_is_asked_for_again(tmp_path: Path) -> None:
    result = _run(tmp_path, [NOTHING, _ball_at(1.0), _ball_at(3.0)], "\n\n\n")
    assert result.returncode == 0, result
    assert "at 1 m the target was found in 0 of 9 frames: no pixel" in result.stderr
    assert result.stdout.count("Put it at 1 m.") == 2


def test_without_an_answer_nothing_is_written(tmp_path: Path) -> None:
    result = _run(tmp_path, [_ball_at(1.0), _ball_at(3.0)], "\n")
    assert result.returncode == 1
    assert "there is no answer, so nothing was written" in result.stderr
    assert not (tmp_path / "camera.toml").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--live", "opencv,device=0", "--at", "1m"), "give two, such as --at 1m --at 3m"),
        (("--live", "opencv,device=947"), "there is no camera /dev/video947"),
        (("--live", "opencv,device=0", "-o", "nowhere/camera.toml"), "-o: there is no folder nowhere"),
        (("near.png@1m", "--live", "opencv,device=0"), "one of the two"),
    ],
)
def test_what_cannot_work_is_one_line(tmp_path: Path, arguments: tuple[str, ...], words: str) -> None:
    output = str(tmp_path / "camera.toml")
    result = typed("calibrate", "distance", "-o", output, *arguments, *BALL)
    assert result.returncode == 2
    (error,) = [line for line in result.stderr.splitlines() if line.startswith("error")]
    assert words in error
