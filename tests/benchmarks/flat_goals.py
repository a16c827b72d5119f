"""What was to be reached with flat things as they are met, and in rooms without them."""

from __future__ import annotations

from goal import Goal, percent

FLAT_GOALS = (
    Goal(
        what="hard world: card and tape cut by hand, ±1 mm, 15–60 px: found",
        reach="≥ 90 % each",
        facts=["hard flat cut card ±1 mm found", "hard flat cut tape ±1 mm found"],
        limits=(0.9, 0.9),
        most=False,
        show=percent,
    ),
    Goal(
        what="hard world: card and tape cut by hand, ±1 mm, 15–60 px: median",
        reach="≤ 1 % each",
        facts=["hard flat cut card ±1 mm median", "hard flat cut tape ±1 mm median"],
        limits=(0.01, 0.01),
        most=True,
        show=percent,
    ),
    Goal(
        what="hard world: 95 % interval of cut sheets and of flat things in single troubles, least of all rows",
        reach="≥ 90 % each",
        facts=["hard flat cut held least", "hard flat grid held least"],
        limits=(0.9, 0.9),
        most=False,
        show=percent,
    ),
    Goal(
        what="hard world: the same, most of all rows",
        reach="≤ 99 % each",
        facts=["hard flat cut held most", "hard flat grid held most"],
        limits=(0.99, 0.99),
        most=True,
        show=percent,
    ),
    Goal(
        what="rooms without a target: sheet / card / disc / ball / magenta ball seen",
        reach="≤ 1 % of rooms each",
        facts=[
            "hard rooms sheet",
            "hard rooms card ±1 mm, from 8 px",
            "hard rooms disc",
            "hard rooms ball",
            "hard rooms ball, magenta",
        ],
        limits=(0.01, 0.01, 0.01, 0.01, 0.01),
        most=True,
        show=percent,
    ),
    Goal(
        what="rooms without a target: a sheet said to be cut off by the border",
        reach="0",
        facts=["hard rooms sheet cut off"],
        limits=(0.0,),
        most=True,
        show=percent,
    ),
    Goal(
        what="sheet in clutter, tilt 0–60°: found",
        reach="≥ 95 %",
        facts=["sheet clutter found"],
        limits=(0.95,),
        most=False,
        show=percent,
    ),
    Goal(
        what="disc in clutter and in rooms: another thing measured, and not said to be ambiguous",
        reach="≤ 3 %",
        facts=["hard flat disc elsewhere"],
        limits=(0.03,),
        most=True,
        show=percent,
    ),
)
