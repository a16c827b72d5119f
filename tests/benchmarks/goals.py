"""What was to be reached, and what was: real pictures first, then rendered ones, then time."""

from __future__ import annotations

import math

from goal import Facts, Goal, at_least, at_most, percent, plain, times
from part import row, table

HEIGHTS = (480, 720, 1080)
HELD = (0.90, 0.99)
"""Of the true distances of each row, the 95 % interval is to hold at least and at most this share."""
ENDS = ("least", "most")
UNKNOWN = ("ball", "disc", "sheet", "tag")
"""The kinds of things whose size is learnt."""
IN_WATER = ("ball", "sheet", "tag")

REAL = (
    at_most(
        "real: tennis ball, given intrinsics: median / 90th percentile",
        "≤ 0.8 % / 1.7 %",
        percent,
        {"real ball median": 0.008, "real ball p90": 0.017},
    ),
    at_least("real: tennis ball, measured of those that are whole", "all", percent, {"real ball measured": 1.0}),
    at_least("real: tennis ball, refused where the border cuts it off", "all", percent, {"real ball cut off": 1.0}),
    Goal("real: tennis ball, 95 % interval holds", "90–99 %", percent, {"real ball held": HELD}),
    at_least("real: video of a striped ball: frames tracked, of 1004", "≥ 850", plain(0), {"real video tracked": 850}),
    Goal(
        "real: video of a striped ball: 68 % quantile of error / stated noise",
        "0.8–1.3",
        plain(2),
        {"real video quantile": (0.8, 1.3)},
    ),
    at_most("real: sheet, calibrated on 2 ft, worst of 3 and 4 ft", "≤ 3 %", percent, {"real sheet worst": 0.03}),
    at_least(
        "real: sheet, inside the stated interval with the tape's ±1 in", "all", percent, {"real sheet inside": 1.0}
    ),
    at_most(
        "real: chessboards left and right, RMS",
        "≤ 0.20 / 0.21 px",
        plain(3, "px"),
        {"real left rms": 0.20, "real right rms": 0.21},
    ),
    at_most(
        "real: chessboards left and right, f against 532.8 and 537.4",
        "within 0.5 %",
        percent,
        {"real left focal": 0.005, "real right focal": 0.005},
    ),
    at_most("real: chessboards, both cameras together, RMS", "≤ 0.30 px", plain(3, "px"), {"real stereo rms": 0.30}),
    at_least("real: `tags/visp` found of 12", "12", plain(0), {"real visp found": 12}),
    at_most("real: `tags/visp` median error of the range", "≤ 0.5 %", percent, {"real visp median": 0.005}),
    at_most(
        "real: `tags/duckietown`, largest deviation of the range from its mean",
        "≤ 2 %",
        percent,
        {"real duckietown spread": 0.02},
    ),
)

HARD = (
    at_most(
        "hard world: ball > 20 px: median / p95",
        "≤ 0.5 % / 2 %",
        percent,
        {"hard ball large median": 0.005, "hard ball large p95": 0.02},
    ),
    at_least("hard world: ball > 20 px: found", "≥ 97 %", percent, {"hard ball large found": 0.97}),
    Goal("hard world: ball > 20 px: 95 % interval", "93–97 %", percent, {"hard ball large held": (0.93, 0.97)}),
    Goal(
        "hard world: 95 % interval of the ball, least and most of all rows: > 20 px / 5–10 px / single troubles",
        "90–99 % each",
        percent,
        {
            f"hard ball {name} held {end}": HELD
            for name in ("large", "small", "conditions")
            for end in ("least", "most")
        },
    ),
    at_most(
        "ball: another thing measured: 12 dots of its colour / small, blurred, expected",
        "≤ 1 % / 2 %",
        percent,
        {"hard ball dots gross": 0.01, "hard ball blurred gross": 0.02},
    ),
    at_least(
        "hard world: silver ball, its colour not given: found", "≥ 87.5 %", percent, {"hard ball silver found": 0.875}
    ),
    at_most(
        "hard world: silver ball, its colour not given: median / off by more than 10 %",
        "≤ 3 % / 1 %",
        percent,
        {"hard ball silver median": 0.03, "hard ball silver gross": 0.01},
    ),
    at_most(
        "clutter / rooms taken for a ball whose colour is not given",
        "≤ 1 in 300 each",
        percent,
        {f"alarms stadimeter ball of any colour {where}": 1 / 300 for where in ("clutter", "room")},
    ),
    at_least(
        "hard world: lit strips, plain or by one known side / small ones / squares cut by hand / their board: found",
        "≥ 90 / 70 / 80 / 80 %",
        percent,
        {
            "hard flat taped strips found": 0.9,
            "hard flat taped strips, known side found": 0.9,
            "hard flat taped small strips, known side found": 0.7,
            "hard flat taped squares, colour found": 0.8,
            "hard flat taped board found": 0.8,
        },
    ),
    at_most(
        "hard world: off by more than 10 %: lit strips / by one known side / sheets, squares and strips cut roughly",
        "0",
        percent,
        {
            "hard flat taped strips gross": 0.0,
            "hard flat taped strips, known side gross": 0.0,
            "hard flat rough all gross": 0.0,
        },
    ),
    at_least(
        "hard world: card and tape cut by hand, ±1 mm, 15–60 px: found",
        "≥ 90 % each",
        percent,
        {"hard flat cut card ±1 mm found": 0.9, "hard flat cut tape ±1 mm found": 0.9},
    ),
    at_most(
        "person of 1.72 ± 0.07 m by boxes ± 3 %, seen / followed: median",
        "≤ 5 % each",
        percent,
        {f"object YOLOX, boxes ± 3 %{how} median": 0.05 for how in ("", ", followed for 0.4 s")},
    ),
    Goal(
        "person of 1.72 ± 0.07 m by boxes ± 3 %, seen / followed: 95 % interval",
        "90–99 % each",
        percent,
        {f"object YOLOX, boxes ± 3 %{how} held": HELD for how in ("", ", followed for 0.4 s")},
    ),
    at_most(
        "hard world: card and tape cut by hand, ±1 mm, 15–60 px: median",
        "≤ 1 % each",
        percent,
        {"hard flat cut card ±1 mm median": 0.01, "hard flat cut tape ±1 mm median": 0.01},
    ),
    Goal(
        "hard world: 95 % interval, least and most of all rows: cut sheets / flat things in single troubles",
        "90–99 % each",
        percent,
        {f"hard flat {name} held {end}": HELD for name in ("cut", "grid") for end in ENDS},
    ),
    at_most(
        "rooms without a target: sheet / card / disc / ball / magenta ball seen",
        "≤ 1 % of rooms each",
        percent,
        {f"hard rooms {name}": 0.01 for name in ("sheet", "card ±1 mm, from 8 px", "disc", "ball", "ball, magenta")},
    ),
    at_most(
        "rooms without a target: a sheet said to be cut off by the border",
        "0",
        percent,
        {"hard rooms sheet cut off": 0.0},
    ),
    at_most(
        "disc in clutter and in rooms: another thing measured, and not said to be ambiguous",
        "≤ 3 %",
        percent,
        {"hard flat disc elsewhere": 0.03},
    ),
)

PLAIN = (
    at_most(
        "ball error, radius > 20 px, median: clean / JPEG 80 / 40 % hidden / 10 px blur",
        "≤ 0.15 / 0.25 / 0.2 / 0.5 %",
        percent,
        {
            "ball clean large": 0.0015,
            "ball jpeg 80 large": 0.0025,
            "ball hidden 40 % large": 0.002,
            "ball blur 10 large": 0.005,
        },
    ),
    at_most("ball error, radius 5–10 px, clean, median", "≤ 1.5 %", percent, {"ball small": 0.015}),
    at_most("empty clutter taken for a ball", "≤ 0.5 % of frames", percent, {"alarms stadimeter ball clutter": 0.005}),
    at_most(
        "empty clutter of the ball's hue taken for a ball",
        "≤ 2 % of frames",
        percent,
        {"alarms stadimeter ball clutter of the ball's colour": 0.02},
    ),
    at_least(
        "ball found at 40 % hidden (with an error below 30 %)", "≥ 85 %", percent, {"ball hidden 40 % found": 0.85}
    ),
    at_most(
        "sheet, tilt 0–60°, plain: median / p95",
        "≤ 0.15 % / 0.4 %",
        percent,
        {"sheet plain median": 0.0015, "sheet plain p95": 0.004},
    ),
    at_least("sheet, tilt 0–60°, clutter: found", "≥ 95 %", percent, {"sheet clutter found": 0.95}),
    at_most("sheet, tilt 0–60°, clutter: gross (> 5 %)", "≤ 1 %", percent, {"sheet clutter gross": 0.01}),
    at_most("empty clutter taken for a sheet", "≤ 1 % of frames", percent, {"alarms stadimeter sheet clutter": 0.01}),
    at_most("tag of 48 / 100 px, median", "≤ 0.3 / 0.15 %", percent, {"tag 48 px": 0.003, "tag 100 px": 0.0015}),
    at_most(
        "unknown size, learnt over 0.5 m from 2 m away: ball / disc / sheet / tag, median",
        "≤ 3 % each",
        percent,
        {f"unknown size {kind}": 0.03 for kind in UNKNOWN},
    ),
    Goal(
        "unknown size, learnt over 0.5 m from 2 m away: ball / disc / sheet / tag, 95 % interval",
        "90–99 % each",
        percent,
        {f"unknown size {kind} held": HELD for kind in UNKNOWN},
    ),
)

WAYS = (
    *(
        goal
        for what, part, rows in (
            ("picture of 60 / 120 / 300 px, tilt 0–50°", "picture", ("60 px", "120 px", "300 px")),
            ("three circles 60 / 100 / 200 px apart, tilt 0–50°", "circles", ("60 px", "100 px", "200 px")),
        )
        for goal in (
            at_most(f"{what}: median", "≤ 0.5 % each", percent, {f"{part} {row} median": 0.005 for row in rows}),
            at_least(f"{what}: found", "≥ 95 % each", percent, {f"{part} {row} found": 0.95 for row in rows}),
            Goal(f"{what}: 95 % interval", "90–99 % each", percent, {f"{part} {row} held": HELD for row in rows}),
        )
    ),
    Goal(
        "under water, described as in air: ball / sheet / tag, bias",
        "within 0.5 % each",
        percent,
        {f"water {target} bias": (-0.005, 0.005) for target in IN_WATER},
    ),
    Goal(
        "under water: ball / sheet / tag, 95 % interval",
        "90–99 % each",
        percent,
        {f"water {target} held": HELD for target in IN_WATER},
    ),
)

STEREO = (
    at_most(
        "two cameras 12 cm apart, 0.5–3 m, without the size, median: ball / sheet / tag",
        "≤ 1 % each",
        percent,
        {f"stereo {target} together median": 0.01 for target in ("ball", "sheet", "tag")},
    ),
    Goal(
        "two cameras, 95 % interval, ball, sheet and tag: without the size / joined with it",
        "90–99 % each",
        percent,
        {f"stereo {target} {way} held": HELD for way in ("together", "joined") for target in ("ball", "sheet", "tag")},
    ),
)


def _faster(what: str, contender: str, state: str, limits: tuple[float, ...]) -> Goal:
    """Return the goal of a speed against the tutorial at the three sizes."""
    end = "" if state == "hot" else f" {state}"
    return at_least(
        f"{what}, against the tutorial at 640 / 720 / 1080, {state}",
        f"≥ {' / '.join(f'{limit:g}' for limit in limits)} ×",
        times,
        {f"{contender} {height} speed-up{end}": limit for height, limit in zip(HEIGHTS, limits, strict=True)},
    )


TIME = (
    at_least(
        "ball at 640, its colour not given, against the search by colour: with a ball / without",
        "≥ 0.33 × each",
        plain(2, "×"),
        {f"ball of any colour stadimeter{name} 480 speed-up": 1 / 3 for name in ("", ", no ball there")},
    ),
    _faster("ball, detected and measured", "ball stadimeter", "hot", (12, 13, 15)),
    _faster("ball, detected and measured", "ball stadimeter", "cold", (10, 12, 12)),
    _faster("ball, tracked and measured", "ball stadimeter, tracking", "hot", (22, 27, 40)),
    _faster("ball, tracked and measured", "ball stadimeter, tracking", "cold", (18, 23, 28)),
    at_least(
        "ball at 640, mean over scenes of the least time, against the tutorial's: detected / tracked",
        "≥ 10 / 10 ×",
        times,
        {"ball stadimeter mean speed-up": 10, "ball stadimeter, tracking mean speed-up": 10},
    ),
    at_most(
        "ball, full detection, against HSV + `inRange` alone at 720 and 1080",
        "≤ 0.35",
        plain(2),
        {f"ball stadimeter {height} of inRange": 0.35 for height in HEIGHTS[1:]},
    ),
    at_least(
        "sheet before a plain wall at 640, against the tutorial: detected / tracked, hot",
        "≥ 0.5 / 2.5 ×",
        plain(2, "×"),
        {"plain sheet stadimeter 480 speed-up": 0.5, "plain sheet stadimeter, tracking 480 speed-up": 2.5},
    ),
    at_least(
        "tag at 640, tracking: search alone / with sides and pose / full frame, against `cv2.aruco` defaults",
        "≥ 30 × / ≥ 15 × / ≥ 4 ×",
        times,
        {
            "tag stadimeter, tracking: search alone 480 speed-up": 30,
            "tag stadimeter, tracking: search, sides and pose 480 speed-up": 15,
            "tag stadimeter 480 speed-up": 4,
        },
    ),
    at_most("everything but vision, 100 rules, journal on, a cycle", "≤ 100 µs", plain(0, "µs"), {"machinery us": 100}),
    at_most(
        "start-up against bare `import cv2`: `--help` / `measure` / `run`",
        "≤ 1.7 × each",
        plain(2, "×"),
        {f"start-up {command}": 1.7 for command in ("help", "measure", "run")},
    ),
)

FLOOR = (
    at_most("on the floor, 0.5–4 m, by the floor alone: median, worst cell", "≤ 2 %", percent, {"floor median": 0.02}),
    at_most(
        "on the floor, size and floor together: median against that of the better one, worst cell",
        "≤ 1.1",
        plain(2),
        {"floor both against better": 1.1},
    ),
    Goal(
        "on the floor: 95 % interval, least and most of all cells",
        "90–99 %",
        percent,
        {f"floor held {end}": HELD for end in ENDS},
    ),
)

GOALS = (*REAL, *HARD, *FLOOR, *PLAIN, *WAYS, *STEREO, *TIME)
WITH_COVERAGE = {f"{part} coverage" for part in ("ball", "sheet", "disc", "tag")}
"""Of every part whose intervals the last two lines tell of, a figure that it has."""


def goals_table(facts: Facts) -> str:
    """Return the table of goals, with how often the intervals hold at the end."""
    rows = [goal.line(facts) for goal in GOALS] + [_overall(facts), _by_trouble(facts)]
    return table(("what", "to reach", "reached", "met"), rows)


def with_new_goals(table_before: str, facts: Facts) -> str:
    """Return a table of goals with new lines for those whose every figure is measured; the others stay as they were.

    The last two are new if every part that they are of was measured.
    """
    kept = table_before.rstrip("\n")
    before = {line.removeprefix("| ").partition(" | ")[0]: line for line in kept.split("\n")}
    lines = kept.split("\n")[:4]  # the heading, and the head of the table
    for goal in GOALS:
        is_new = goal.limits.keys() <= facts.keys() or goal.what not in before
        lines.append(row(goal.line(facts)) if is_new else before[goal.what])
    for line in (_overall(facts), _by_trouble(facts)):
        lines.append(row(line) if facts.keys() >= WITH_COVERAGE or line[0] not in before else before[line[0]])
    return "\n".join(lines) + table_before[len(kept) :]


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
