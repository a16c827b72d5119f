"""Calibration boards: their corners in pictures, and views collected while a person moves a board before a camera.

OpenCV's ``cornerSubPix`` looks at a window around each corner. The larger it is the less noise and blur matter, until
it reaches the neighbours, which a tilted board or a bent picture brings nearer. Which window is best differs from
picture to picture, so several are tried. ``findChessboardCornersSB`` (A. Duda and U. Frese, "Accurate detection and
localization of checkerboard corners for calibration", BMVC 2018) is surer where little is left of the corners, but
shifts them by up to a third of a pixel where the board is seen obliquely, alike for neighbours.

How good corners are shows without a lens: along a row or column of a board their places are a smooth curve, and the
third difference of it is noise, multiplied by the square root of 20.
"""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.frame import Frame, Image, Optics
from stadimeter.errors import CalibrationError
from stadimeter.ranging.board_calibration import (
    VIEWS_ENOUGH,
    BoardCalibration,
    BoardView,
    apart_px,
    calibrate_board,
    coverage,
    in_common,
)
from stadimeter.workbench.measuring import open_picture

# Larger pictures are searched at a smaller scale; the corners are refined at full scale.
MAX_SEARCH_PX = 2048

CHARUCO_CORNERS_MIN = 6

_CLASSIC = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK


class Chessboard(Struct, frozen=True, kw_only=True):
    """A chessboard.

    Attributes:
        columns: Inner corners along one side: one less than there are squares.
    """

    columns: int
    rows: int
    square_m: float

    def find(self, picture: str, image: Image) -> BoardView | str:
        """Return all inner corners; or why there are none."""
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        rough = self._rough(grey)
        if rough is None:
            return f"no chessboard of {self.columns}x{self.rows} inner corners"
        across, along = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        return BoardView(
            picture=picture,
            board_m=(np.column_stack((across.ravel(), along.ravel())) * self.square_m).astype(np.float64),
            corners_px=refine_corners(grey, rough, self.columns, self.rows),
        )

    def _rough(self, grey: NDArray[Any]) -> NDArray[Any] | None:
        """Return the corners at full scale, roughly placed; the second way finds boards that the first does not."""
        scale = min(1.0, MAX_SEARCH_PX / max(grey.shape))
        smaller = grey if scale == 1.0 else cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        found, corners = cv2.findChessboardCorners(smaller, (self.columns, self.rows), flags=_CLASSIC)
        if not found:
            found, corners = cv2.findChessboardCornersSB(smaller, (self.columns, self.rows))
        return (corners + 0.5) / scale - 0.5 if found else None


class CharucoBoard(Struct, frozen=True, kw_only=True):
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
        """Return the corners between the squares that can be seen; or why there are too few."""
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        board_m, corners_px = max(
            (self._find_corners(grey, legacy=old) for old in (False, True)), key=lambda found: len(found[0])
        )
        all_corners = (self.columns - 1) * (self.rows - 1)
        if len(board_m) < min(CHARUCO_CORNERS_MIN, all_corners):
            return f"{len(board_m)} of {all_corners} corners of the ChArUco board, {CHARUCO_CORNERS_MIN} are needed"
        if np.linalg.matrix_rank(board_m - board_m[0], tol=self.square_m / 2) < 2:
            return f"the {len(board_m)} corners of the ChArUco board that can be seen are in one line"
        return BoardView(picture=picture, board_m=board_m, corners_px=corners_px)

    def _find_corners(self, grey: NDArray[Any], *, legacy: bool) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return corners on the board and in the picture; boards of OpenCV before 4.6 begin with a white square."""
        board = self.of_opencv()
        board.setLegacyPattern(legacy)
        corners: Any
        ids: Any
        corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
        if ids is None:
            return np.empty((0, 2)), np.empty((0, 2))
        on_board = np.asarray(board.getChessboardCorners(), dtype=np.float64)[np.asarray(ids).ravel(), :2]
        return on_board, np.asarray(corners, dtype=np.float64).reshape(-1, 2)

    def of_opencv(self) -> cv2.aruco.CharucoBoard:
        """Return the board as OpenCV has it."""
        size = (self.columns, self.rows)
        return cv2.aruco.CharucoBoard(size, self.square_m, self.marker_m, self._dictionary())

    def _dictionary(self) -> cv2.aruco.Dictionary:
        wanted = self.dictionary.upper().removeprefix("DICT_")
        number = getattr(cv2.aruco, f"DICT_{wanted}", None)
        if number is None:
            known = ", ".join(sorted(name.removeprefix("DICT_") for name in dir(cv2.aruco) if name.startswith("DICT_")))
            raise CalibrationError(f"there is no marker dictionary {self.dictionary!r}; there are {known}")
        return cv2.aruco.getPredefinedDictionary(number)


Board = Chessboard | CharucoBoard


def today() -> str:
    """Return the date of today, as ISO 8601 has it."""
    return dt.datetime.now().astimezone().date().isoformat()


class BoardViews:
    """Views of a board in pictures of one camera that has one resolution and is set in one way.

    Attributes:
        missed: Picture and reason, for each in which it was not.
        optics: How the camera was set, if a picture says it.
    """

    def __init__(self, board: Board) -> None:
        self._board = board
        self.views: list[BoardView] = []
        self.missed: list[tuple[str, str]] = []
        self.width_px = self.height_px = 0
        self.optics: Optics | None = None

    def find(self, picture: str, frame: Frame) -> BoardView | str:
        """Look for the board in a picture; return it, or why it is not there.

        Raises:
            CalibrationError: It has another resolution than those before, or the camera was set otherwise.
        """
        here, before = (frame.width_px, frame.height_px), (self.width_px, self.height_px)
        if self.width_px and here != before:
            raise CalibrationError(
                f"{picture} has {here[0]}x{here[1]} px, those before it {before[0]}x{before[1]}; calibrate from "
                "pictures of one resolution, all held the same way"
            )
        self.width_px, self.height_px = here
        self.optics = self.optics or frame.optics
        if self.optics and frame.optics and (change := self.optics.change_to(frame.optics)):
            raise CalibrationError(f"{picture}: {change}; calibrate from pictures of one setting")
        return self._board.find(picture, frame.image)

    def calibrate(self, views: Sequence[BoardView]) -> BoardCalibration:
        """Return the camera model that some of the views give; see `calibrate_board`."""
        return calibrate_board(views, self.width_px, self.height_px, date=today(), optics=self.optics)


def find_boards(
    paths: Sequence[Path], board: Board, watched: Callable[[Sequence[Path]], Iterable[Path]] = iter
) -> BoardViews:
    """Look for a board in pictures.

    Args:
        watched: Goes through the pictures, such as to show how many are done.

    Raises:
        PictureError: A picture cannot be read.
        CalibrationError: The pictures differ in resolution, or in how the camera was set.
    """
    found = BoardViews(board)
    for path in watched(paths):
        view = found.find(str(path), open_picture(path))
        if isinstance(view, BoardView):
            found.views.append(view)
        else:
            found.missed.append((str(path), view))
    return found


# After this many views it ends: more add nothing, and each makes the fit slower.
VIEWS_MAX = 40

# Enough is a focal length that is known to 1 %, from corners in half of the picture.
GOOD_FOCAL_SHARE = 0.01
GOOD_COVERAGE = 0.5

# From frame to frame the corners may move by this share of the picture's width: 1.3 of 640 pixels. Faster, pictures
# blur, and sensors that are read row by row bend the board.
STEADY_SHARE = 0.002

# A view is new if the board is elsewhere than in every other, by this share of the picture's width, or looks other,
# by this share of its size: its corners have moved about their middle, since it was tilted, turned or brought nearer.
NEW_PLACE_SHARE = 0.1
NEW_SHAPE_SHARE = 0.08


class BoardSession(BoardViews):
    """Takes the views that are worth taking, and says what is still missing.

    Args:
        must_be_steady: Whether a view counts only if the board was in the same place in the frame before.

    Attributes:
        seen: The board in the frame before; None where it was not found.
        calibration: What the views give so far; None while they are too few, or do not fix the camera.
    """

    def __init__(self, board: Board, *, must_be_steady: bool) -> None:
        super().__init__(board)
        self._must_be_steady = must_be_steady
        self.seen: BoardView | None = None
        self.calibration: BoardCalibration | None = None

    def look(self, frame: Frame) -> str:
        """Look at a frame, and take it if it is a good new view.

        Returns:
            Why it was not taken; empty if it was.

        Raises:
            CalibrationError: As `find`.
        """
        found = self.find(frame.source or f"view {len(self.views) + 1}", frame)
        if isinstance(found, str):
            self.seen = None
            return found
        before, self.seen = self.seen, found
        why_not = self._unsteady(found, before) or self._too_similar(found)
        if not why_not:
            self.views.append(found)
            self.calibration = None
            with suppress(CalibrationError):  # not yet: further views, or boards that are tilted, will fix it
                self.calibration = self.calibrate(self.views)
        return why_not

    def missing(self) -> tuple[str, ...]:
        """List what further views should bring, in words; nothing if the views are enough."""
        if not self.views:
            return ("views of the board",)
        share, uncovered = coverage(self.views, self.width_px, self.height_px)
        more = VIEWS_ENOUGH - len(self.views)
        focal = math.inf if self.calibration is None else self.calibration.camera_model.focal_relative_sigma
        needed = (
            ("the board in the " + ", ".join(uncovered), bool(uncovered)),
            (f"the board in more of the picture than {share:.0%}", not uncovered and share < GOOD_COVERAGE),
            ("tilts by 30 to 45 degrees, to all sides", focal > GOOD_FOCAL_SHARE),
            (f"{more} more view{'s' if more > 1 else ''}", more > 0),
        )
        return tuple(words for words, is_missing in needed if is_missing)

    @property
    def is_done(self) -> bool:
        """True if the views are enough, or their number is such that more add nothing."""
        return len(self.views) >= VIEWS_MAX or not self.missing()

    def _unsteady(self, found: BoardView, before: BoardView | None) -> str:
        if not self._must_be_steady:
            return ""
        if before is None:
            return "hold it still"
        moved_px, limit_px = apart_px(found, before), STEADY_SHARE * self.width_px
        if moved_px <= limit_px:
            return ""
        return f"hold it still: it moves by {moved_px:.1f} px from frame to frame, limit {limit_px:.1f} px"

    def _too_similar(self, found: BoardView) -> str:
        like = next((view.picture for view in self.views if _is_like(found, view, self.width_px)), "")
        return f"much like {like}; move it further, or tilt it more" if like else ""


def _is_like(view: BoardView, other: BoardView, width_px: int) -> bool:
    here, there = in_common(view, other)
    if not len(here):
        return False
    moved = here.mean(axis=0) - there.mean(axis=0)
    spread = there - there.mean(axis=0)
    changed = (here - here.mean(axis=0)) - spread
    shape_share = math.sqrt(float(np.sum(changed**2)) / max(float(np.sum(spread**2)), 1e-12))
    return math.hypot(*moved) < NEW_PLACE_SHARE * width_px and shape_share < NEW_SHAPE_SHARE


Grey = NDArray[Any]
Corners = NDArray[np.float64]

# Half the window around a corner, as shares of the distance to the nearest other corner.
WINDOW_SHARES = (0.3, 0.4, 0.45)

WINDOW_MIN_PX, WINDOW_MAX_PX = 2, 30

# Corners that scatter by more than this are compared with those of ``findChessboardCornersSB``.
ROUGH_PX = 0.15

# Their errors are alike for neighbours, so larger than they scatter by this factor: measured on rendered boards.
SECTOR_DOUBT = 3.0

_REFINED = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-4)


def refine_corners(grey: Grey, rough: Grey, columns: int, rows: int) -> Corners:
    """Return the corners that scatter least, shape (rows * columns, 2), from roughly placed ones in order of rows."""
    grid = rough.reshape(rows, columns, 2)
    spacing_px = _smallest_spacing_px(grid)
    tried = [_in_window(grey, grid, share * spacing_px) for share in WINDOW_SHARES]
    scatters_px = [scatter_px(each) for each in tried]
    best = int(np.argmin(scatters_px))
    if scatters_px[best] > ROUGH_PX:
        found, sectors = cv2.findChessboardCornersSB(grey, (columns, rows))
        if found and SECTOR_DOUBT * scatter_px(sectors.reshape(rows, columns, 2)) < scatters_px[best]:
            return np.asarray(sectors, np.float64).reshape(-1, 2)
    return tried[best].reshape(-1, 2)


def scatter_px(grid: NDArray[Any]) -> float:
    """Return by how much corners scatter about smooth curves, along each axis; 0 for a grid of less than four.

    Args:
        grid: Corners in the picture, shape (rows, columns, 2).
    """
    differences = [np.diff(grid, 3, axis=axis).ravel() for axis in (0, 1) if grid.shape[axis] > 3]
    return float(np.sqrt(np.mean(np.concatenate(differences) ** 2) / 20)) if differences else 0.0


def _in_window(grey: Grey, grid: NDArray[Any], half_px: float) -> Corners:
    window = int(np.clip(half_px, WINDOW_MIN_PX, WINDOW_MAX_PX))
    start = grid.reshape(-1, 1, 2).astype(np.float32)
    found = cv2.cornerSubPix(grey, start, (window, window), (-1, -1), _REFINED)
    return np.asarray(found, np.float64).reshape(grid.shape)


def _smallest_spacing_px(grid: NDArray[Any]) -> float:
    steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2) for axis in (0, 1)]
    return float(min(step.min() for step in steps))
