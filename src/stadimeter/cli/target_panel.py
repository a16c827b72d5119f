"""The part of the live view for one target: its distance, large; where it is; and the last half minute."""

from __future__ import annotations

import math
import textwrap

from rich.text import Text

from stadimeter.cli.formatting import (
    FOOT,
    UNKNOWN,
    LengthUnit,
    distance_figures,
    format_bearing,
    format_best,
    format_closing,
    format_distance,
    format_feet_and_inches,
    format_tilt,
    format_time,
)
from stadimeter.cli.glyphs import Glyphs, heading
from stadimeter.cli.keyboard import Shown
from stadimeter.cli.strip_chart import StripChart
from stadimeter.core.track import Track, TrackStatus

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


def target_lines(shown: Shown, track: Track, width: int, rows: int, glyphs: Glyphs) -> list[Text]:
    """Show one target in the room that there is, in at most `rows` lines."""
    figures = _Figures(shown, track, glyphs)
    if rows < 2:
        return [glyphs.fit(figures.one_line(), width)][:rows]
    is_big = rows >= BIG_ROWS and width >= BIG_WIDTH and not glyphs.ascii_only
    why = figures.why_not(width, WHY_ROWS)
    figured = figures.large if is_big else figures.small if width < SPLIT_WIDTH else figures.normal
    if 1 + len(figured(with_reason=False)) + len(why) > rows:
        why = []
    top = [
        heading(track.target, width, glyphs, (track.status.value, f"bold {STATUS_STYLES[track.status]}")),
        *figured(with_reason=not why),
        *why,
    ][:rows]
    chart = StripChart(
        width=width,
        height=rows - len(top),
        unit=shown.unit,
        limits_m=tuple(shown.snapshot.limits_m.get(track.target, ())),
        glyphs=glyphs,
    )
    snapshot = shown.snapshot
    now_s = snapshot.record.observation.now_s if snapshot.record else 0.0
    return [glyphs.fit(line, width) for line in (*top, *chart.render(snapshot.samples.get(track.target, ()), now_s))]


def figure_rows(shown: Shown, track: Track, width: int, glyphs: Glyphs) -> int:
    """Return the rows that a target takes without its chart: its heading, its figures, and why it is not measured."""
    figures = _Figures(shown, track, glyphs)
    figured = figures.small if width < SPLIT_WIDTH else figures.normal
    return 1 + len(figured(with_reason=False)) + len(figures.why_not(width, WHY_ROWS))


class _Figures:
    """The words and figures about one target."""

    def __init__(self, shown: Shown, track: Track, glyphs: Glyphs) -> None:
        self._snapshot = shown.snapshot
        self._unit: LengthUnit = shown.unit
        self._track = track
        self._glyphs = glyphs
        colour = STATUS_STYLES[track.status]
        self._style = f"bold {colour}" if track.is_valid else f"dim {colour}"

    def one_line(self) -> Text:
        status = (f" {self._track.status.value} ", STATUS_STYLES[self._track.status])
        line = Text.assemble(" ", (self._words(self._track.target), "bold"), " ", self._distance(), status)
        return line.append_text(Text("  ").join(self._whereabouts()))

    def normal(self, *, with_reason: bool = True) -> list[Text]:
        line = Text("  ").join((Text.assemble(" ", self._distance(), " "), *self._whereabouts(with_reason=with_reason)))
        line.rstrip()
        return [line]

    def small(self, *, with_reason: bool = True) -> list[Text]:
        motion, bearing = self._whereabouts(with_reason=with_reason)
        lines = [Text.assemble(" ", self._distance(), "  ", motion), Text.assemble(" ", bearing)]
        return lines if bearing else lines[:1]

    def large(self, *, with_reason: bool = True) -> list[Text]:
        number, plus_minus = distance_figures(self._track.distance_m, self._track.sigma_m, self._unit)
        unit = "" if number == UNKNOWN else self._unit.symbol
        beside = Text.assemble((f"{unit} ± {plus_minus}" if plus_minus else unit, self._style), self._also())
        rows = zip(big_digits(number), (beside, *self._whereabouts(with_reason=with_reason)), strict=True)
        return [Text.assemble(" ", (digits, self._style), "  ", words) for digits, words in rows]

    def why_not(self, width: int, rows: int) -> list[Text]:
        """Return why it is not measured, and what looked most like it: nothing if it is, or nothing is known."""
        if self._track.status is TrackStatus.TRACKING:
            return []
        best = format_best(self._track.reason, self._snapshot.looked_at.get(self._track.target, ()))
        reasons = ((self._track.reason, "italic yellow"), (best, "dim"))
        lines = [Text(f" {line}", style) for words, style in reasons for line in _wrap(self._words(words), width - 2)]
        return lines[:rows]

    def _distance(self) -> Text:
        words = format_distance(self._track.distance_m, self._track.sigma_m, self._unit)
        return Text.assemble((self._words(words), self._style), self._also())

    def _also(self) -> Text:
        """Return the same in feet and inches, for people who chose feet."""
        if self._unit is not FOOT or self._track.distance_m is None:
            return Text()
        return Text(f" ({format_feet_and_inches(self._track.distance_m, self._track.sigma_m)})", "dim")

    def _whereabouts(self, *, with_reason: bool = True) -> tuple[Text, Text]:
        """Return how it moves and where it is, or since when and why that is not known."""
        reason = Text(self._words(self._track.reason) if with_reason else "", "italic yellow")
        if not self._track.is_valid:
            return Text(self._last_seen(), "italic"), reason
        speed = format_closing(self._track.closing_mps, self._track.closing_sigma_mps, self._unit)
        bearing = self._words(format_bearing(self._track.bearing_rad))
        scale = bearing_scale(self._track.bearing_rad, self._glyphs)
        tilt = self._words(format_tilt(self._snapshot.tilts_rad.get(self._track.target)))
        return Text(f"{speed:<16}"), Text.assemble(f"{bearing:<9} ", scale, f"  {tilt}  " if tilt else "  ", reason)

    def _last_seen(self) -> str:
        if self._track.measured_at_s is None or self._snapshot.record is None:
            return ""
        return f"last seen {format_time(self._snapshot.record.observation.now_s - self._track.measured_at_s)} ago"

    def _words(self, text: str) -> str:
        return self._glyphs.words(text)


def _wrap(words: str, width: int) -> list[str]:
    """Return words on two lines at most."""
    lines = textwrap.wrap(words, max(1, width)) if words else []
    return [*lines[:1], " ".join(lines[1:])] if len(lines) > 1 else lines


def bearing_scale(bearing_rad: float | None, glyphs: Glyphs, width: int = 17) -> Text:
    """Draw a bearing, positive to the right, on a scale such as ``├──●────┼───────┤``; empty if unknown."""
    if bearing_rad is None or not math.isfinite(bearing_rad):
        return Text()
    inner = width - 2
    cells = [glyphs.left_end, *(glyphs.line * inner), glyphs.right_end]
    cells[width // 2] = glyphs.middle
    share = bearing_rad / BEARING_END_RAD
    place = width // 2 + round(max(-1.0, min(1.0, share)) * (inner // 2))
    mark = glyphs.mark if abs(share) <= 1 else glyphs.beyond_right if share > 0 else glyphs.beyond_left
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
