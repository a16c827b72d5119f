"""The commands for two cameras: ``calibrate stereo``, and ``measure --stereo``."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.config.camera_file import load_stereo_rig, save_stereo_rig
from stadimeter.core.stereo_rig import UNKNOWNS, StereoRig, with_uncertainties
from support.command_line import typed
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.plane import Pose, TagTarget
from support.scenes.render import render
from support.scenes.scene import Scene
from support.scenes.target import Target
from support.stereo import in_right, pair_of, project, rotation_of, true_rig

BOARD = ("--board", "9x6", "--square", "25mm")
BALL = ("--ball", "6.7cm", "--hsv", "29,86,6:64,255,255")
TAG = ("--tag", "10cm", "--family", "36h11")
POSE = Pose(position_m=(0.15, 0.05, 1.2), tilt_rad=0.3, tilt_towards_rad=1.0)
AWAY_M = math.hypot(*POSE.position_m)
WALL = PlainBackdrop(bgr=(90, 84, 80))


@pytest.fixture(scope="module")
def true() -> StereoRig:
    return true_rig(4)


def draw_board(path: Path, rig: StereoRig, *, in_left: bool, turn: tuple[float, ...], place: tuple[float, ...]) -> None:
    """Draw a chessboard as one of the cameras sees it."""
    squares = np.where(np.indices((7, 10)).sum(axis=0) % 2 == 0, 30, 225)
    board = cv2.copyMakeBorder(np.kron(squares, np.ones((40, 40))).astype(np.uint8), 40, 40, 40, 40, 0, value=225)
    corners_px = np.array([[0.0, 0.0], [479, 0], [479, 359], [0, 359]])
    corners_m = (corners_px - (239.5, 179.5)) * 0.025 / 40
    points_m = np.column_stack((corners_m, np.zeros(4))) @ rotation_of(np.array(turn)).T + place
    camera = rig.left if in_left else rig.right
    seen = project(points_m if in_left else in_right(points_m, rig), camera)
    view = cv2.getPerspectiveTransform(corners_px.astype(np.float32), seen.astype(np.float32))
    image = cv2.warpPerspective(board, view, (640, 480), flags=cv2.INTER_AREA, borderValue=120)
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), cv2.cvtColor(cv2.GaussianBlur(image, (0, 0), 0.7), cv2.COLOR_GRAY2BGR))


@pytest.fixture(scope="module")
def boards(true: StereoRig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("boards")
    turns = [(0.6, 0, 0), (-0.6, 0, 0.1), (0, 0.6, 0), (0, -0.6, 0.2), (0.4, 0.4, 0), (-0.4, 0.4, 0), (0.4, -0.4, 0.1)]
    places = [(0.06, 0, 0.5), (0.1, 0.05, 0.6), (0.0, 0.05, 0.7), (0.12, -0.06, 0.6), (0.06, 0.03, 0.8)]
    for number, turn in enumerate(turns):
        for side in ("left", "right"):
            path = folder / side / f"{number}.png"
            draw_board(path, true, in_left=side == "left", turn=turn, place=places[number % len(places)])
    return folder


def pictures_of(folder: Path) -> list[Path]:
    return sorted((folder / "left").iterdir()) + sorted((folder / "right").iterdir())


@pytest.fixture
def output(tmp_path: Path) -> Path:
    return tmp_path / "stereo.toml"


def test_the_stereo_file_is_written_and_told(true: StereoRig, boards: Path, output: Path) -> None:
    result = typed("calibrate", "stereo", *pictures_of(boards), *BOARD, "-o", output)
    assert result.returncode == 0, result
    lines = result.stdout.splitlines()
    assert all(line.startswith(f"pair {number}") for number, line in enumerate(lines[:7], 1))
    assert "error 0." in lines[0]
    assert "epipolar 0." in lines[0]
    assert lines[7].startswith("error 0.")
    assert "over 7 pairs, epipolar 0." in lines[7]
    assert lines[8].startswith("left camera: focal length ")
    assert lines[10].startswith("the cameras are 12")
    assert lines[11].startswith("distances straight ahead are sure to ")
    assert lines[12] == f"wrote {output}"
    assert "7 pairs are few" in result.stderr
    rig = load_stereo_rig(output)
    assert rig.place_m == pytest.approx(true.place_m, abs=0.002)
    assert rig.provenance.method == "7 pairs of pictures of a board"


def test_a_board_in_only_one_picture_of_a_pair_leaves_it_out(boards: Path, output: Path) -> None:
    wall = output.parent / "wall.png"
    cv2.imwrite(str(wall), np.full((480, 640, 3), 90, np.uint8))
    pictures = pictures_of(boards)
    (boards / "right" / "7.png").write_bytes(wall.read_bytes())
    (boards / "left" / "7.png").write_bytes(pictures[0].read_bytes())
    try:
        result = typed("calibrate", "stereo", *pictures_of(boards), *BOARD, "-o", output, "--json")
    finally:
        (boards / "right" / "7.png").unlink()
        (boards / "left" / "7.png").unlink()
    assert result.returncode == 1
    assert f"left out: {boards}/left/7.png, {boards}/right/7.png: {boards}/right/7.png: no chessboard" in result.stderr
    answer = json.loads(result.stdout)
    assert (answer["file"], answer["replaced"], len(answer["pairs"])) == (str(output), False, 7)
    assert answer["baseline_m"] == pytest.approx(0.12, abs=0.005)
    assert output.exists()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda paths: paths[:-1], "there are 13 pictures; give as many of both cameras"),
        (lambda paths: paths[:2] + paths[7:9], "2 pairs show the board in both pictures; two cameras need 3"),
        (lambda paths: [*paths, paths[0]], "is given twice"),
    ],
)
def test_what_is_wrong_with_the_pictures_is_said(
    boards: Path, output: Path, change: Callable[[list[Path]], list[Path]], said: str
) -> None:
    result = typed("calibrate", "stereo", *change(pictures_of(boards)), *BOARD, "-o", output)
    assert result.returncode == 2
    assert said in result.stderr
    assert not output.exists()


Shot = Callable[[Target], tuple[Path, Path]]


@pytest.fixture
def shoot(true: StereoRig, tmp_path: Path) -> Shot:
    """Take a picture of a target with both cameras."""

    def take(target: Target) -> tuple[Path, Path]:
        scenes = pair_of(Scene(camera=true.left, target=target, seed=5, backdrop=WALL), true)
        for name, scene in (("left", scenes.left), ("right", scenes.right)):
            cv2.imwrite(str(tmp_path / f"{name}.png"), render(scene).image)
        return tmp_path / "left.png", tmp_path / "right.png"

    return take


@pytest.fixture
def stereo(true: StereoRig, tmp_path: Path) -> tuple[str, str]:
    covariance = np.zeros((UNKNOWNS, UNKNOWNS))
    covariance[19, 19] = 0.0003**2
    path = tmp_path / "known.toml"
    save_stereo_rig(path, with_uncertainties(replace(true, covariance=covariance)))
    return "--stereo", str(path)


def ball(size: float = 1.0) -> BallTarget:
    return BallTarget(position_m=POSE.position_m, diameter_m=0.067 * size)


def test_a_ball_is_measured_by_both_cameras(shoot: Shot, stereo: tuple[str, str]) -> None:
    left, right = shoot(ball())
    result = typed("measure", left, right, *stereo, *BALL, "--json")
    assert result.returncode == 0, result
    record = json.loads(result.stdout)
    assert (record["file"], record["right_file"]) == (str(left), str(right))
    assert record["distance_m"] == pytest.approx(AWAY_M, abs=3 * record["sigma_m"])
    assert record["triangulated_m"] == pytest.approx(AWAY_M, rel=0.01)
    assert record["by_size_m"] == pytest.approx(AWAY_M, rel=0.01)
    assert record["sigma_m"] < min(record["triangulated_sigma_m"], record["by_size_sigma_m"])
    assert abs(record["miss_px"]) < 3 * record["miss_sigma_px"]
    assert record["disagreement"] == ""


def test_a_target_in_only_one_picture_has_no_distance_and_what_one_camera_says(
    shoot: Shot, stereo: tuple[str, str], tmp_path: Path
) -> None:
    left, right = shoot(TagTarget(pose=POSE, side_m=0.1, number=7))
    cv2.imwrite(str(right), np.full((480, 640, 3), 90, np.uint8))
    result = typed("measure", left, right, *stereo, *TAG, "--json")
    assert result.returncode == 1
    record = json.loads(result.stdout)
    assert (record["status"], record["id"], record["triangulated_m"]) == ("not_found", 7, None)
    assert record["reason"].startswith(f"{right}: it is not there; the left camera alone has it at 1.2")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("left.png", "--camera", "c.toml"), "leave out --camera"),
        (("left.png", "--between", "1,2"), "leave out --between"),
        (("film.mp4", "left.png"), "film.mp4 is a video"),
    ],
)
def test_what_does_not_go_with_two_cameras_is_said(
    stereo: tuple[str, str], arguments: tuple[str, ...], said: str
) -> None:
    result = typed("measure", *arguments, *stereo, *BALL)
    assert result.returncode == 2
    assert said in result.stderr
