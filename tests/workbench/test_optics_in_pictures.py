"""Snapshots keep how the camera was set, and whatever reads them goes by it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.cameras.image_files import ImageFilesCamera
from stadimeter.config.camera_file import optics_in, with_optics
from stadimeter.core.frame import Image, Optics
from stadimeter.errors import CalibrationError
from stadimeter.testing.rig import ManualClock
from stadimeter.workbench.annotation import write_picture
from stadimeter.workbench.calibration.board_session import Chessboard, find_boards

OPTICS = Optics(sensor="imx708", sensor_size_px=(2304, 1296), crop_px=(0, 0, 4608, 2592), lens_position_dpt=2.0)


@pytest.fixture
def board() -> Image:
    squares = np.kron(np.indices((5, 6)).sum(axis=0) % 2, np.ones((40, 40)))
    return np.pad(
        cv2.cvtColor((255 * squares).astype(np.uint8), cv2.COLOR_GRAY2BGR),
        ((60, 60), (60, 60), (0, 0)),
        constant_values=255,
    )


@pytest.mark.parametrize(
    "optics", [OPTICS, replace(OPTICS, lens_position_dpt=None, upside_down=True), replace(OPTICS, sensor="größer\0")]
)
def test_a_png_carries_the_settings_of_its_camera_and_the_same_pixels(
    board: Image, tmp_path: Path, optics: Optics
) -> None:
    path = tmp_path / "shot.png"
    write_picture(path, board, optics)
    camera = ImageFilesCamera((str(path),), 1.0, ManualClock())
    camera.open()
    frame = camera.read()
    assert frame.optics == optics
    assert np.array_equal(frame.image, board)


@pytest.mark.parametrize("name", ["shot.jpg", "shot.png"])
def test_a_picture_without_settings_says_none(board: Image, tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    write_picture(path, board, OPTICS if name.endswith(".jpg") else None)
    assert optics_in(path.read_bytes()) is None


@pytest.mark.parametrize("spoilt", [b"sensor", b"crop_px", b"4608", b"{"])
def test_settings_that_make_no_sense_are_none(board: Image, spoilt: bytes) -> None:
    data = with_optics(cv2.imencode(".png", board)[1].tobytes(), OPTICS)
    assert optics_in(data.replace(spoilt, spoilt.swapcase().replace(b"4608", b"-608").replace(b"{", b"["))) is None


def test_a_calibration_from_pictures_of_two_settings_is_refused(board: Image, tmp_path: Path) -> None:
    paths = [tmp_path / "one.png", tmp_path / "two.png"]
    write_picture(paths[0], board, OPTICS)
    write_picture(paths[1], board, OPTICS)
    wanted = Chessboard(columns=5, rows=4, square_m=0.025)
    assert find_boards(paths, wanted).optics == OPTICS
    write_picture(paths[1], board, replace(OPTICS, lens_position_dpt=4.0))
    with pytest.raises(CalibrationError, match=r"two\.png: calibrated with the lens at 2 dioptres, now it is at 4"):
        find_boards(paths, wanted)
