"""The part of the live view for one target: its distance, large; where it is; and the last half minute."""

from __future__ import annotations

import math
import textwrap

from rich.text import Text

from stadimeter.cli.formatting import (
    UNKNOWN,
    distance_figures,
    format_bearing,
    format_best,
    format_closing,
    format_distance,
    format_tilt,
    format_time,
)
from stadimeter.cli.keyboard import Shown
from stadimeter.cli.layout import fit, heading
from stadimeter.cli.strip_chart import StripChart
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.words import one_line

STATUS_STYLES = {
    TrackStatus.SEARCHING: "yellow",
    TrackStatus.TRACKING: "green",
    TrackStatus.COASTING: "yellow",
    TrackStatus.LOST: "red",
}

# The bearing's scale reaches this far to either side: about what a common lens sees.
BEARING_END_RAD = math.radians(30)

# From this size on there is room for large digits.
BIG_WIDTH, BIG_ROWS = 48, 14

# In fewer columns the distance and the bearing stand on a line each.
SPLIT_WIDTH = 60

# The reason why a target is not measured has this many lines of its own at most, if there is room for all of it.
WHY_ROWS = 4


def target_lines(shown: Shown, track: Track, width: int, rows: int) -> list[Text]:
    """Show one target in the room that there is, in at most `rows` lines."""
    if rows < 2:
        return [fit(_one_line(shown, track), width)][:rows]
    is_big = rows >= BIG_ROWS and width >= BIG_WIDTH
    why = _why_not(shown, track, width)
    figures = _figures(shown, track, width, is_big=is_big)
    if 1 + len(figures) + len(why) > rows:
        figures, why = _figures(shown, track, width, is_big=is_big, reason=track.reason), []
    status = (track.status.value, f"bold {STATUS_STYLES[track.status]}")
    top = [heading(one_line(track.target), width, status), *figures, *why][:rows]
    snapshot = shown.snapshot
    limits_m = tuple(snapshot.limits_m.get(track.target, ()))
    chart = StripChart(width=width, height=rows - len(top), unit=shown.unit, limits_m=limits_m)
    now_s = snapshot.record.observation.now_s if snapshot.record else 0.0
    plot = chart.render(snapshot.samples.get(track.target, ()), now_s)
    return [fit(line, width) for line in (*top, *plot)]


def figure_rows(shown: Shown, track: Track, width: int) -> int:
    """Return the rows that a target takes without its chart: its heading, its figures, and why it is not measured."""
    return 1 + len(_figures(shown, track, width)) + len(_why_not(shown, track, width))


def _one_line(shown: Shown, track: Track) -> Text:
    status = (f" {track.status.value} ", STATUS_STYLES[track.status])
    name = (one_line(track.target), "bold")
    line = Text.assemble(" ", name, " ", _distance(shown, track), status)
    return line.append_text(Text("  ").join(_whereabouts(shown, track, track.reason)))


def _figures(shown: Shown, track: Track, width: int, *, is_big: bool = False, reason: str = "") -> list[Text]:
    """Return its distance, how it moves and where it is, on as many lines as the width asks for."""
    motion, place = _whereabouts(shown, track, reason)
    if is_big:
        number, plus_minus = distance_figures(track.distance_m, track.sigma_m, shown.unit)
        unit = "" if number == UNKNOWN else shown.unit.symbol
        style = _style(track)
        beside = Text(f"{unit} ± {plus_minus}" if plus_minus else unit, style)
        rows = zip(big_digits(number), (beside, motion, place), strict=True)
        return [Text.assemble(" ", (digits, style), "  ", words) for digits, words in rows]
    distance = Text.assemble(" ", _distance(shown, track))
    if width >= SPLIT_WIDTH:
        line = Text.assemble(distance, "   ", motion, "  ", place)
        line.rstrip()
        return [line]
    return [Text.assemble(distance, "  ", motion), *([Text.assemble(" ", place)] if place else [])]


def _why_not(shown: Shown, track: Track, width: int) -> list[Text]:
    """Return why it is not measured, and what looked most like it: nothing if it is, or nothing is known."""
    if track.status is TrackStatus.TRACKING:
        return []
    best = format_best(track.reason, shown.snapshot.looked_at.get(track.target, ()))
    reasons = ((track.reason, "italic yellow"), (best, "dim"))
    lines = [Text(f" {line}", style) for reason, style in reasons for line in _wrap(one_line(reason), width - 2)]
    return lines[:WHY_ROWS]


def _style(track: Track) -> str:
    return f"{'bold' if track.is_valid else 'dim'} {STATUS_STYLES[track.status]}"


def _distance(shown: Shown, track: Track) -> Text:
    return Text(format_distance(track.distance_m, track.sigma_m, shown.unit), _style(track))


def _whereabouts(shown: Shown, track: Track, reason: str) -> tuple[Text, Text]:
    """Describe how it moves and where it is, or since when and why that is not known."""
    snapshot = shown.snapshot
    why = Text(one_line(reason), "italic yellow")
    if not track.is_valid:
        last_seen = ""
        if track.measured_at_s is not None and snapshot.record is not None:
            last_seen = f"last seen {format_time(snapshot.record.observation.now_s - track.measured_at_s)} ago"
        return Text(last_seen, "italic"), why
    speed = format_closing(track.closing_mps, track.closing_sigma_mps, shown.unit)
    bearing = format_bearing(track.bearing_rad)
    tilt = format_tilt(snapshot.tilts_rad.get(track.target))
    scale = bearing_scale(track.bearing_rad)
    return Text(f"{speed:<16}"), Text.assemble(f"{bearing:<9} ", scale, f"  {tilt}  " if tilt else "  ", why)


def _wrap(words: str, width: int) -> list[str]:
    """Return words on two lines at most."""
    lines = textwrap.wrap(words, max(1, width)) if words else []
    return [*lines[:1], " ".join(lines[1:])] if len(lines) > 1 else lines


def bearing_scale(bearing_rad: float | None, width: int = 17) -> Text:
    """Draw a bearing, positive to the right, on a scale such as ``├──●────┼───────┤``; empty if unknown."""
    if bearing_rad is None or not math.isfinite(bearing_rad):
        return Text()
    inner = width - 2
    cells = ["├", *("─" * inner), "┤"]
    cells[width // 2] = "┼"
    share = bearing_rad / BEARING_END_RAD
    place = width // 2 + round(max(-1.0, min(1.0, share)) * (inner // 2))
    mark = "●" if abs(share) <= 1 else "▶" if share > 0 else "◀"
    before, after = "".join(cells[:place]), "".join(cells[place + 1 :])
    return Text.assemble((before, "dim"), (mark, "bold bright_cyan"), (after, "dim"))


_DIGITS = {
    "0": ("█▀█", "█ █", "▀▀▀"),
    "1": ("▀█ ", " █ ", "▀▀▀"),
    "2": ("▀▀█", "█▀▀", "▀▀▀"),
    "3": ("▀▀█", " ▀█", "▀▀▀"),
    "4": ("█ █", "▀▀█", "  ▀"),
    "5": ("█▀▀", "▀▀█", "▀▀▀"),
    "6": ("█▀▀", "█▀█", "▀▀▀"),
    "7": ("▀▀█", "  █", "  ▀"),
    "8": ("█▀█", "█▀█", "▀▀▀"),
    "9": ("█▀█", "▀▀█", "▀▀▀"),
    ".": (" ", " ", "▀"),
    "-": ("  ", "▀▀", "  "),
    "—": ("   ", "▀▀▀", "   "),
}


def big_digits(number: str) -> tuple[str, str, str]:
    """Write a number in three rows of the same width: digits, a point, a minus sign, or the dash for no number."""
    rows = [" ".join(_DIGITS[character][row] for character in number) for row in range(3)]
    return rows[0], rows[1], rows[2]
