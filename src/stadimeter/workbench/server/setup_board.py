"""Calibrating with a board before the camera: views are taken by themselves; the page says what is missing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stadimeter.config.camera_file import save_camera_model
from stadimeter.config.units import parse_length
from stadimeter.errors import CalibrationError, ConfigError
from stadimeter.ranging.board_calibration import coverage
from stadimeter.workbench.calibration.board_session import Board, BoardSession, CharucoBoard, Chessboard
from stadimeter.workbench.server.arguments import get_number, get_text
from stadimeter.workbench.server.operations import Desk, DeskReply, operation
from stadimeter.workbench.server.setup_operations import lens_as_json, setup_of
from stadimeter.workbench.setup.lens import today
from stadimeter.workbench.setup.question import BOARD_FILE

# Corners or squares along a side of a board.
MIN_CORNERS, MAX_CORNERS = 3, 60


@operation
def board(desk: Desk, args: Mapping[str, Any]) -> DeskReply:
    """Begin with a board (``do`` is ``start``), look at the newest picture (``look``), or take the lens (``finish``).

    A board has ``columns`` and ``rows``, and ``square``, such as ``25 mm``: of a chessboard its inner corners count.
    With ``marker`` and ``dictionary`` it is a ChArUco board, whose squares count. To look takes a tenth of a second or
    two; after some ten views, a second.
    """
    if setup_of(desk).interview.next_key != "calibration":
        raise ConfigError("no calibration is asked for now")
    match get_text(args, "do", "look"):
        case "start":
            desk.kept["board"] = BoardSession(_parse_board(args), date=today(), must_be_steady=True)
            return _look(desk)
        case "look":
            return _look(desk)
        case "finish":
            return _finish(desk)
    raise ConfigError("do is one of start, look and finish")


def _parse_board(args: Mapping[str, Any]) -> Board:
    columns, rows = int(get_number(args, "columns")), int(get_number(args, "rows"))
    if not (MIN_CORNERS <= columns <= MAX_CORNERS and MIN_CORNERS <= rows <= MAX_CORNERS):
        raise ConfigError(f"a board has {MIN_CORNERS} to {MAX_CORNERS} columns and rows, not {columns} and {rows}")
    try:
        square_m = parse_length(get_text(args, "square"))
        marker_m = parse_length(get_text(args, "marker")) if "marker" in args else 0.0
    except ValueError as error:
        raise ConfigError(str(error)) from error
    if not marker_m:
        return Chessboard(columns=columns, rows=rows, square_m=square_m)
    dictionary = get_text(args, "dictionary")
    return CharucoBoard(columns=columns, rows=rows, square_m=square_m, marker_m=marker_m, dictionary=dictionary)


def _session(desk: Desk) -> BoardSession:
    session: BoardSession | None = desk.kept.get("board")
    if session is None:
        raise ConfigError("first say which board it is")
    return session


def _look(desk: Desk) -> DeskReply:
    session, frame = _session(desk), setup_of(desk).newest()
    why_not = session.look(frame)
    share, uncovered = coverage(session.views, frame.width_px, frame.height_px) if session.views else (0.0, ())
    made = session.calibration
    return DeskReply(
        data={
            "taken": not why_not,
            "words": f"{why_not[0].upper()}{why_not[1:]}." if why_not else f"View {len(session.views)} is taken.",
            "views": len(session.views),
            "missing": list(session.missing()),
            "done": session.is_done,
            "coverage": share,
            "uncovered": list(uncovered),
            "corners_px": session.seen.corners_px.tolist() if session.seen is not None else [],
            "covered_px": [view.corners_px.mean(axis=0).tolist() for view in session.views],
            "rms_px": made.rms_px if made else None,
            **lens_as_json(made.camera_model if made else None),
        }
    )


def _finish(desk: Desk) -> DeskReply:
    setup, session = setup_of(desk), _session(desk)
    if session.calibration is None:
        raise CalibrationError(f"the views do not tell the lens yet; still missing: {'; '.join(session.missing())}")
    save_camera_model(setup.known.path(BOARD_FILE), session.calibration.camera_model)
    accepted = setup.answer(BOARD_FILE, confirm=False)
    del desk.kept["board"]
    return DeskReply(data={**setup.state(), **lens_as_json(setup.known.camera_model), "notes": list(accepted.notes)})
