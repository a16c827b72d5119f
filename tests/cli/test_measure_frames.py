"""`measure` in videos and before cameras, of several tags, and between two of them."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.config.camera_file import save_camera_model
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame
from stadimeter.errors import CaptureTimeoutError
from stadimeter.workbench import frame_source
from stadimeter.workbench.frame_source import Source
from support.command_line import Typed, typed

pytestmark = [pytest.mark.vision, pytest.mark.oldest_opencv]

TAG = ("--tag", "10cm", "--family", "36h11")
SIDE_PX = 80
LEFT, RIGHT = (160, 200), (480, 280)


def _run(*arguments: object) -> Typed:
    return typed("measure", *arguments)


@pytest.fixture
def camera(tmp_path: Path) -> tuple[str, str]:
    save_camera_model(tmp_path / "camera.toml", CameraModel.with_focal_length(600.0, 640, 480))
    return "--camera", str(tmp_path / "camera.toml")


def _scene(tags: dict[int, tuple[int, int]]) -> np.ndarray:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    image = np.full((480, 640), 120, np.uint8)
    for number, (x, y) in tags.items():
        paper = np.full((SIDE_PX + 40, SIDE_PX + 40), 225, np.uint8)
        paper[20:-20, 20:-20] = np.maximum(cv2.aruco.generateImageMarker(dictionary, number, SIDE_PX), 20)
        half = len(paper) // 2
        image[y - half : y + half, x - half : x + half] = paper
    return np.repeat(image[:, :, np.newaxis], 3, axis=2)


@pytest.fixture
def two_tags(tmp_path: Path) -> Path:
    cv2.imwrite(str(tmp_path / "two.png"), _scene({3: LEFT, 7: RIGHT}))
    return tmp_path / "two.png"


@pytest.fixture
def video(tmp_path: Path) -> Path:
    """Return a video of 10 frames a second: a tag, nothing, and two tags."""
    writer = cv2.VideoWriter(str(tmp_path / "drive.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (640, 480))
    assert writer.isOpened()
    for tags in ({3: LEFT}, {}, {3: LEFT, 7: RIGHT}):
        writer.write(_scene(tags))
    writer.release()
    return tmp_path / "drive.avi"


def test_several_tags_are_each_measured(two_tags: Path, camera) -> None:
    records = [json.loads(line) for line in _run(two_tags, *camera, *TAG, "--json").stdout.splitlines()]
    assert [(each["target"], each["id"], each["status"]) for each in records] == [
        ("tag", 3, "measured"),
        ("tag", 7, "measured"),
    ]
    assert records[0]["bearing_rad"] < 0 < records[1]["bearing_rad"]
    (only,) = _run(two_tags, *camera, *TAG, "--id", "7", "--json").stdout.splitlines()
    assert json.loads(only)["id"] == 7
    left, right = _run(two_tags, *camera, *TAG).stdout.splitlines()
    assert "  tag 3  " in left
    assert "  tag 7  " in right


def test_a_position_is_given_in_the_cameras_frame(tmp_path: Path, camera) -> None:
    cv2.imwrite(str(tmp_path / "one.png"), _scene({11: LEFT}))
    record = json.loads(_run(tmp_path / "one.png", *camera, *TAG, "--json").stdout)
    depth_m = 600 * 0.1 / SIDE_PX
    expected = [(LEFT[0] - 319.5) / 600 * depth_m, (LEFT[1] - 239.5) / 600 * depth_m, depth_m]
    assert [record["x_m"], record["y_m"], record["z_m"]] == pytest.approx(expected, abs=0.01)
    assert math.hypot(record["x_m"], record["y_m"], record["z_m"]) == pytest.approx(record["distance_m"])
    assert 0 < record["bearing_sigma_rad"] < 1e-3
    line = _run(tmp_path / "one.png", *camera, *TAG).stdout
    found = re.search(r"depth \S+ \S+ ± \S+ +\((-?[\d.]+), (-?[\d.]+), ([\d.]+)\) cm", line)
    assert found, line
    assert [float(each) / 100 for each in found.groups()] == pytest.approx(expected, abs=0.01)


def test_the_distance_between_two_tags_is_printed_when_asked(two_tags: Path, camera) -> None:
    depth_m = 600 * 0.1 / SIDE_PX
    expected_m = math.hypot(RIGHT[0] - LEFT[0], RIGHT[1] - LEFT[1]) / 600 * depth_m
    result = _run(two_tags, *camera, *TAG, "--between", "3,7", "--json")
    *tags, pair = map(json.loads, result.stdout.splitlines())
    assert [(each["target"], each["id"]) for each in tags] == [("tag 3", 3), ("tag 7", 7)]
    assert pair["between"] == ["tag 3", "tag 7"]
    assert pair["distance_m"] == pytest.approx(expected_m, rel=0.01)
    assert 0 < pair["sigma_m"] < 0.01
    assert re.search(r"tag 3 to tag 7  \d+\.\d cm ± ", _run(two_tags, *camera, *TAG, "--between", "3,7").stdout)
    assert result.returncode == 0


def test_with_one_of_both_missing_the_distance_between_them_is_unknown(two_tags: Path, camera) -> None:
    result = _run(two_tags, *camera, *TAG, "--between", "3,8")
    assert result.stdout.splitlines()[-1].endswith("tag 3 to tag 8  unknown: not both are measured")
    assert result.returncode == 1


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((*TAG, "--between", "3,3"), "does not name two targets"),
        ((*TAG, "--between", "3,7", "--id", "3"), "--between names two tags, --id one"),
        (("--sheet", "11in,8.5in", "--between", "a,b"), "there is no target 'a', only sheet"),
        ((*TAG, "--live", "images,paths=x.png"), "one of the two"),
    ],
)
def test_a_wrong_option_is_one_line_and_exit_2(two_tags: Path, camera, options, said: str) -> None:
    result = _run(two_tags, *camera, *options)
    assert result.returncode == 2
    (line,) = result.stderr.splitlines()
    assert said in line


def test_a_video_gives_a_line_for_each_frame_with_its_number_and_time(video: Path, camera) -> None:
    result = _run(video, *camera, *TAG, "--json")
    records = [json.loads(line) for line in result.stdout.splitlines()]
    assert [record["frame"] for record in records] == [0, 1, 2, 2]
    assert [record["time_s"] for record in records] == pytest.approx([0.0, 0.1, 0.2, 0.2])
    assert [record["status"] for record in records] == ["measured", "not_found", "measured", "measured"]
    assert result.returncode == 0, "one frame at least shows it"
    first = _run(video, *camera, *TAG).stdout.splitlines()[0]
    assert re.match(rf"{re.escape(str(video))}  frame    0     0\.000 s  tag 3  ", first)


class Interrupted:
    """A live camera that gives a frame, pauses, gives another, and is then stopped with Ctrl-C."""

    def __init__(self, image: np.ndarray) -> None:
        self.is_closed = False
        pause = CaptureTimeoutError("no new frame in 0.50 s")
        frames = [Frame(image, 5.0 + number / 4, number) for number in range(2)]
        self._events: list[Frame | BaseException] = [frames[0], pause, pause, frames[1], KeyboardInterrupt()]

    def open(self) -> None:
        """Do nothing: it is open."""

    def latest(self, timeout_s: float) -> Frame:
        event = self._events.pop(0)
        if isinstance(event, BaseException):
            raise event
        return event

    def trouble(self) -> str:
        return ""

    def remarks(self) -> tuple[str, ...]:
        return ("asked for a fixed focus, the camera keeps refocusing",)

    def not_for_motion(self) -> str:
        return ""

    def close(self) -> None:
        self.is_closed = True


def test_a_live_camera_goes_on_until_ctrl_c(camera, monkeypatch: pytest.MonkeyPatch) -> None:
    capture = Interrupted(_scene({3: LEFT}))
    monkeypatch.setattr(frame_source, "open_source", lambda _: Source(capture=capture, is_live=True))
    result = _run("--live", "opencv,device=0", *camera, *TAG, "--json")
    records = [json.loads(line) for line in result.stdout.splitlines()]
    assert [(each["frame"], each["time_s"], each["id"]) for each in records] == [(0, 0.0, 3), (1, 0.25, 3)]
    assert result.returncode == 0
    assert capture.is_closed
    assert result.stderr.splitlines() == [
        "note: asked for a fixed focus, the camera keeps refocusing",
        "note: no new frame in 0.50 s",
        "stopped after 2 frames",
    ]
