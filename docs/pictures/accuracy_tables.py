"""The tables of docs/accuracy.md, from the goals of the benchmark report.

``python docs/pictures/accuracy_tables.py`` writes them into the page.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from msgspec import Struct

DOCS = Path(__file__).parents[1]
PAGE = DOCS / "accuracy.md"
REPORT = DOCS / "benchmarks" / "report.md"
MARKED = re.compile(r"(<!-- table: (\w+) -->\n).*?(<!-- end of table -->\n)", re.DOTALL)


class Goal(Struct, frozen=True):
    """A row of the report's goals."""

    what: str
    reach: str
    reached: str
    is_met: bool


REAL = {
    "real: tennis ball, given intrinsics: median / 90th percentile": (
        "tennis ball, taped at 32 places: median error / 90th percentile"
    ),
    "real: tennis ball, 95 % interval holds": "the same ball: the 95 % interval holds the truth",
    "real: sheet, calibrated on 2 ft, worst of 3 and 4 ft": (
        "sheet of letter paper, calibrated at 2 ft: largest error at 3 and 4 ft"
    ),
    "real: `tags/visp` median error of the range": "twelve AprilTags, against computed poses: median error",
    "real: A4 with print on it: median / found": "A4 with print on it: median error / found",
    "real: sheets of other people: wrong / found": "sheets in pictures of other people: another thing taken / found",
    "real: balls of other people by colour: wrong / found": (
        "balls in pictures of other people: another thing taken / found"
    ),
    "real: balls of other people, no colour given: wrong / found": "the same without a colour",
    "real: rooms without a target, measured for sure: A4 / ball of any colour / green / orange ball / disc": (
        "rooms without a target: A4 / any ball / green / orange ball / disc seen"
    ),
    "real: video of a striped ball: frames tracked, of 1004": (
        "video of a striped ball in a hand: frames tracked, of 1004"
    ),
}
RENDERED = {
    "hard world: ball > 20 px: median / p95": "ball, radius above 20 px, any floor and light: median / 95th percentile",
    "hard world: ball > 20 px: found": "the same: found",
    "ball error, radius 5–10 px, clean, median": "ball, radius 5 to 10 px, sharp: median error",
    "sheet, tilt 0–60°, plain: median / p95": "A4 at a plain wall, tilted by up to 60°: median / 95th percentile",
    "sheet, tilt 0–60°, clutter: found": "the same in clutter: found",
    "tag of 48 / 100 px, median": "tag of 48 / 100 px: median error",
    "95 % interval holds the truth, overall": "the 95 % interval holds the truth",
}
MISSED = {
    "hard world: ball > 20 px: 95 % interval": "ball, radius above 20 px: the 95 % interval holds",
    "hard world: 95 % interval of the ball, least and most of all rows: > 20 px / 5–10 px": (
        "the same on each kind of ball, > 20 px / 5–10 px"
    ),
    "hard world: silver ball, its colour not given: found": "silver ball without a colour: found",
    "clutter / rooms taken for a ball whose colour is not given": "clutter / rooms taken for a ball without a colour",
    "hard world: card and tape cut by hand, ±1 mm, 15–60 px: found": "card / tape cut by hand, 15 to 60 px: found",
    "hard world: 95 % interval, least and most of all rows: cut sheets": "the same: the 95 % interval holds",
    "rooms without a target: sheet / card / disc / ball / magenta ball seen": (
        "rooms without a target: sheet / card / disc / ball / magenta ball seen"
    ),
    "rooms without a target: a sheet said to be cut off by the border": (
        "the same: a sheet said to be cut off by the border"
    ),
    "empty clutter taken for a sheet": "empty clutter taken for a sheet",
    "95 % interval holds the truth, for each trouble": "the 95 % interval holds, for each trouble of pictures",
}
"""Missed goals that the tables before do not show, in words of the page; those of speed are on no page."""
OF_SPEED = re.compile(r"against (?:the|HSV|bare|`cv2)|everything but vision")


def goals() -> dict[str, Goal]:
    """Return the rows of the report's goals by what is to be reached."""
    table = REPORT.read_text(encoding="utf-8").partition("\n## Goals\n")[2].partition("\n## ")[0]
    rows = [line.strip("| ").split(" | ") for line in table.splitlines() if line.startswith("| ")][2:]
    return {row[0]: Goal(row[0], row[1], row[2], row[3].strip() == "yes") for row in rows}


def tables() -> dict[str, str]:
    """Return each table by its name; a missed goal without words is a KeyError."""
    every = goals()
    shown = REAL.keys() | RENDERED.keys()
    missed = [each.what for each in every.values() if not each.is_met and each.what not in shown]
    others = {what: MISSED[what] for what in missed if not OF_SPEED.search(what)}
    return {
        name: "".join(_lines(named, every))
        for name, named in (("real", REAL), ("rendered", RENDERED), ("missed", others))
    }


def _lines(named: Mapping[str, str], every: Mapping[str, Goal]) -> Iterator[str]:
    yield "| what | reached | goal |\n| --- | ---: | ---: |\n"
    for what, words in named.items():
        goal = every[what]
        reached = re.sub(r"(\d)\.00 %", r"\1 %", goal.reached.partition("; outside")[0])
        missed = "" if goal.is_met or what in MISSED else ", **missed**"
        yield f"| {words} | {reached} | {goal.reach}{missed} |\n"


def with_tables(page: str) -> str:
    """Return the page with its tables as they are now."""
    made = tables()
    return MARKED.sub(lambda found: found[1] + made[found[2]] + found[3], page)


if __name__ == "__main__":
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
