"""The parts of the live view that are not about one target: the top line, rules, outputs, events and messages."""

from __future__ import annotations

import json
import math
import textwrap
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from rich.text import Text

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.live.health import Note
from stadimeter.app.live.history import DistanceSample
from stadimeter.app.live.snapshot import why
from stadimeter.cli.formatting import (
    METRE,
    UNKNOWN,
    LengthUnit,
    distance_figures,
    format_age,
    format_bearing,
    format_best,
    format_closing,
    format_distance,
    format_level,
    format_speed,
    format_tilt,
    format_time,
    format_turn,
)
from stadimeter.cli.keyboard import Key, Shown
from stadimeter.cli.layout import fit, hang, heading
from stadimeter.core.command import Command, LevelCommand, TwistCommand
from stadimeter.core.decision import Event, OutputTrace, RuleStatus, RuleTrace, SafetyMode, Severity
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.message import Message
from stadimeter.core.words import one_line

# A strip chart in a terminal: the distance over the last half minute, with its standard deviation as a band -----------

# The colours of the band, of limits and of the line. A cell has that of the highest number among its dots; 0 is no dot.
BAND, LIMIT, LINE = 1, 2, 3
STYLES = ("", "blue", "yellow", "bright_cyan")

# A chart shows this long.
WINDOW_S = 30.0

# The scale spans at least this much, so that the noise of a target at rest looks like rest.
SPAN_MIN_M = 0.4

# In fewer columns nothing can be read.
PLOT_WIDTH_MIN = 12


class StripChart(Struct, frozen=True, kw_only=True):
    """A chart of distance over time.

    Attributes:
        width: Its columns, axis and labels included.
        height: Its rows, the axis of time included; below 3 nothing can be drawn.
    """

    width: int
    height: int
    unit: LengthUnit = METRE
    limits_m: tuple[float, ...] = ()

    def render(self, samples: Iterable[DistanceSample], now_s: float) -> list[Text]:
        """Draw the chart up to a time on the samples' clock; fewer rows, or none, where there is no room."""
        rows = self.height - 1
        if rows < 2:
            return []
        runs = [np.array(run).T for run in _split_at_gaps(samples)]
        scale = self._scale(runs, rows)
        labels = {row: f"{label} {self.unit.symbol}" for row, label in scale.labels()}
        margin = max(map(len, labels.values())) + 2
        if self.width - margin < PLOT_WIDTH_MIN:
            return []
        dots: NDArray[np.intp] = np.zeros((rows * DOWN, (self.width - margin) * ACROSS), np.intp)
        self._draw(dots, scale, runs, now_s)
        plot = [
            Text.assemble(
                (f"{labels.get(row, ''):>{margin - 2}} ", "dim"),
                ("┤" if row in labels else "│", "dim"),
                *cells,
            )
            for row, cells in enumerate(_cells(dots))
        ]
        return [*plot, self._time_axis(margin, self.width - margin)]

    def _scale(self, runs: Sequence[NDArray[np.float64]], rows: int) -> ChartScale:
        edges_m = [edge_m for _, away_m, sigma_m in runs for edge_m in (*(away_m - sigma_m), *(away_m + sigma_m))]
        values = (float(edge_m) / self.unit.size_m for edge_m in (*edges_m, *self.limits_m))
        return chart_scale(values, SPAN_MIN_M / self.unit.size_m, rows)

    def _time_axis(self, margin: int, plot_width: int) -> Text:
        """Draw the axis below: a label every ten seconds, or at the ends alone where there is little room."""
        line = list("─" * plot_width)
        ages_s = range(0, int(WINDOW_S) + 1, 10) if plot_width >= 40 else (0, int(WINDOW_S))
        for age_s in ages_s:
            label = f" -{age_s} s " if age_s else " now"
            start = round((1 - age_s / WINDOW_S) * plot_width - len(label) / 2)
            start = min(max(start, 0), plot_width - len(label))
            line[start : start + len(label)] = label
        return Text.assemble((" " * (margin - 1) + "└" + "".join(line), "dim"))

    def _draw(
        self, dots: NDArray[np.intp], scale: ChartScale, runs: Iterable[NDArray[np.float64]], now_s: float
    ) -> None:
        """Set the dots of everything, in columns from the left and rows from the top."""
        height, width = dots.shape

        def row(value_m: float) -> int:
            """Return the row of dots nearest to a distance, at most one outside of the chart."""
            nearest = round(scale.position(value_m / self.unit.size_m) * DOWN + (DOWN - 1) / 2)
            clipped: int = min(max(nearest, -1), height)
            return clipped

        column_s = WINDOW_S / width
        x_of_column_0 = width - 1 - math.floor(now_s / column_s)
        for column, points in sort_into_columns(runs, column_s).items():
            if not 0 <= (x := x_of_column_0 + column) < width:
                continue
            top = max(0, row(max(distance_m + sigma_m for distance_m, sigma_m in points)))
            bottom = row(min(distance_m - sigma_m for distance_m, sigma_m in points))
            dots[top + (column + top) % 2 : bottom + 1 : 2, x] = BAND  # half the dots, to tell it from the line
            distances_m = [distance_m for distance_m, _ in points]
            dots[max(0, row(max(distances_m))) : row(min(distances_m)) + 1, x] = LINE
        for limit_m in self.limits_m:
            if 0 <= (y := row(limit_m)) < height:
                dots[y, ::3] = np.maximum(dots[y, ::3], LIMIT)


# The dots of a cell, and the bit of each, by row and column, as Unicode numbers them (chapter 21.1, Braille).
ACROSS, DOWN = 2, 4
BRAILLE_BLANK = 0x2800
BRAILLE_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])


def _cells(dots: NDArray[np.intp]) -> Iterator[list[tuple[str, str]]]:
    """Yield the cells of each row, each a character and its style."""
    height, width = dots.shape
    cells = dots.reshape(height // DOWN, DOWN, width // ACROSS, ACROSS).swapaxes(1, 2)
    bits = ((cells > 0) * BRAILLE_BITS).sum((2, 3))
    for row_of_bits, row_of_tops in zip(bits.tolist(), cells.max((2, 3)).tolist(), strict=True):
        yield [
            (chr(BRAILLE_BLANK + bits) if bits else " ", STYLES[top])  # some fonts draw circles for the blank
            for bits, top in zip(row_of_bits, row_of_tops, strict=True)
        ]


# With few rows a step that is too large wastes half of them, so less round ones are taken too.
FACTORS = (1, 2, 5)
FINE_FACTORS = (1, 2, 3, 4, 5, 6, 8)


class ChartScale(Struct, frozen=True, kw_only=True):
    """A scale over rows of characters.

    Attributes:
        low: The figure at the bottom row, in the unit that is shown.
        step: From one label to the next, in the same unit.
    """

    low: float
    step: float
    rows: int
    rows_per_step: int

    def position(self, value: float) -> float:
        """Return the rows a figure is below the middle of the top row; not within the rows if off the scale."""
        return self.rows - 1 - (value - self.low) / self.step * self.rows_per_step

    def labels(self) -> Iterator[tuple[int, str]]:
        """Yield each label with its row, counted from the top."""
        decimals = max(0, -math.floor(math.log10(self.step) + 1e-9))
        for number, row in enumerate(range(self.rows - 1, -1, -self.rows_per_step)):
            yield row, f"{self.low + number * self.step:.{decimals}f}"


def chart_scale(values: Iterable[float], span_min: float, rows: int) -> ChartScale:
    """Choose a scale that holds all figures and does not wobble with every new one; it never goes below 0.

    Args:
        values: Finite; without any, the scale begins at 0.
        span_min: The scale spans at least this much, so that noise does not fill it.
        rows: Two or more.
    """
    shown = [max(0.0, value) for value in values] or [0.0]
    lowest, highest = min(shown), max(shown)
    missing = max(0.0, span_min - (highest - lowest)) / 2
    lowest, highest = max(0.0, lowest - missing), highest + missing
    steps_max = max(1, (rows - 1) // 2)  # a label in every other row is as many as can be read
    factors = FINE_FACTORS if steps_max <= 3 else FACTORS
    for step in _round_steps((highest - lowest) / steps_max, factors):
        low = math.floor(lowest / step + 1e-9) * step
        steps = max(1, math.ceil((highest - low) / step - 1e-9))
        if steps <= steps_max:
            break
    return ChartScale(low=low, step=step, rows=rows, rows_per_step=(rows - 1) // steps)


def _round_steps(least: float, factors: tuple[int, ...]) -> Iterator[float]:
    """Yield some multiples of the powers of ten, upwards from ``least``."""
    power = math.floor(math.log10(least))
    while True:
        for factor in factors:
            if (step := factor * 10.0**power) >= least * (1 - 1e-9):
                yield step
        power += 1


# Distances further apart than this are not joined: the loop stood still, and nothing is known of the time between.
JOIN_S = 1.0

# No camera measures further than this; such a figure would only squeeze all others together.
MAX_DISTANCE_M = 1e5


def _split_at_gaps(samples: Iterable[DistanceSample]) -> Iterator[list[tuple[float, float, float]]]:
    """Yield runs of times, distances and standard deviations; a sample that cannot be drawn is a gap.

    A standard deviation is at most its distance, so that the band never reaches below zero, nor far above all else.
    """
    run: list[tuple[float, float, float]] = []
    for sample in samples:
        distance_m, sigma_m = sample.distance_m, sample.sigma_m
        is_known = distance_m is not None and 0 <= distance_m <= MAX_DISTANCE_M
        if run and (not is_known or sample.at_s - run[-1][0] > JOIN_S):
            yield run
            run = []
        if distance_m is not None and is_known:
            run.append((sample.at_s, distance_m, min(sigma_m, distance_m) if sigma_m > 0 else 0.0))
    if run:
        yield run


def sort_into_columns(runs: Iterable[NDArray[np.float64]], column_s: float) -> dict[int, list[tuple[float, float]]]:
    """Return distances with their standard deviations by column of time, counted from time 0.

    Columns are fixed in time, so what was drawn once moves to the left but never changes its shape. Where the straight
    line between two distances goes from one column to the next, both have the point there: no column of a run is empty,
    and a step is a line.
    """
    columns: dict[int, list[tuple[float, float]]] = defaultdict(list)
    for at_s, distance_m, sigma_m in runs:
        of_points = np.floor(at_s / column_s)
        borders = np.arange(of_points[0] + 1, of_points[-1] + 1)
        times_s = np.concatenate([at_s, borders * column_s, borders * column_s])
        of_each = np.concatenate([of_points, borders - 1, borders])
        points = zip(np.interp(times_s, at_s, distance_m), np.interp(times_s, at_s, sigma_m), strict=True)
        for column, point in zip(of_each.tolist(), points, strict=True):
            columns[int(column)].append(point)
    return columns


# The part of the live view for one target: its distance, large; where it is; and the last half minute -----------------

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


# What the parts of the screen show.
RULE_STYLES = {
    RuleStatus.IDLE: "dim",
    RuleStatus.PENDING: "yellow",
    RuleStatus.ACTIVE: "bold red",
    RuleStatus.CLEARING: "cyan",
    RuleStatus.LATCHED: "bold red",
    RuleStatus.RETURNED: "yellow",
    RuleStatus.UNKNOWN: "magenta",
}

# The mark of each state, in the order of `RuleStatus`.
DOTS = "○◔●◑■◇?"

SAFETY_STYLES = {
    SafetyMode.STARTING: "bold black on yellow",
    SafetyMode.ACTIVE: "bold black on green",
    SafetyMode.STALE: "bold white on red",
    SafetyMode.STOPPED: "bold white on red",
    SafetyMode.DISARMED: "bold black on yellow",
}
SEVERITY_STYLES = {
    Severity.INFO: "bold",
    Severity.WARNING: "yellow",
    Severity.ALARM: "red",
    Severity.SAFETY: "bold magenta",
}
PAUSED_STYLE = "bold black on yellow"
CTRL_C = Key(presses="", name="Ctrl-C", does="quit", act=lambda: None)
SCREEN = (
    ("ACTIVE", "outputs may act: frames are fresh; STARTING, STALE, STOPPED, DISARMED: they are at their safe values"),
    ("target", "its distance ± one standard deviation, how it moves, its bearing, and the last half minute"),
    ("rules", "the state of each, its output, and the reason"),
    ("outputs", "what each really does, and the rule that commands it"),
    ("events", "what changed, the newest first"),
    ("messages", "what was sent to other programs"),
    ("health", "frames, cycle time, board and broker"),
)

# Names longer than this are cut, so that what comes behind them stays in sight.
NAMES_WIDTH_MAX = 16

# Keys of a message that a person does not look at.
PROGRAMS_ONLY = frozenset({"v", "ts", "seq", "id", "since"})

# From this many columns on the top line has room for what is known of the frames.
FRAMES_WIDTH = 56


def header_lines(shown: Shown, width: int) -> list[Text]:
    """Return the top line: what runs, whether outputs may act, how fresh the frames are; below it, what is wrong."""
    snapshot, health = shown.snapshot, shown.snapshot.health
    record = snapshot.record
    title = Text(f" {one_line(shown.title)} ", "bold")
    if record is None:
        return [fit(Text.assemble(title, " waiting for a frame"), width)]
    mode = record.decision.safety
    badge = Text(" PAUSED ", PAUSED_STYLE) if shown.is_paused else Text(f" {mode.value.upper()} ", SAFETY_STYLES[mode])
    age = "no frame" if health.frame_age_s is None else f"age {format_age(health.frame_age_s)}"
    now = format_time(record.observation.now_s - snapshot.started_s)
    frames = f"{health.frame_rate_hz:.1f} fps  {age}  " if width >= FRAMES_WIDTH else ""
    right = Text.assemble(badge, f"  {frames}", (f"{now} ", "bold"))
    warnings = [record.decision.safety_reason]
    fault = record.observation.camera_fault
    # A slow camera has nothing new in many a cycle; that is worth saying only if it stops us.
    if mode is not SafetyMode.ACTIVE and fault not in health.trouble:
        warnings.append(fault)
    return [
        fit(Text.assemble(fit(title, max(0, width - right.cell_len - 1)), " ", right), width),
        *(
            line
            for words in (*warnings, *health.warnings)
            if words
            for line in hang(Text(" ! ", "yellow"), Text(shown.words(words), "yellow"), width)
        ),
    ]


def narration_lines(shown: Shown, width: int) -> list[Text]:
    """Describe what happens in a simulated world."""
    words = shown.words(shown.snapshot.narration)
    return hang(Text(" "), Text(words, "bold bright_cyan"), width) if words else []


def footer_line(shown: Shown, width: int) -> Text:
    """Return the keys that there is room for, with what each would do now."""
    line = Text()
    for key in shown.keys or (CTRL_C,):
        hint = Text.assemble(" ", (key.name, "bold reverse"), f" {key.words} ")
        if line.cell_len + hint.cell_len > width:
            break
        line.append_text(hint)
    return line


def explanation_lines(shown: Shown, width: int) -> list[Text]:
    """Explain what the keys do and what the screen shows, in place of it."""
    keys = [(key.name, f"{key.does}; again: {key.undoes}" if key.undoes else key.does) for key in shown.keys or ()]
    states = "  ".join(f"{dot} {status.value}" for dot, status in zip(DOTS, RuleStatus, strict=True))
    rows = [*keys, ("Ctrl-C", "stop every output at once, and quit"), *SCREEN, ("states", states)]
    return [line for name, words in rows for line in hang(Text(f" {name:<9} ", "bold"), Text(one_line(words)), width)]


class Block(Struct, frozen=True, kw_only=True):
    """A rule or an output: its figures, and the words behind them, which take further lines if they are long.

    Attributes:
        joined: All of it as one line, however long.
        lines: All of it: the words behind the figures if there is room for them, else below.
        is_quiet: Whether the words may be left away where there is no room for all.
    """

    figures: Text
    joined: Text
    lines: list[Text]
    is_quiet: bool


# From this many columns on, words that take several lines stand behind the figures; in fewer, below.
JOINED_WIDTH = 76

# Words below figures begin with this many spaces.
BELOW = 5


def _block(width: int, figures: Text, words: Text, *, is_quiet: bool) -> Block:
    beside = Text.assemble(figures, "  ")
    joined = Text.assemble(beside, words)
    if joined.cell_len > width and width < JOINED_WIDTH:
        lines = [figures, *hang(Text(" " * BELOW), words, width)]
    else:
        lines = hang(beside, words, width)
    return Block(figures=figures, joined=joined, lines=lines, is_quiet=is_quiet)


def rule_blocks(shown: Shown, record: CycleRecord, width: int) -> list[Block]:
    """Describe what each rule does, and why."""
    decision = record.decision
    drives = [_drives(trace, decision.outputs) for trace in decision.rules]
    names_width = _column([trace.rule for trace in decision.rules])
    drives_width = _column([words for words, _ in drives], 28)
    blocks = []
    for trace, (driven, driven_style) in zip(decision.rules, drives, strict=True):
        style = RULE_STYLES[trace.status]
        words = why(decision, trace.rule)
        for said in (f"{trace.status.value}: ", f"; it commands '{trace.output}'"):  # which the figures show
            words = words.removeprefix(said).removesuffix(said)
        figures = Text.assemble(
            (f" {DOTS[list(RuleStatus).index(trace.status)]} ", style),
            fit(Text(one_line(trace.rule), "bold"), names_width),
            (f"  {trace.status.value:<8}{' ' if trace.acknowledged else '!'} ", style),
            fit(Text(one_line(driven), driven_style), drives_width),
        )
        reason = Text(shown.words(words), "dim" if trace.status is RuleStatus.IDLE else "")
        is_quiet = trace.status in {RuleStatus.IDLE, RuleStatus.UNKNOWN}
        blocks.append(_block(width, figures, reason, is_quiet=is_quiet))
    return blocks


def _drives(trace: RuleTrace, outputs: Sequence[OutputTrace]) -> tuple[str, str]:
    """Return the part of a rule in its output, or what inhibits it, and a style."""
    if trace.inhibits:
        return ", ".join(trace.inhibits), "yellow"
    if trace.output is None:
        return "alert only", "dim"
    output = next((output for output in outputs if output.output == trace.output), None)
    if output is not None and output.winner == trace.rule:
        return f"→ {trace.output}", "green"
    if output is not None and trace.rule in output.losers:
        return f"× {trace.output} overruled", "yellow"
    return f"· {trace.output}", "dim"


def output_blocks(shown: Shown, record: CycleRecord, width: int) -> list[Block]:
    """Describe what each output does, and who commands it. The reason of a rule stands beside that rule."""
    done_by = {command.output: command for command in record.applied}
    faults = {fault.output: fault.reason for fault in record.observation.output_faults}
    traces = {trace.output: trace for trace in record.decision.outputs}
    names_width = _column([command.output for command in record.decision.commands])
    blocks = []
    for command in record.decision.commands:
        trace, fault = traces.get(command.output), faults.get(command.output)
        done = done_by.get(command.output)
        value = _value(shown, done, max(6, min(20, width // 4))) if done else Text("out of order", "bold red")
        who = _who(trace)
        if fault is not None:
            who = Text(one_line(fault), "bold red")
        elif done and (asked := _difference(command, done, shown.unit)):
            who = Text.assemble((f"asked for {asked}, ", "yellow"), who)
        name = fit(Text(one_line(command.output), "bold"), names_width)
        is_quiet = fault is None and trace is not None and trace.winner == "safe"
        blocks.append(_block(width, Text.assemble(" ", name, "  ", value), who, is_quiet=is_quiet))
    return blocks


def _value(shown: Shown, command: Command, width: int) -> Text:
    if isinstance(command, LevelCommand):
        full = max(round(command.level * width), 1 if command.level > 0 else 0)
        return Text.assemble(
            ("━" * full, "bold bright_cyan"),
            ("─" * (width - full), "dim"),
            f" {format_level(command.level):>5}",
        )
    speed, turn = command.linear_mps, command.angular_radps
    along = "▲" if speed > 0 else "▼" if speed < 0 else "■"
    around = "↺" if turn > 0 else "↻" if turn < 0 else " "
    style = "bold bright_cyan" if command.moves else "dim"
    words = f" {format_speed(speed, None, shown.unit):>9} "
    return Text.assemble((along, style), words, (around, style), f" {format_turn(turn, command.tilt_radps):>11}")


def _who(trace: OutputTrace | None) -> Text:
    if trace is None:
        return Text()
    line = Text()
    if trace.winner == "safe":
        line.append("safe value", "dim")
    else:
        line.append("by ", "dim").append(one_line(trace.winner), "yellow" if trace.winner == "safety" else "green")
    if trace.losers:
        line.append(one_line(f" over {', '.join(trace.losers)}"), "yellow")
    return line.append(one_line(f": {trace.reason}") if trace.reason else "", "dim")


def _difference(asked: Command, applied: Command, unit: LengthUnit) -> str:
    """Name what was asked for if the driver did something clearly different; rounding to its own steps is not."""
    if isinstance(asked, LevelCommand) and isinstance(applied, LevelCommand):
        return format_level(asked.level) if abs(asked.level - applied.level) > 0.015 else ""
    if isinstance(asked, TwistCommand) and isinstance(applied, TwistCommand):
        away = max(abs(asked.linear_mps - applied.linear_mps), abs(asked.angular_radps - applied.angular_radps) / 4)
        return f"{format_speed(asked.linear_mps, None, unit)} {format_turn(asked.angular_radps)}" if away > 0.02 else ""
    return ""


def event_lines(shown: Shown, event: Event, width: int) -> list[Text]:
    """Return one event: when, and what happened to whom and why."""
    words = Text(one_line(f"{event.source} {event.kind.value.replace('_', ' ')}"))
    words.stylize(SEVERITY_STYLES[event.severity])
    if event.reason:
        words.append(shown.words(f": {event.reason}"))
    return hang(_time(shown, event.at_s), words, width)


def message_line(shown: Shown, at_s: float, message: Message) -> Text:
    """Return one message: when, to which topic, and what."""
    topic, essence = one_line(message.topic), one_line(f"  {_essence(message.payload)}")
    return Text.assemble(_time(shown, at_s), (topic, "bright_cyan"), (essence, "dim"))


def _time(shown: Shown, at_s: float) -> Text:
    return Text(f"{format_time(at_s - shown.snapshot.started_s):>8}  ", "dim")


def note_lines(notes: Sequence[Note]) -> list[Text]:
    """Return the run's health, a line for each thing."""
    column = _column([note.what for note in notes])
    words = [(one_line(note.words), "" if note.is_good else "yellow") for note in notes]
    return [Text.assemble((f" {note.what:<{column}}  ", "dim"), each) for note, each in zip(notes, words, strict=True)]


def _essence(payload: str) -> str:
    """Return the content of a JSON object, without what is only of use to programs; other text as it is."""
    try:
        figures = json.loads(payload)
    except ValueError:
        return payload
    if not isinstance(figures, dict):
        return payload
    return "  ".join(
        f"{key} {value}" for key, value in figures.items() if key not in PROGRAMS_ONLY and value is not None
    )


def _column(names: Sequence[str], width_max: int = NAMES_WIDTH_MAX) -> int:
    return min(width_max, max(map(len, names), default=0))
