"""A real video of a striped ball in a hand, against its outline in 125 frames.

The outline was fitted apart from this program, and looked at frame by frame at four times the size: circles through
the steepest change of Lab's a* (green to red) along 180 rays, reweighted. It is good to about 1.5 % of the radius;
frames in which it could not be told by eye are left out. `ball_video_outline.csv` holds its figures: frame, counted
from 0, and centre and radius in pixels.
"""

from __future__ import annotations

import csv
import tempfile
from pathlib import Path

import numpy as np
from part import Part, table

from stadimeter.app.bootstrap import build
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Loop
from stadimeter.config.loader import load_configuration
from support.simulated_run import LENS

OUTLINE = Path(__file__).parent / "ball_video_outline.csv"
DIAMETER_M, FOCAL_PX = 0.064, 600.0
"""Neither is known; distances are compared as apparent sizes. Only how oblong these are depends on the focal length."""

CONFIGURATION = """
[camera]
driver = "video"
path = "{video}"
{lens}[targets.ball]
detector = "ball"
diameter = "6.4 cm"
hsv = "29,86,6:64,255,255"
"""
WRONG_SHARE = 0.08


def ball_video(folder: Path) -> Part:
    """Track the ball through the video, as a run does, and hold each figure to the outline."""
    records = _run(folder / "green_ball.mp4")
    statuses = [record.decision.tracks[0].status.value for record in records]
    rows, errors, ratios, held = [], [], [], []
    for frame, radius_px in _outline():
        known_m = FOCAL_PX * DIAMETER_M / (2 * radius_px)
        record = records[frame]
        for measured in record.observation.measurements:
            if measured.depth_m is None or measured.noise_m is None:
                continue
            off = _circle_depth_m(measured.depth_m, measured.distance_m) / known_m - 1
            errors.append(abs(off))
            ratios.append(abs(off) / (measured.noise_m / measured.distance_m))
        track = record.decision.tracks[0]
        if track.is_valid and track.depth_m is not None:
            off = _circle_depth_m(track.depth_m, track.distance_m) / known_m - 1
            held.append(abs(off) <= 1.96 * track.sigma_m / track.distance_m)
    quantile = float(np.quantile(ratios, 0.68)) if ratios else float("nan")
    rows = [
        ("frames tracked, of 1004", str(statuses.count("tracking"))),
        ("measured, of the frames with an outline", f"{len(errors)} of {len(_outline())}"),
        ("error of the measurements: median / p95", f"{np.median(errors):.1%} / {np.quantile(errors, 0.95):.1%}"),
        (f"wrong by more than {WRONG_SHARE:.0%}", f"{np.mean(np.array(errors) > WRONG_SHARE):.1%}"),
        ("68 % quantile of error / stated noise, 1 is honest", f"{quantile:.2f}"),
        ("95 % interval of the track holds the outline's", f"{np.mean(held):.0%}"),
    ]
    facts = {
        "real video tracked": float(statuses.count("tracking")),
        "real video quantile": quantile,
        "real video wrong": float(np.mean(np.array(errors) > WRONG_SHARE)),
    }
    return Part(title="A striped ball in a hand, on video", text=table(("what", "reached"), rows), facts=facts)


def _circle_depth_m(depth_m: float, distance_m: float) -> float:
    """Return the depth at which a ball on the optical axis would look as large as the circle nearest to its outline.

    The outline is an ellipse: its smaller diameter tells the depth, and the larger one is wider by distance over depth.
    The circles of `ball_video_outline.csv` lie half way between both.
    """
    return depth_m / ((1 + distance_m / depth_m) / 2)


def _run(video: Path) -> list[CycleRecord]:
    records: list[CycleRecord] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ball.toml"
        path.write_text(CONFIGURATION.format(video=video, lens=LENS), encoding="utf-8")
        Loop(build(load_configuration(path), speed=None), listeners=[lambda record, _: records.append(record)]).run()
    return records


def _outline() -> list[tuple[int, float]]:
    with OUTLINE.open(newline="", encoding="utf-8") as file:
        return [(int(row["frame"]), float(row["radius_px"])) for row in csv.DictReader(file)]
