"""Finding the corners of a calibration board in a picture.

The corners that OpenCV finds are only roughly placed; how well they are refined decides what the calibration is worth.
`cv2.cornerSubPix` looks at a window around each corner. Too large and the window reaches the next corners, which pull
at it; too small and noise decides. Half a window of 0.3 of the distance between corners gave the least reprojection
error on three cameras, against fixed windows of 3 to 11 px, and against `cv2.findChessboardCornersSB` by itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.frame import Image
from stadimeter.errors import CalibrationError
from stadimeter.ranging.board_calibration import BoardView

WINDOW_SHARE = 0.3
"""Half the window around a corner, as a share of the distance to the nearest other corner."""

WINDOW_MIN_PX, WINDOW_MAX_PX = 2, 30

SEARCH_LONGEST_PX = 2048
"""Larger pictures are searched at a smaller scale; the corners are refined at full scale."""

CHARUCO_CORNERS_MIN = 6

_REFINED = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
_CLASSIC = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK


@dataclass(frozen=True, slots=True, kw_only=True)
class Chessboard:
    """A chessboard.

    Attributes:
        columns: Inner corners along one side: one less than there are squares.
        rows: Inner corners along the other side.
    """

    columns: int
    rows: int
    square_m: float

    def find(self, picture: str, image: Image) -> BoardView | str:
        """Find the inner corners.

        Args:
            image: The picture, shape (height, width, 3).

        Returns:
            All corners; or why there are none.
        """
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        rough = self._rough(grey)
        if rough is None:
            return f"no chessboard of {self.columns}x{self.rows} inner corners"
        spacing_px = _smallest_spacing_px(rough.reshape(self.rows, self.columns, 2))
        window = int(np.clip(WINDOW_SHARE * spacing_px, WINDOW_MIN_PX, WINDOW_MAX_PX))
        corners = cv2.cornerSubPix(grey, rough.astype(np.float32), (window, window), (-1, -1), _REFINED)
        across, along = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        return BoardView(
            picture=picture,
            board_m=(np.column_stack((across.ravel(), along.ravel())) * self.square_m).astype(np.float64),
            corners_px=corners.reshape(-1, 2).astype(np.float64),
        )

    def _rough(self, grey: NDArray[Any]) -> NDArray[Any] | None:
        """Return the corners at full scale, roughly placed; the second way finds boards that the first does not."""
        scale = min(1.0, SEARCH_LONGEST_PX / max(grey.shape))
        smaller = grey if scale == 1.0 else cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        found, corners = cv2.findChessboardCorners(smaller, (self.columns, self.rows), flags=_CLASSIC)
        if not found:
            found, corners = cv2.findChessboardCornersSB(smaller, (self.columns, self.rows))
        return (corners + 0.5) / scale - 0.5 if found else None


@dataclass(frozen=True, slots=True, kw_only=True)
class CharucoBoard:
    """A chessboard with a marker in every white square, which need not be in the picture as a whole.

    Attributes:
        dictionary: The markers' dictionary, such as ``4X4_50``.
    """

    columns: int
    rows: int
    square_m: float
    marker_m: float
    dictionary: str

    def __post_init__(self) -> None:
        if not self.marker_m < self.square_m:
            raise CalibrationError(
                f"a marker of {self.marker_m:g} m does not fit into a square of {self.square_m:g} m; check --marker "
                "and --square"
            )
        self._dictionary()

    def find(self, picture: str, image: Image) -> BoardView | str:
        """Find the corners between the squares.

        Args:
            image: The picture, shape (height, width, 3).

        Returns:
            Those corners that can be seen; or why there are too few.
        """
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        board_m, corners_px = max(
            (self._found(grey, legacy=old) for old in (False, True)), key=lambda found: len(found[0])
        )
        all_corners = (self.columns - 1) * (self.rows - 1)
        if len(board_m) < min(CHARUCO_CORNERS_MIN, all_corners):
            return f"{len(board_m)} of {all_corners} corners of the ChArUco board, {CHARUCO_CORNERS_MIN} are needed"
        if np.linalg.matrix_rank(board_m - board_m[0], tol=self.square_m / 2) < 2:
            return f"the {len(board_m)} corners of the ChArUco board that can be seen are in one line"
        return BoardView(picture=picture, board_m=board_m, corners_px=corners_px)

    def _found(self, grey: NDArray[Any], *, legacy: bool) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return corners on the board and in the picture; boards of OpenCV before 4.6 begin with a white square."""
        size = (self.columns, self.rows)
        board = cv2.aruco.CharucoBoard(size, self.square_m, self.marker_m, self._dictionary())
        board.setLegacyPattern(legacy)
        corners: Any
        ids: Any
        corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
        if ids is None:
            return np.empty((0, 2)), np.empty((0, 2))
        on_board = np.asarray(board.getChessboardCorners(), dtype=np.float64)[np.asarray(ids).ravel(), :2]
        return on_board, np.asarray(corners, dtype=np.float64).reshape(-1, 2)

    def _dictionary(self) -> cv2.aruco.Dictionary:
        wanted = self.dictionary.upper().removeprefix("DICT_")
        number = getattr(cv2.aruco, f"DICT_{wanted}", None)
        if number is None:
            known = ", ".join(sorted(name.removeprefix("DICT_") for name in dir(cv2.aruco) if name.startswith("DICT_")))
            raise CalibrationError(f"there is no marker dictionary {self.dictionary!r}; there are {known}")
        return cv2.aruco.getPredefinedDictionary(number)


Board = Chessboard | CharucoBoard


def _smallest_spacing_px(grid: NDArray[Any]) -> float:
    """Return the least distance between neighbours in a grid of corners, shape (rows, columns, 2)."""
    steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2) for axis in (0, 1)]
    return float(min(step.min() for step in steps))
