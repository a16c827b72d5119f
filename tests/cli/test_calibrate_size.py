"""The command ``calibrate size``: a thing of unknown size, from pictures after steps of the camera."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.config.camera_file import save_camera_model
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from support.command_line import Typed, typed
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.plane import DiscTarget, Pose, SheetTarget, TagTarget
from support.scenes.render import render
from support.scenes.scene import Scene

pytestmark = pytest.mark.vision

LENS = CameraModel.with_focal_length(600.0, 640, 480)
BALL = ("--ball", "unknown", "--hsv", "20,60,40:50,255,255")
DIAMETER_M = 0.183
NOTHING = np.full((480, 640, 3), 90, np.uint8)
NAMES = ("a.png", "b.png", "c.png", "d.png")


def _target(kind: str, position_m: tuple[float, float, float]):
    pose = Pose(position_m=position_m, tilt_rad=0.2, tilt_towards_rad=0.5)
    match kind:
        case "ball":
            return BallTarget(position_m=position_m, diameter_m=DIAMETER_M)
        case "disc":
            return DiscTarget(pose=pose, diameter_m=DIAMETER_M)
        case "sheet":
            return SheetTarget(pose=pose, width_m=1.5 * DIAMETER_M, height_m=DIAMETER_M)
    return TagTarget(pose=pose, side_m=DIAMETER_M, number=7)


@cache
def _image(kind: str, ahead_m: float, right_m: float = 0.0) -> Image:
    """Return a picture of a thing 2 m before where the camera began, after it has moved."""
    target = _target(kind, (0.1 - right_m, 0.05, 2.0 - ahead_m))
    seed = round(1000 * (ahead_m + abs(right_m)))
    return render(Scene(camera=LENS, target=target, seed=seed, backdrop=PlainBackdrop(bgr=(90, 84, 80)))).image


def _run(*arguments: object) -> Typed:
    return typed("calibrate", "size", *arguments)


@pytest.fixture
def camera(tmp_path: Path) -> Path:
    path = tmp_path / "camera.toml"
    save_camera_model(path, LENS)
    return path


def _pictures(folder: Path, *images: Image) -> list[Path]:
    paths = [folder / name for name in NAMES[: len(images)]]
    for path, image in zip(paths, images, strict=True):
        cv2.imwrite(str(path), image)
    return paths


def _steps(folder: Path, kind: str = "ball", ways_cm: tuple[int, ...] = (0, 25, 50)) -> list[str]:
    paths = _pictures(folder, *(_image(kind, cm / 100) for cm in ways_cm))
    return [f"{path}@{cm}cm" if cm else str(path) for path, cm in zip(paths, ways_cm, strict=True)]


@pytest.mark.parametrize(
    ("kind", "options", "sides"),
    [
        ("ball", BALL, {"diameter": DIAMETER_M}),
        ("disc", ("--disc", "?"), {"diameter": DIAMETER_M}),
        ("sheet", ("--sheet", "3cm,2cm"), {"width": 1.5 * DIAMETER_M, "height": DIAMETER_M}),
        ("tag", ("--tag", "unknown", "--family", "36h11"), {"side": DIAMETER_M}),
    ],
)
def test_each_kind_of_thing_is_learnt_and_its_lines_measure_right(kind, options, sides, camera, tmp_path) -> None:
    steps = _steps(tmp_path, kind)
    result = _run(*steps, "--camera", camera, *options)
    assert result.returncode == 0, result
    assert result.stderr == ""
    lines = dict(re.findall(r'^    (\w+) = "([\d.]+) mm"$', result.stdout, re.MULTILINE))
    assert [*lines] == [*sides, "tolerance"]
    for key, side_m in sides.items():
        assert float(lines[key]) / 1000 == pytest.approx(side_m, rel=0.02)
        assert f"{key} {100 * side_m:.0f}"[:-1] in result.stdout
    again = re.search(r"^for other commands: (.*)$", result.stdout, re.MULTILINE)
    assert again is not None
    measured = typed("measure", tmp_path / "c.png", "--camera", camera, "--json", *again[1].split(), *options[2:])
    assert json.loads(measured.stdout)["distance_m"] == pytest.approx(1.504, rel=0.02)


def test_sideways_steps_count_as_well(camera, tmp_path) -> None:
    a, b, c = _pictures(tmp_path, *(_image("ball", 0.0, right_m) for right_m in (0.0, 0.25, -0.25)))
    options = ("--camera", camera, *BALL, "--turn-error", "0.1")
    result = _run(a, f"{b}@25cm:right", f"{c}@25cm:left", *options)
    assert result.returncode == 0, result
    assert re.search(r"^diameter 1[78]\.\d cm ± 0\.[3-8] ", result.stdout)
    wrong = _run(a, f"{b}@25cm", f"{c}@-25cm", *options)
    assert wrong.returncode == 2
    assert "the steps" in wrong.stderr


def test_a_picture_without_the_thing_is_left_out_with_its_reason(camera, tmp_path) -> None:
    steps = _steps(tmp_path, ways_cm=(0, 25, 30, 50))
    cv2.imwrite(str(tmp_path / "c.png"), NOTHING)
    result = _run(*steps, "--camera", camera, *BALL, "--json")
    assert result.returncode == 1
    assert result.stderr.startswith(f"left out: {tmp_path / 'c.png'}: the picture is grey")
    answer = json.loads(result.stdout)
    assert answer["diameter_m"] == pytest.approx(DIAMETER_M, rel=0.05)
    assert answer["tolerance_m"] == pytest.approx(answer["sigma_share"] * answer["diameter_m"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("a.png",), "one picture says nothing about the size"),
        (("a.png", "b.png"), "does not say how far the camera has moved since the first picture; write it such as"),
        (("a.png", "b.png@0cm"), "all pictures are from one place, so the thing does not grow"),
        (("a.png", "b.png@25cm", "c.png@25cm"), "Lengths count from the first picture, not from the one before"),
        (("a.png", "b.png@-25cm", "c.png@-50cm"), "check the steps as you gave them, their directions too"),
    ],
)
def test_what_is_wrong_is_said_with_what_to_do(arguments, words, camera, tmp_path, monkeypatch) -> None:
    _steps(tmp_path)
    monkeypatch.chdir(tmp_path)
    result = _run(*arguments, "--camera", camera, *BALL)
    assert (result.returncode, result.stdout) == (2, "")
    assert words in result.stderr


def test_two_tags_are_not_taken_for_one(camera, tmp_path) -> None:
    other = TagTarget(pose=Pose(position_m=(0.1, 0.05, 1.7)), side_m=DIAMETER_M, number=9)
    image = render(Scene(camera=LENS, target=other, seed=1, backdrop=PlainBackdrop())).image
    a, b = _pictures(tmp_path, _image("tag", 0.0), image)
    result = _run(a, f"{b}@30cm", "--camera", camera, "--tag", "unknown", "--family", "36h11")
    assert result.returncode == 2
    assert f"{b} shows number 9, an earlier picture 7; say which one is meant with --id 7" in result.stderr
