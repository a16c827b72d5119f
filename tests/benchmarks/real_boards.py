"""Calibration on real chessboards."""

from __future__ import annotations

from pathlib import Path

import ours
from part import Part, table

from stadimeter.ranging.board_calibration import BoardView, calibrate_board
from stadimeter.workbench.calibration.board_session import Chessboard
from stadimeter.workbench.stereo import find_board_pairs, pair_pictures

BOARD = Chessboard(columns=9, rows=6, square_m=0.025)
SQUARE_SHARE = 0.002
FOCAL_PX = {"left": 532.8, "right": 537.4}
"""What careful corners give, at RMS 0.195 and 0.207 px."""


def chessboards(folder: Path) -> Part:
    """Calibrate each of two cameras on its pictures of a chessboard.

    Args:
        folder: Where the pictures are.

    Returns:
        A part of the report.
    """
    rows, facts = [], {}
    for side, known_px in FOCAL_PX.items():
        frames = {path.name: ours.read(path) for path in sorted(folder.glob(f"{side}*.jpg"))}
        seen = [BOARD.find(name, frame.image) for name, frame in frames.items()]
        views = [view for view in seen if isinstance(view, BoardView)]
        first = next(iter(frames.values()))
        made = calibrate_board(views, first.width_px, first.height_px, date="")
        focal_px = made.camera_model.fx_px
        facts |= {f"real {side} rms": made.rms_px, f"real {side} focal": abs(focal_px / known_px - 1)}
        left_out = ", ".join(view.picture for view in made.views if view.was_left_out) or "none"
        sigma_px = focal_px * made.camera_model.focal_relative_sigma
        focal = f"{focal_px:.2f} ± {sigma_px:.2f}"
        rows.append((side, f"{len(views)} of {len(frames)}", left_out, f"{made.rms_px:.3f}", focal, f"{known_px}"))
    pairs = pair_pictures(sorted(folder.glob("*[0-9].jpg")))
    both = find_board_pairs(pairs, BOARD).calibrate(SQUARE_SHARE)
    facts["real stereo rms"] = both.rms_px
    used = sum(not each.why_left_out for each in both.pairs)
    text = (
        f"\nBoth together: {used} of {len(pairs)} pairs, RMS {both.rms_px:.3f} px, epipolar {both.epipolar_px:.3f} px, "
        f"{1000 * both.rig.baseline_m:.2f} mm ± {1000 * both.rig.baseline_sigma_m:.2f} apart.\n"
    )
    head = ("camera", "boards found", "left out", "RMS px", "f px", "known f px")
    return Part(title="Chessboards", text=table(head, rows) + text, facts=facts)
