"""Boards are found in pictures, and their views collected from a camera."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame, Image, Optics
from stadimeter.errors import CalibrationError
from stadimeter.ranging.board_calibration import BoardView
from stadimeter.workbench.calibration.board_session import VIEWS_ENOUGH, BoardSession, CharucoBoard, Chessboard

# Collecting views of a board from a camera.

LENS = replace(CameraModel.with_focal_length(610.0, 640, 480), distortion=(-0.2, 0.06, 0.001, -0.0005, 0.0))
CORNERS = np.column_stack([axis.ravel() for axis in np.meshgrid(np.arange(9), np.arange(6))]) * 0.025
TILTS = [(0.6, 0.0), (-0.6, 0.0), (0.0, 0.6), (0.0, -0.6), (0.45, 0.45), (-0.45, -0.45), (0.45, -0.45), (-0.45, 0.45)]
PLACES = [(x, y) for y in (-0.11, 0.0, 0.11) for x in (-0.16, 0.0, 0.16)]


class KnownBoard:
    """Stands in for a board: says where its corners are in frames that hold no picture of it."""

    def __init__(self) -> None:
        self.corners_px: np.ndarray | None = None

    def find(self, picture: str, image: np.ndarray) -> BoardView | str:
        if self.corners_px is None:
            return "no chessboard of 9x6 inner corners"
        return BoardView(picture=picture, board_m=CORNERS, corners_px=self.corners_px)


def corners_at(turn: tuple[float, float], place: tuple[float, float], depth_m: float = 0.55) -> np.ndarray:
    rotation, _ = cv2.Rodrigues(np.array([*turn, 0.05]))
    flat = np.column_stack((CORNERS - CORNERS.mean(axis=0), np.zeros(len(CORNERS))))
    points = flat @ rotation.T + (*place, depth_m)
    noise_px = np.random.default_rng(abs(hash((turn, place)))).normal(0, 0.05, (len(CORNERS), 2))
    return LENS.project(points[:, :2] / points[:, 2:]) + noise_px


class Rig:
    """A session with a board that is put where a test wants it."""

    def __init__(self, *, must_be_steady: bool = False) -> None:
        self.board = KnownBoard()
        self.session = BoardSession(self.board, must_be_steady=must_be_steady)  # type: ignore[arg-type]
        self.frames = 0
        self.optics: Optics | None = None

    def show(self, corners_px: np.ndarray | None, size: tuple[int, int] = (640, 480)) -> str:
        self.board.corners_px = corners_px
        self.frames += 1
        image = np.zeros((size[1], size[0], 3), np.uint8)
        return self.session.look(Frame(image, self.frames / 30, self.frames, optics=self.optics))


def test_a_good_session_ends_by_itself_with_the_lens() -> None:
    rig = Rig()
    for index in range(60):
        if rig.session.is_done:
            break
        rig.show(corners_at(TILTS[index % len(TILTS)], PLACES[(index * 2) % len(PLACES)]))
    assert rig.session.is_done
    assert rig.session.missing() == ()
    assert VIEWS_ENOUGH <= len(rig.session.views) < 30
    made = rig.session.calibration
    assert made is not None
    assert made.camera_model.fx_px == pytest.approx(610, rel=0.01)
    assert made.camera_model.focal_relative_sigma < 0.01


def test_a_view_that_is_much_like_another_is_not_taken_again() -> None:
    rig = Rig()
    assert rig.show(corners_at(TILTS[0], PLACES[4])) == ""
    why_not = rig.show(corners_at(TILTS[0], PLACES[4]) + 20)
    assert why_not == "much like view 1; move it further, or tilt it more"
    assert rig.show(corners_at(TILTS[0], PLACES[4]) + 60) == "", "elsewhere"
    assert rig.show(corners_at(TILTS[1], PLACES[4])) == "", "tilted"
    assert rig.show(corners_at(TILTS[0], PLACES[4], 0.45)) == "", "nearer"


def test_a_board_in_motion_is_taken_once_it_is_held_still() -> None:
    rig = Rig(must_be_steady=True)
    here = corners_at(TILTS[0], PLACES[4])
    assert rig.show(here) == "hold it still"
    assert rig.show(here + 4).startswith("hold it still: it moves by 5.7 px from frame to frame, limit 1.3 px")
    assert rig.show(here + 4.1) == ""
    assert len(rig.session.views) == 1


def test_a_camera_that_changes_its_resolution_is_refused() -> None:
    rig = Rig()
    rig.show(corners_at(TILTS[0], PLACES[4]))
    with pytest.raises(CalibrationError, match="view 2 has 320x240 px, those before it 640x480"):
        rig.show(corners_at(TILTS[1], PLACES[4]), (320, 240))


def test_the_settings_of_the_camera_are_recorded_and_must_stay() -> None:
    rig = Rig()
    rig.optics = optics = Optics(sensor="imx219", sensor_size_px=(1640, 1232), crop_px=(0, 0, 3280, 2464))
    for index in range(12):
        rig.show(corners_at(TILTS[index % len(TILTS)], PLACES[(index * 2) % len(PLACES)]))
    assert rig.session.calibration is not None
    assert rig.session.calibration.camera_model.optics == optics
    rig.optics = replace(optics, crop_px=(680, 692, 1920, 1080))
    with pytest.raises(CalibrationError, match="calibrated with another crop of the sensor"):
        rig.show(corners_at(TILTS[1], PLACES[4]))


# Boards are found in pictures, and their corners placed well enough to calibrate from.

BOARD = Chessboard(columns=9, rows=6, square_m=0.025)
CHARUCO = CharucoBoard(columns=5, rows=7, square_m=0.04, marker_m=0.02, dictionary="6X6_250")


def drawn(square_px: int = 40) -> Image:
    """A chessboard of 10x7 squares on white, facing the camera; its first inner corner is at (2, 2) squares."""
    squares = np.indices((7, 10)).sum(axis=0) % 2
    board = np.kron(np.where(squares == 0, 30, 225), np.ones((square_px, square_px)))
    framed = cv2.copyMakeBorder(board.astype(np.uint8), *([square_px] * 4), cv2.BORDER_CONSTANT, value=225)
    return cv2.cvtColor(cv2.GaussianBlur(framed, (0, 0), 1.0), cv2.COLOR_GRAY2BGR)


@pytest.mark.parametrize("square_px", [12, 40, 250])
def test_the_corners_are_where_they_were_drawn(square_px: int) -> None:
    found = BOARD.find("a.png", drawn(square_px))
    assert isinstance(found, BoardView)
    expected = (np.stack(np.meshgrid(np.arange(9), np.arange(6)), axis=2).reshape(-1, 2) + 2) * square_px - 0.5
    sorted_px = found.corners_px[np.lexsort(np.round(found.corners_px / square_px).T)]
    assert sorted_px == pytest.approx(expected, abs=0.06)


def test_a_charuco_board_may_be_partly_hidden() -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    image = cv2.aruco.CharucoBoard((5, 7), 0.04, 0.02, dictionary).generateImage((500, 700), marginSize=20)
    image[:, 300:] = 200
    found = CHARUCO.find("a.png", cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    assert isinstance(found, BoardView)
    assert 6 <= len(found.corners_px) < 24
    image[:, 120:] = 200
    assert "corners of the ChArUco board" in str(CHARUCO.find("a.png", cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)))


def test_a_marker_larger_than_its_square_and_an_unknown_dictionary_are_refused() -> None:
    with pytest.raises(CalibrationError, match="does not fit into a square"):
        CharucoBoard(columns=5, rows=7, square_m=0.02, marker_m=0.04, dictionary="4X4_50")
    with pytest.raises(CalibrationError, match=r"there is no marker dictionary '4X5_50'; there are .*4X4_50"):
        CharucoBoard(columns=5, rows=7, square_m=0.04, marker_m=0.02, dictionary="4X5_50")
