"""What was to be reached, and what was."""

from __future__ import annotations

import math

from flat_goals import FLAT_GOALS
from goal import Facts, Goal, percent, times
from part import table

HEIGHTS = (480, 720, 1080)

GOALS = (
    Goal(
        what="ball, full detection, against the tutorial at 640 / 720 / 1080",
        reach="≥ 10 × each",
        facts=[f"ball stadimeter {height} speed-up" for height in HEIGHTS],
        limits=(10, 10, 10),
        most=False,
        show=times,
    ),
    Goal(
        what="ball, tracking, against the tutorial",
        reach="≥ 20 × / 25 × / 45 ×",
        facts=[f"ball stadimeter, tracking {height} speed-up" for height in HEIGHTS],
        limits=(20, 25, 45),
        most=False,
        show=times,
    ),
    Goal(
        what="ball, full detection, against HSV + `inRange` alone at 720 and 1080",
        reach="≤ 0.35",
        facts=[f"ball stadimeter {height} of inRange" for height in HEIGHTS[1:]],
        limits=(0.35, 0.35),
        most=True,
        show=lambda value: f"{value:.2f}",
    ),
    Goal(
        what="ball error, radius > 20 px, median: clean / JPEG 80 / 40 % hidden / 10 px blur",
        reach="≤ 0.15 / 0.25 / 0.2 / 0.5 %",
        facts=["ball clean large", "ball jpeg 80 large", "ball hidden 40 % large", "ball blur 10 large"],
        limits=(0.0015, 0.0025, 0.002, 0.005),
        most=True,
        show=percent,
    ),
    Goal(
        what="ball error, radius 5–10 px, clean, median",
        reach="≤ 1.5 %",
        facts=["ball small"],
        limits=(0.015,),
        most=True,
        show=percent,
    ),
    Goal(
        what="empty clutter taken for a ball",
        reach="≤ 0.5 % of frames",
        facts=["alarms stadimeter ball clutter"],
        limits=(0.005,),
        most=True,
        show=percent,
    ),
    Goal(
        what="ball found at 40 % hidden (with an error below 30 %)",
        reach="≥ 85 %",
        facts=["ball hidden 40 % found"],
        limits=(0.85,),
        most=False,
        show=percent,
    ),
    Goal(
        what="sheet, tilt 0–60°, plain: median / p95",
        reach="≤ 0.15 % / 0.4 %",
        facts=["sheet plain median", "sheet plain p95"],
        limits=(0.0015, 0.004),
        most=True,
        show=percent,
    ),
    Goal(
        what="sheet, tilt 0–60°, clutter: found",
        reach="≥ 95 %",
        facts=["sheet clutter found"],
        limits=(0.95,),
        most=False,
        show=percent,
    ),
    Goal(
        what="sheet, tilt 0–60°, clutter: gross (> 5 %)",
        reach="≤ 1 %",
        facts=["sheet clutter gross"],
        limits=(0.01,),
        most=True,
        show=percent,
    ),
    Goal(
        what="empty clutter taken for a sheet",
        reach="≤ 2 % of frames",
        facts=["alarms stadimeter sheet clutter"],
        limits=(0.02,),
        most=True,
        show=percent,
    ),
    Goal(
        what="tag of 48 / 100 px, median",
        reach="≤ 0.3 / 0.15 %",
        facts=["tag 48 px", "tag 100 px"],
        limits=(0.003, 0.0015),
        most=True,
        show=percent,
    ),
    Goal(
        what="tag at 640, tracking: search alone / with sides and pose / full frame, against `cv2.aruco` defaults",
        reach="≥ 30 × / ≥ 30 × / ≥ 4 ×",
        facts=[
            "tag stadimeter, tracking: search alone 480 speed-up",
            "tag stadimeter, tracking: search, sides and pose 480 speed-up",
            "tag stadimeter 480 speed-up",
        ],
        limits=(30, 30, 4),
        most=False,
        show=times,
    ),
    Goal(
        what="everything but vision, 100 rules, journal on, a cycle",
        reach="≤ 100 µs",
        facts=["machinery us"],
        limits=(100,),
        most=True,
        show=lambda value: f"{value:.0f} µs",
    ),
    Goal(
        what="start-up against bare `import cv2`: `--help` / `measure` / `run`",
        reach="≤ 1.7 × each",
        facts=["start-up help", "start-up measure", "start-up run"],
        limits=(1.7, 1.7, 1.7),
        most=True,
        show=lambda value: f"{value:.2f} ×",
    ),
    Goal(
        what="hard world: ball > 20 px: median / p95",
        reach="≤ 0.5 % / 2 %",
        facts=["hard ball large median", "hard ball large p95"],
        limits=(0.005, 0.02),
        most=True,
        show=percent,
    ),
    Goal(
        what="hard world: ball > 20 px: found",
        reach="≥ 97 %",
        facts=["hard ball large found"],
        limits=(0.97,),
        most=False,
        show=percent,
    ),
    Goal(
        what="hard world: 95 % interval of the ball, least of all rows: > 20 px / 5–10 px / single troubles",
        reach="≥ 90 % each",
        facts=[f"hard ball {name} held least" for name in ("large", "small", "conditions")],
        limits=(0.9, 0.9, 0.9),
        most=False,
        show=percent,
    ),
    Goal(
        what="ball: another thing measured: 12 dots of its colour / small, blurred, expected",
        reach="≤ 1 % / 2 %",
        facts=["hard ball dots gross", "hard ball blurred gross"],
        limits=(0.01, 0.02),
        most=True,
        show=percent,
    ),
    *FLAT_GOALS,
    Goal(
        what="empty clutter of the ball's hue taken for a ball",
        reach="≤ 2 % of frames",
        facts=["alarms stadimeter ball clutter of the ball's colour"],
        limits=(0.02,),
        most=True,
        show=percent,
    ),
    Goal(
        what="real: video of a striped ball: frames tracked, of 1004",
        reach="≥ 850",
        facts=["real video tracked"],
        limits=(850,),
        most=False,
        show=lambda value: f"{value:.0f}",
    ),
    Goal(
        what="real: video of a striped ball: 68 % quantile of error / stated noise",
        reach="≤ 1.3 (and ≥ 0.8)",
        facts=["real video quantile"],
        limits=(1.3,),
        most=True,
        show=lambda value: f"{value:.2f}",
    ),
    Goal(
        what="real: sheet, calibrated on 2 ft, worst of 3 and 4 ft",
        reach="≤ 3 %",
        facts=["real sheet worst"],
        limits=(0.03,),
        most=True,
        show=percent,
    ),
    Goal(
        what="real: sheet, inside the stated interval with the tape's ±1 in",
        reach="all",
        facts=["real sheet inside"],
        limits=(1.0,),
        most=False,
        show=percent,
    ),
    Goal(
        what="real: tennis ball, given intrinsics: median / 90th percentile",
        reach="≤ 0.8 % / 1.7 %",
        facts=["real ball median", "real ball p90"],
        limits=(0.008, 0.017),
        most=True,
        show=percent,
    ),
    Goal(
        what="real: tennis ball, measured of those that are whole",
        reach="all",
        facts=["real ball measured"],
        limits=(1.0,),
        most=False,
        show=percent,
    ),
    Goal(
        what="real: tennis ball, refused where the border cuts it off",
        reach="all",
        facts=["real ball cut off"],
        limits=(1.0,),
        most=False,
        show=percent,
    ),
    Goal(
        what="real: chessboards left and right, RMS",
        reach="≤ 0.20 / 0.21 px",
        facts=["real left rms", "real right rms"],
        limits=(0.20, 0.21),
        most=True,
        show=lambda value: f"{value:.3f} px",
    ),
    Goal(
        what="real: chessboards left and right, f against 532.8 and 537.4",
        reach="within 0.5 %",
        facts=["real left focal", "real right focal"],
        limits=(0.005, 0.005),
        most=True,
        show=percent,
    ),
    Goal(
        what="real: `tags/visp` found of 12",
        reach="12",
        facts=["real visp found"],
        limits=(12,),
        most=False,
        show=lambda value: f"{value:.0f}",
    ),
    Goal(
        what="real: `tags/visp` median error of the range",
        reach="≤ 0.5 %",
        facts=["real visp median"],
        limits=(0.005,),
        most=True,
        show=percent,
    ),
    Goal(
        what="real: `tags/duckietown`, largest deviation of the range from its mean",
        reach="≤ 2 %",
        facts=["real duckietown spread"],
        limits=(0.02,),
        most=True,
        show=percent,
    ),
)


def goals_table(facts: Facts) -> str:
    """Return the table of goals, with how often the intervals hold at the end."""
    rows = [goal.line(facts) for goal in GOALS] + [_overall(facts), _by_trouble(facts)]
    return table(("what", "to reach", "reached", "met"), rows)


def _coverages(facts: Facts) -> dict[str, float]:
    return {name: value for name, value in facts.items() if name.endswith("coverage") and not math.isnan(value)}


def _overall(facts: Facts) -> tuple[str, str, str, str]:
    totals = {name: value for name, value in _coverages(facts).items() if len(name.split()) == 2}
    what, reach = "95 % interval holds the truth, overall", "93–97 %"
    if not totals:
        return what, reach, "not measured", "–"
    reached = ", ".join(f"{name.split()[0]} {100 * value:.1f} %" for name, value in totals.items())
    return what, reach, reached, "yes" if all(0.93 <= value <= 0.97 for value in totals.values()) else "**no**"


def _by_trouble(facts: Facts) -> tuple[str, str, str, str]:
    each = {name: value for name, value in _coverages(facts).items() if len(name.split()) > 2}
    what, reach = "95 % interval holds the truth, for each trouble", "90–99 %"
    if not each:
        return what, reach, "not measured", "–"
    outside = [name for name, value in each.items() if not 0.90 <= value <= 0.99]
    span = f"{100 * min(each.values()):.0f}–{100 * max(each.values()):.0f} %"
    detail = f"; outside: {', '.join(name.removesuffix(' coverage') for name in outside)}" if outside else ""
    return what, reach, span + detail, "**no**" if outside else "yes"
