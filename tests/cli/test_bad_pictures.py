"""Pictures that nobody would choose: each gives an ordinary result or one line that says what is wrong."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.config.camera_file import save_camera_model
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from support.command_line import Typed, typed


def _scene() -> Image:
    """Return a bright rectangle of letter paper's shape before something dark."""
    image = np.full((480, 640, 3), 60, np.uint8)
    image[155:325, 210:430] = 230
    return image


def _run(*arguments: object) -> Typed:
    return typed("measure", *arguments, "--sheet", "11in,8.5in")


@pytest.fixture
def camera(tmp_path: Path) -> tuple[str, str]:
    save_camera_model(tmp_path / "camera.toml", CameraModel.with_focal_length(600.0, 640, 480))
    return "--camera", str(tmp_path / "camera.toml")


def _with_transparency(image: Image) -> np.ndarray:
    opacity = np.full(image.shape[:2], 255, np.uint8)
    opacity[:100] = 0
    return np.dstack([image, opacity])


@pytest.mark.parametrize(
    "kind",
    [
        lambda image: image[..., 0],
        lambda image: image.astype(np.uint16) * 257,
        _with_transparency,
        lambda image: _with_transparency(image).astype(np.uint16) * 257,
    ],
    ids=["grey", "16 bits", "transparency", "transparency of 16 bits"],
)
def test_every_kind_of_png_is_measured_alike(tmp_path: Path, camera, kind: Callable[[Image], np.ndarray]) -> None:
    cv2.imwrite(str(tmp_path / "kind.png"), kind(_scene()))
    result = _run(tmp_path / "kind.png", *camera, "--json")
    assert result.returncode == 0
    assert json.loads(result.stdout)["distance_m"] == pytest.approx(0.2794 * 600 / 220, rel=0.01)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("empty.png", b"", "is empty"),
        ("text.png", b"hello", "is not a picture of a kind that is read"),
        ("cut.jpg", cv2.imencode(".jpg", _scene())[1].tobytes()[:2000], "is cut short"),
        ("cut.png", cv2.imencode(".png", _scene())[1].tobytes()[:200], "is cut short"),
        ("folder.png", None, "it is a folder"),
    ],
)
def test_what_is_no_picture_is_one_line_that_names_it_once(
    tmp_path: Path, camera, name: str, content: bytes | None, said: str
) -> None:
    path = tmp_path / name
    if content is None:
        path.mkdir()
    else:
        path.write_bytes(content)
    result = _run(path, *camera)
    assert result.returncode == 2
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert said in line
    assert line.count(str(path)) == 1


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "drive.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (640, 480))
    for _ in range(2):
        writer.write(_scene())
    writer.release()
    return path


@pytest.mark.parametrize(
    "command",
    [
        ("colour", "{}"),
        ("calibrate", "distance", "{}@1m", "--sheet", "A4", "-o", "camera.toml"),
        ("calibrate", "board", "{}", "--board", "9x6", "--square", "2cm", "-o", "camera.toml"),
    ],
)
def test_a_command_for_pictures_says_that_it_was_given_a_video(video: Path, command: tuple[str, ...]) -> None:
    result = typed(*(word.format(video) for word in command))
    assert result.returncode == 2
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"error: this is a video: {video}; `stadimeter measure` takes videos")


def test_a_video_is_measured_whatever_its_name_ends_with(video: Path, camera) -> None:
    unnamed = video.rename(video.with_name("drive"))
    assert len(_run(unnamed, *camera, "--json").stdout.splitlines()) == 2
