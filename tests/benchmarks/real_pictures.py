"""Real pictures with known distances, boards and tags, for the report."""

from __future__ import annotations

import csv
import math
import re
from pathlib import Path

import ball_video
import numpy as np
import ours
from part import Part, table

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.measurement import Measurement
from stadimeter.errors import CalibrationError
from stadimeter.ranging.board_calibration import BoardView, calibrate_board
from stadimeter.ranging.calibration import KnownDistance, calibrate
from stadimeter.workbench.calibration.board_session import Chessboard
from stadimeter.workbench.stereo import find_board_pairs, pair_pictures

# Calibration on real chessboards.

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


# Real tags: one picture with known poses, and one tag turned to all sides at the same distance.

VISP_SIDE_M, VISP_FOCAL_PX, VISP_CENTRE_PX = 0.053, 615.17, (312.19, 243.44)
DUCKIE_SIDE_M, DUCKIE_FOCAL_PX, DUCKIE_CENTRE_PX = 0.065, (329.873, 332.946), (528.0, 396.0)


def visp(folder: Path) -> Part:
    """Measure twelve tags in one picture, beside poses that ViSP computed.

    Args:
        folder: Where the picture is.

    Returns:
        A part of the report.
    """
    title = "Twelve AprilTags (ViSP)"
    frame = ours.read(folder / "AprilTag.png")
    camera = _camera(frame.width_px, frame.height_px, (VISP_FOCAL_PX, VISP_FOCAL_PX), VISP_CENTRE_PX)
    rows, errors = [], []
    for number, known_m in _known_ranges_m(folder / "ground_truth_pose.txt").items():
        finder = ours.detector("tag", camera, side=f"{VISP_SIDE_M} m", id=number)
        measured = ours.measure(finder, frame.image)
        if measured.distance_m is None:
            rows.append((str(number), f"{known_m:.4f}", "–", measured.reason))
            continue
        errors.append(measured.distance_m / known_m - 1)
        sigma = f"± {measured.sigma_m:.4f}"
        rows.append((str(number), f"{known_m:.4f}", f"{measured.distance_m:.4f} {sigma}", f"{100 * errors[-1]:+.2f}"))
    facts = {"real visp found": float(len(errors))}
    if errors:
        facts["real visp median"] = float(np.median(np.abs(errors)))
    return Part(title=title, text=table(("tag", "reference m", "measured m", "error %"), rows), facts=facts)


def duckietown(folder: Path) -> Part:
    """Measure one tag that is turned to the left and to the right; its distance is always the same.

    Args:
        folder: Where the pictures are.

    Returns:
        A part of the report.
    """
    title = "One AprilTag, turned (Duckietown)"
    rows, ranges = [], []
    for path in sorted(folder.glob("*.png"), key=_angle_deg):
        frame = ours.read(path)
        camera = _camera(frame.width_px, frame.height_px, DUCKIE_FOCAL_PX, DUCKIE_CENTRE_PX)
        measured = ours.measure(ours.detector("tag", camera, side=f"{DUCKIE_SIDE_M} m"), frame.image)
        if measured.distance_m is None:
            rows.append((f"{_angle_deg(path)}°", measured.reason))
        else:
            ranges.append(measured.distance_m)
            rows.append((f"{_angle_deg(path)}°", f"{measured.distance_m:.4f} ± {measured.sigma_m:.4f}"))
    missed = len(rows) - len(ranges)
    spread = max(abs(each / float(np.mean(ranges)) - 1) for each in ranges) if ranges and not missed else float("inf")
    text = table(("turned by", "measured m"), rows)
    return Part(title=title, text=text, facts={"real duckietown spread": spread})


def _camera(
    width_px: int, height_px: int, focal_px: tuple[float, float], centre_px: tuple[float, float]
) -> CameraModel:
    return CameraModel(
        width_px=width_px,
        height_px=height_px,
        fx_px=focal_px[0],
        fy_px=focal_px[1],
        cx_px=centre_px[0],
        cy_px=centre_px[1],
    )


def _known_ranges_m(path: Path) -> dict[int, float]:
    """Return the range of each tag by its number: a line with its name, then one with its pose, position first."""
    lines = [line for line in path.read_text().splitlines() if line.strip()]
    numbers = [int(re.search(r"_(\d+)$", line)[1]) for line in lines[::2]]
    positions = [np.array(line.split()[:3], float) for line in lines[1::2]]
    return {number: float(np.linalg.norm(position)) for number, position in zip(numbers, positions, strict=True)}


def _angle_deg(path: Path) -> int:
    return int(path.stem.rsplit("_", 1)[1])


# Real pictures at known distances, where they are on the machine: they are no part of the repository.

PICTURES = Path(__file__).resolve().parents[3] / "shared" / "data"
INCH_M = 0.0254
TAPE_M = INCH_M
LETTER = {"width": "11 in", "height": "8.5 in"}
SIGMAS_OF_95 = 1.96
TENNIS_FOCAL_PX, TENNIS_CENTRE_PX = (1449.03, 1449.08), (768.12, 1028.81)
CUT_OFF = {"44.5_30.jpg"}
"""Where the ball is cut off by the border of the picture."""

TENNIS_DISTORTION = (0.205489723, -0.67305901, 0.000336320714, 0.000149915927, 0.666189722)


def run(folder: Path = PICTURES) -> Part:
    """Measure all that is there.

    Args:
        folder: Where the pictures are.

    Returns:
        The part of the report; it says so if there are none.
    """
    if not folder.is_dir():
        return Part(title="Real pictures", text="The real pictures are not on the machine that made this report.\n")
    parts = [
        _sheet(folder / "seed_sheet"),
        _tennis(folder / "tennis_ball"),
        ball_video.ball_video(folder / "ball_video"),
        chessboards(folder / "chessboard"),
        visp(folder / "tags" / "visp"),
        duckietown(folder / "tags" / "duckietown"),
    ]
    text = "".join(f"### {part.title}\n\n{part.text}\n" for part in parts)
    facts = {name: value for part in parts for name, value in part.facts.items()}
    return Part(title="Real pictures", text=text, facts=facts)


def _sheet(folder: Path) -> Part:
    """Calibrate on the picture at 2 ft, measure those at 3 and 4 ft."""
    title = "Sheet of letter paper, taped to ±1 in"
    try:
        camera = _calibrated_on(folder / "2ft.png", 24 * INCH_M)
    except CalibrationError as error:
        failed = {"real sheet worst": math.inf, "real sheet inside": 0.0}
        return Part(title=title, text=f"2ft.png cannot be calibrated on: {error}\n", facts=failed)
    finder = ours.detector("sheet", camera, **LETTER)
    rows, errors, inside = [], [], []
    for path in sorted(folder.glob("[34]ft.*")) + sorted(folder.glob("original/[34]ft.*")):
        known_m = 12 * int(path.stem[0]) * INCH_M
        frame = ours.read(path)
        measured = finder.measure(frame)
        error, is_inside, cells = _judged(measured, known_m)
        errors.append(error)
        inside.append(is_inside)
        rows.append((str(path.relative_to(folder)), *cells))
    text = f"Calibrated on 2ft.png: f = {camera.fx_px:.1f} px.\n\n" + table(("picture", "measured", "error %"), rows)
    facts = {"real sheet worst": max(errors), "real sheet inside": sum(inside) / len(inside)}
    return Part(title=title, text=text, facts=facts)


def _calibrated_on(path: Path, depth_m: float) -> CameraModel:
    finder = ours.detector("sheet", None, **LETTER)
    frame = ours.read(path)
    known = KnownDistance(
        picture=path.name,
        width_px=frame.width_px,
        height_px=frame.height_px,
        detection=finder.detect(frame),
        size=finder.target_shape,
        depth_m=depth_m,
    )
    return calibrate([known], date="").camera_model


def _judged(measured: Measurement, known_m: float) -> tuple[float, bool, tuple[str, str]]:
    """Return the size of the error, whether the interval and the tape's own error hold it, and cells of a table."""
    if measured.distance_m is None or measured.sigma_m is None:
        return math.inf, False, (measured.reason, "–")
    error = measured.distance_m / known_m - 1
    is_inside = abs(measured.distance_m - known_m) <= SIGMAS_OF_95 * measured.sigma_m + TAPE_M
    inches, sigma = measured.distance_m / INCH_M, measured.sigma_m / INCH_M
    return abs(error), is_inside, (f"{inches:.2f} ± {sigma:.2f} in", f"{100 * error:+.2f}")


def _tennis(folder: Path) -> Part:
    """Measure the tennis ball with the intrinsics that came with it."""
    camera = CameraModel(
        width_px=1530,
        height_px=2040,
        fx_px=TENNIS_FOCAL_PX[0],
        fy_px=TENNIS_FOCAL_PX[1],
        cx_px=TENNIS_CENTRE_PX[0],
        cy_px=TENNIS_CENTRE_PX[1],
        distortion=TENNIS_DISTORTION,
    )
    finder = ours.detector("ball", camera, diameter="6.4 cm")
    with (folder / "truth.csv").open() as file:
        truths = list(csv.DictReader(file))
    errors, refused, rows = [], [], []
    for truth in truths:
        frame = ours.read(next(folder.glob(f"images/{truth['file']}")))
        detection = finder.detect(frame)
        measured = finder.measure(frame)
        depth_m = float(truth["ball_centre_depth_m"])
        if measured.depth_m is None:
            refused.append((truth["file"], measured.reason or detection.reason))
        else:
            errors.append(measured.depth_m / depth_m - 1)
            within = abs(measured.depth_m - depth_m) <= SIGMAS_OF_95 * measured.sigma_m
            sigma = f"{100 * measured.sigma_m / measured.distance_m:.2f}"
            rows.append((truth["file"], f"{depth_m:.3f}", f"{100 * errors[-1]:+.2f}", sigma, "yes" if within else "no"))
    sizes = np.abs(errors) if errors else np.array([math.inf])
    signed = float(np.median(errors)) if errors else math.nan
    text = (
        f"{len(truths)} pictures, {len(errors)} measured: median |error| of the depth {100 * np.median(sizes):.2f} %, "
        f"90th percentile {100 * np.quantile(sizes, 0.9):.2f} %, signed median {100 * signed:+.2f} %. "
        f"Refused: {'; '.join(f'{name} ({reason})' for name, reason in refused) or 'none'}.\n\n"
        + table(("picture", "depth m", "error %", "σ %", "inside 95 %"), rows)
    )
    facts = {
        "real ball median": float(np.median(sizes)),
        "real ball p90": float(np.quantile(sizes, 0.9)),
        "real ball held": sum(row[-1] == "yes" for row in rows) / max(1, len(rows)),
        "real ball measured": len(errors) / (len(truths) - len(CUT_OFF)),
        "real ball cut off": len(CUT_OFF & {name for name, _ in refused}) / len(CUT_OFF),
    }
    return Part(title="Tennis ball, given intrinsics", text=text, facts=facts)
