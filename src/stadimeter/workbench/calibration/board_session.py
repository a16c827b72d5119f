"""Collecting views of a calibration board from a camera, while a person moves the board about."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stadimeter.app.capture import Capture, capture_for
from stadimeter.app.clock import MonotonicClock, SteppedClock
from stadimeter.cameras.protocol import Camera
from stadimeter.config.plugins import DriverChoice, DriverContext
from stadimeter.core.frame import Frame
from stadimeter.errors import CalibrationError
from stadimeter.ranging.board_calibration import (
    EDGES,
    VIEWS_MIN,
    BoardCalibration,
    BoardView,
    apart_px,
    calibrate_board,
    coverage,
    edges_away,
    in_common,
)
from stadimeter.workbench.calibration.board_corners import Board

VIEWS_ENOUGH = 10
"""So many views at least; fewer may fit by chance."""

TILTED_MIN = 2
"""Before this many views show a tilted board, nothing is calibrated."""

VIEWS_MAX = 40
"""After this many views it ends: more add nothing, and each makes the fit slower."""

GOOD_FOCAL_SHARE = 0.01
GOOD_COVERAGE = 0.5
"""Enough is a focal length that is known to 1 %, from corners in half of the picture."""

STEADY_SHARE = 0.002
"""From frame to frame the corners may move by this share of the picture's width: 1.3 of 640 pixels. Faster, pictures
blur, and sensors that are read row by row bend the board."""

NEW_PLACE_SHARE = 0.1
NEW_SHAPE_SHARE = 0.08
"""A view is new if the board is elsewhere than in every other, by this share of the picture's width, or looks other,
by this share of its size: its corners have moved about their middle, since it was tilted, turned or brought nearer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Where the frames come from.

    Attributes:
        is_live: Whether a person holds a board in front of it; of a recording every frame counts for itself.
    """

    capture: Capture
    is_live: bool


def open_source(choice: DriverChoice) -> Source:
    """Build a camera without a lens and without anything else. Touches no hardware.

    Raises:
        DriverError: It cannot be built.
    """
    clock = SteppedClock()
    camera: Camera = choice.plugin.build(choice.options, DriverContext(name=choice.name, clock=clock))
    if not camera.is_live:
        return Source(capture=capture_for(camera, clock), is_live=False)
    live_clock = MonotonicClock()
    camera = choice.plugin.build(choice.options, DriverContext(name=choice.name, clock=live_clock))
    return Source(capture=capture_for(camera, live_clock), is_live=True)


class BoardSession:
    """Takes the views that are worth taking, and says what is still missing.

    Args:
        date: ISO 8601 date of the calibration.
        must_be_steady: Whether a view counts only if the board was in the same place in the frame before.

    Attributes:
        views: The views that were taken, in order.
        width_px: The pictures' width; 0 before the first.
        calibration: What the views give so far; None while they are too few, or do not fix the camera.
    """

    def __init__(self, board: Board, *, date: str, must_be_steady: bool) -> None:
        self._board = board
        self._date = date
        self._must_be_steady = must_be_steady
        self._before: BoardView | None = None
        self._edges_away: list[frozenset[str]] = []
        self.views: list[BoardView] = []
        self.width_px = self.height_px = 0
        self.calibration: BoardCalibration | None = None

    def look(self, frame: Frame) -> str:
        """Look at a frame, and take it if it is a good new view.

        Returns:
            Why it was not taken; empty if it was.

        Raises:
            CalibrationError: It has another resolution than those before.
        """
        self._check_resolution(frame)
        name = frame.source or f"view {len(self.views) + 1}"
        found = self._board.find(name, frame.image)
        if isinstance(found, str):
            self._before = None
            return found
        before, self._before = self._before, found
        why_not = self._unsteady(found, before) or self._too_similar(found)
        if not why_not:
            self.views.append(found)
            self._edges_away.append(edges_away(found, self.width_px, self.height_px))
            self.calibration = self._calibrated()
        return why_not

    def missing(self) -> tuple[str, ...]:
        """Return what further views should bring, in words; nothing if the views are enough."""
        if not self.views:
            return ("views of the board",)
        share, uncovered = coverage(self.views, self.width_px, self.height_px)
        seen_away = frozenset[str]().union(*self._edges_away)
        edges = [edge for edge in EDGES if edge not in seen_away]
        more = VIEWS_ENOUGH - len(self.views)
        focal = math.inf if self.calibration is None else self.calibration.camera_model.focal_relative_sigma
        needed = (
            ("the board in the " + ", ".join(uncovered), bool(uncovered)),
            (f"the board in more of the picture than {share:.0%}", not uncovered and share < GOOD_COVERAGE),
            ("a tilt with the " + ", ".join(edges) + " edge away", bool(edges)),
            (f"tilts, for a focal length better than ± {focal:.1%}", not edges and focal > GOOD_FOCAL_SHARE),
            (f"{more} more view{'s' if more > 1 else ''}", more > 0),
        )
        return tuple(words for words, is_missing in needed if is_missing)

    @property
    def is_done(self) -> bool:
        """Whether the views are enough, or their number is such that more add nothing."""
        return len(self.views) >= VIEWS_MAX or not self.missing()

    def _check_resolution(self, frame: Frame) -> None:
        if not self.width_px:
            self.width_px, self.height_px = frame.width_px, frame.height_px
        if (frame.width_px, frame.height_px) != (self.width_px, self.height_px):
            raise CalibrationError(
                f"the camera gave {self.width_px}x{self.height_px} px, then {frame.width_px}x{frame.height_px}; "
                "calibrate at one resolution"
            )

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

    def _calibrated(self) -> BoardCalibration | None:
        # Boards that face the camera do not fix it, and trying takes long; so does trying without each one in turn.
        if len(self.views) < VIEWS_MIN or sum(map(bool, self._edges_away)) < TILTED_MIN:
            return None
        try:
            return calibrate_board(self.views, self.width_px, self.height_px, date=self._date)
        except CalibrationError:
            return None  # not yet: further views will fix it


def _is_like(view: BoardView, other: BoardView, width_px: int) -> bool:
    here, there = in_common(view, other)
    if not len(here):
        return False
    moved = here.mean(axis=0) - there.mean(axis=0)
    spread = there - there.mean(axis=0)
    changed = (here - here.mean(axis=0)) - spread
    shape_share = math.sqrt(float(np.sum(changed**2)) / max(float(np.sum(spread**2)), 1e-12))
    return math.hypot(*moved) < NEW_PLACE_SHARE * width_px and shape_share < NEW_SHAPE_SHARE
