"""The live view: a run in a terminal, while it runs.

One view for 80 columns and more, the most important at the top. Rich breaks the words; what does not fit is cut at the
bottom, and counted there.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Self

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.live import Live
from rich.rule import Rule
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.live.history import DistanceSample
from stadimeter.app.live.snapshot import LiveFeed, RunSnapshot, why
from stadimeter.cli.formatting import (
    LENGTH_UNITS,
    METRE,
    LengthUnit,
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
    in_unit,
)
from stadimeter.cli.keyboard import RunKeys
from stadimeter.core.command import Command, LevelCommand, TwistCommand
from stadimeter.core.decision import Decision, OutputTrace, RuleStatus, RuleTrace, SafetyMode, Severity
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.outputs import NO_RULE
from stadimeter.core.words import one_line

# The screen is drawn anew this often at most.
REFRESH_S = 0.1

# Drawing takes at most this share of the time: on a slow computer the screen is drawn less often, and the loop goes
# on as before.
SHARE_MAX = 0.2

# The chart shows this long.
WINDOW_S = 30.0

# Longer lines are hard to follow with the eye.
WIDTH_MAX = 120

# The newest events that are shown.
EVENTS_SHOWN = 6

STATUS_STYLES = {TrackStatus.TRACKING: "green", TrackStatus.LOST: "red"}

# The mark and the style of each state of a rule.
RULE_STYLES = {
    RuleStatus.IDLE: ("○", "dim"),
    RuleStatus.PENDING: ("◔", "yellow"),
    RuleStatus.ACTIVE: ("●", "bold red"),
    RuleStatus.CLEARING: ("◑", "cyan"),
    RuleStatus.LATCHED: ("■", "bold red"),
    RuleStatus.RETURNED: ("◇", "yellow"),
    RuleStatus.UNKNOWN: ("?", "magenta"),
}
SAFETY_STYLES = {
    SafetyMode.ACTIVE: "bold black on green",
    SafetyMode.STALE: "bold white on red",
    SafetyMode.STOPPED: "bold white on red",
}
WAITING_STYLE = "bold black on yellow"  # of the other modes, and of a run that is paused
SEVERITY_STYLES = {
    Severity.INFO: "bold",
    Severity.WARNING: "yellow",
    Severity.ALARM: "red",
    Severity.SAFETY: "bold magenta",
}
SCREEN = (
    ("ACTIVE", "outputs may act: frames are fresh; STARTING, STALE, STOPPED, DISARMED: they are at their safe values"),
    ("target", "its distance ± one standard deviation, how it moves, and its bearing"),
    ("chart", "distances of the last half minute, and as dashes the distances at which rules begin"),
    ("outputs", "what each really does, and the rule that commands it"),
    ("rules", "the state of each, its output, and the reason"),
    ("events", "what changed, the newest first"),
    ("health", "frames, cycle time, board and broker"),
    ("states", "  ".join(f"{mark} {status.value}" for status, (mark, _) in RULE_STYLES.items())),
)


class LiveView:
    """Shows a run in a terminal, drawn from the loop's own thread: there is no other.

    Used as a context manager it takes the whole terminal and gives it back at the end. `update` then draws, about ten
    times a second. Without that, rich may print it at any time: exactly as high and as wide as there is room for.

    Args:
        feed: Where snapshots of the run come from.
        unit: That of distances.
        keys: What keys do; they are attended to after each cycle.
        real_time_s: A monotonic clock of real time, in seconds. Simulated time would draw too often, or too seldom.
    """

    def __init__(
        self,
        title: str,
        feed: LiveFeed,
        *,
        unit: str = "m",
        keys: RunKeys | None = None,
        console: Console | None = None,
        real_time_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._title = title
        self._unit = LENGTH_UNITS[unit]
        self._feed = feed
        self._snapshot = RunSnapshot()
        self._keys = keys
        self._live = Live(self, console=console, screen=True, auto_refresh=False)
        self._real_time_s = real_time_s
        self._draw_at_s = 0.0

    def __enter__(self) -> Self:
        """Take the terminal."""
        self._live.start(refresh=True)
        self._draw_at_s = self._real_time_s()
        return self

    def __exit__(self, *_error: object) -> None:
        """Give the terminal back as it was."""
        self._live.stop()

    def update(self, _record: CycleRecord) -> None:
        """Attend to the keys after a cycle, which the feed knows; draw if it is time to."""
        if self._keys is not None:
            self._keys.attend(self._live.refresh)
        started_s = self._real_time_s()
        if started_s < self._draw_at_s:
            return
        self._live.refresh()
        ended_s = self._real_time_s()
        self._draw_at_s = max(started_s + REFRESH_S, ended_s + (ended_s - started_s) * (1 / SHARE_MAX - 1))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        """Yield the sections as they are now, cut where the rows end, and the keys below."""
        self._snapshot = self._feed.snapshot(WINDOW_S)
        height = options.height or console.height
        options = options.update(width=min(options.max_width, WIDTH_MAX), height=None)
        footer = [self._footer()] if self._keys is not None and height > 1 else []
        rows = height - len(footer)
        lines = console.render_lines(Group(*self._sections(options.max_width, height)), options)
        if len(lines) > rows:
            more = Text(f" {len(lines) - rows + 1} more lines need a higher terminal", "italic dim")
            lines = [*lines[: rows - 1], *console.render_lines(more, options)[:1]]
        lines = Segment.set_shape(lines, options.max_width, rows)
        for line in (*lines, *(console.render_lines(each, options)[0] for each in footer)):
            yield from line
            yield Segment.line()

    def _sections(self, width: int, height: int) -> Iterator[RenderableType]:
        snapshot, keys = self._snapshot, self._keys
        record = snapshot.record
        if record is None:
            yield Text(f" {one_line(self._title)}  waiting for a frame", "bold")
            return
        yield self._header(record)
        warnings = [("!", words, "yellow") for words in self._warnings(record)]
        for mark, words, style in (*warnings, (">", snapshot.narration, "bold bright_cyan")):
            if words:
                yield _grid([(Text(mark, style), Text(self._words(words), style))])
        if keys is not None and keys.is_explained:
            told = [(key.name, key.does + (f"; again: {key.undoes}" if key.undoes else "")) for key in keys.keys]
            yield _grid((Text(name, "bold"), Text(words)) for name, words in (*told, *SCREEN))
            return
        tracks, now_s = record.decision.tracks, record.observation.now_s
        colours = {each.target: LINES[number % len(LINES)] for number, each in enumerate(tracks)}
        yield _grid(self._target(track, colours[track.target], now_s) for track in tracks)
        limits_m = {limit_m for each in tracks for limit_m in snapshot.limits_m.get(each.target, ())}
        lines = [(colours[each.target], snapshot.samples.get(each.target, ())) for each in tracks]
        yield Group(*StripChart(width, height // 3 - 2, self._unit, tuple(sorted(limits_m))).render(lines, now_s))
        sections = {
            "outputs": self._outputs(record),
            "rules": (self._rule(trace, record.decision) for trace in record.decision.rules),
            "events": self._events(),
            "health": self._health(),
        }
        for name, rows in sections.items():
            if (grid := _grid(rows)).row_count:
                yield Rule(Text(name, "bold"), align="left", style="dim")
                yield grid

    def _header(self, record: CycleRecord) -> Table:
        """Return the top line: what runs, whether outputs may act, how fresh the frames are."""
        health, mode = self._snapshot.health, record.decision.safety
        is_paused = self._keys is not None and self._keys.is_paused
        words = "PAUSED" if is_paused else mode.value.upper()
        style = WAITING_STYLE if is_paused else SAFETY_STYLES.get(mode, WAITING_STYLE)
        age = "no frame" if health.frame_age_s is None else f"age {format_age(health.frame_age_s)}"
        now = format_time(record.observation.now_s - self._snapshot.started_s)
        header = Table.grid(expand=True)
        header.add_column(ratio=1, no_wrap=True)
        header.add_column(no_wrap=True)
        title = Text(f" {one_line(self._title)} ", "bold")
        header.add_row(
            title,
            Text.assemble((f" {words} ", style), f"  {health.frame_rate_hz:.1f} fps  {age}  ", (f"{now} ", "bold")),
        )
        return header

    def _warnings(self, record: CycleRecord) -> Iterator[str]:
        health, fault = self._snapshot.health, record.observation.camera_fault
        yield record.decision.safety_reason
        # A slow camera has nothing new in many a cycle; that is worth saying only if it stops us.
        if record.decision.safety is not SafetyMode.ACTIVE and fault not in health.trouble:
            yield fault
        yield from health.warnings

    def _footer(self) -> Text:
        """Return the keys, with what each would do now."""
        line = Text(no_wrap=True, overflow="ellipsis")
        keys = self._keys.keys if self._keys is not None else ()
        for name, words in [(key.name, key.words) for key in keys] or [("Ctrl-C", "quit")]:
            line.append(" ").append(name, "bold reverse").append(f" {words} ")
        return line

    def _words(self, text: str) -> str:
        """Return a text as it is shown: on one line, in the unit."""
        return one_line(in_unit(text, self._unit))

    def _target(self, track: Track, colour: str, now_s: float) -> tuple[Text, ...]:
        """Describe a target: its distance and where it is, or since when and why that is not known."""
        style = STATUS_STYLES.get(track.status, "yellow")
        strong = f"{'bold' if track.is_valid else 'dim'} {style}"
        distance = Text(format_distance(track.distance_m, track.sigma_m, self._unit), strong, no_wrap=True)
        if track.is_valid:
            speed = format_closing(track.closing_mps, track.closing_sigma_mps, self._unit)
            tilt = format_tilt(self._snapshot.tilts_rad.get(track.target))
            where = Text(f"{speed:<16} {format_bearing(track.bearing_rad):<9} {tilt}")
        else:
            seen_at_s = track.measured_at_s
            where = Text("" if seen_at_s is None else f"last seen {format_time(now_s - seen_at_s)} ago", "italic")
        if track.status is not TrackStatus.TRACKING:
            best = format_best(track.reason, self._snapshot.looked_at.get(track.target, ()))
            for words, said in ((one_line(track.reason), "italic yellow"), (one_line(best), "dim")):
                where.append("\n" * bool(words and where)).append(words, said)
        name, status = Text(one_line(track.target), f"bold {colour}"), Text(track.status.value, style, no_wrap=True)
        return name, status, distance, where

    def _rule(self, trace: RuleTrace, decision: Decision) -> tuple[Text, ...]:
        """Describe what a rule does, and why."""
        mark, style = RULE_STYLES[trace.status]
        words = why(decision, trace.rule)
        for said in (f"{trace.status.value}: ", f"; it commands '{trace.output}'"):  # which the other columns show
            words = words.removeprefix(said).removesuffix(said)
        reason = Text(self._words(words))
        if trace.status in {RuleStatus.IDLE, RuleStatus.UNKNOWN}:
            reason.no_wrap, reason.overflow, reason.style = True, "ellipsis", "dim"
        name = Text.assemble((f"{mark} ", style), (one_line(trace.rule), "bold"))
        status = Text(f"{trace.status.value}{'' if trace.acknowledged else '!'}", style, no_wrap=True)
        return name, status, _drives(trace, decision.outputs), reason

    def _outputs(self, record: CycleRecord) -> Iterator[tuple[Text, ...]]:
        """Describe what each output does, and who commands it. The reason of a rule stands beside that rule."""
        done_by = {command.output: command for command in record.applied}
        faults = {fault.output: fault.reason for fault in record.observation.output_faults}
        traces = {trace.output: trace for trace in record.decision.outputs}
        for command in record.decision.commands:
            done = done_by.get(command.output)
            who = _who(traces.get(command.output))
            if (fault := faults.get(command.output)) is not None:
                who = Text(one_line(fault), "bold red")
            elif done and (asked := _difference(command, done, self._unit)):
                who = Text.assemble((f"asked for {asked}, ", "yellow"), who)
            value = self._value(done) if done else Text("out of order", "bold red")
            value.no_wrap = True
            yield Text(one_line(command.output), "bold"), value, who

    def _value(self, command: Command) -> Text:
        if isinstance(command, LevelCommand):
            full = max(round(command.level * BAR_WIDTH), 1 if command.level > 0 else 0)
            bar = ("━" * full, "bold bright_cyan"), ("─" * (BAR_WIDTH - full), "dim")
            return Text.assemble(*bar, f" {format_level(command.level):>5}")
        speed, turn = command.linear_mps, command.angular_radps
        along = "▲" if speed > 0 else "▼" if speed < 0 else "■"
        around = "↺" if turn > 0 else "↻" if turn < 0 else " "
        style = "bold bright_cyan" if command.moves else "dim"
        words = f" {format_speed(speed, None, self._unit):>9} "
        return Text.assemble((along, style), words, (around, style), f" {format_turn(turn, command.tilt_radps):>11}")

    def _events(self) -> Iterator[tuple[Text, ...]]:
        """Yield the newest events: when, and what happened to whom and why."""
        for event in self._snapshot.events[:EVENTS_SHOWN]:
            words = Text(one_line(f"{event.source} {event.kind.value.replace('_', ' ')}"))
            words.stylize(SEVERITY_STYLES[event.severity])
            yield self._time(event.at_s), words.append(self._words(f": {event.reason}") if event.reason else "")

    def _health(self) -> Iterator[tuple[Text, ...]]:
        for note in self._snapshot.health.notes:
            yield Text(note.what, "dim"), Text(one_line(note.words), "" if note.is_good else "yellow")

    def _time(self, at_s: float) -> Text:
        return Text(f"{format_time(at_s - self._snapshot.started_s):>8}", "dim", no_wrap=True)


# Longer names are cut, so that what stands behind them has room.
NAMES_WIDTH_MAX = 18

# A bar for a level has this many columns, about as many as a speed and a turn take.
BAR_WIDTH = 20


def _grid(rows: Iterable[Sequence[Text]]) -> Table:
    """Lay rows out in columns: names in the first are cut where they are long, the last takes the room that is left."""
    grid = Table.grid(padding=(0, 1), expand=True, pad_edge=True, collapse_padding=True)
    for row in rows:
        for number in range(len(grid.columns), len(row)):
            is_name, is_last = number == 0, number == len(row) - 1
            width = NAMES_WIDTH_MAX if is_name else None
            grid.add_column(no_wrap=is_name, max_width=width, ratio=1 if is_last else None)
        grid.add_row(*row)
    return grid


def _drives(trace: RuleTrace, outputs: Sequence[OutputTrace]) -> Text:
    """Return the part of a rule in its output, or what inhibits it."""
    if trace.inhibits:
        return Text(", ".join(trace.inhibits), "yellow")
    if trace.output is None:
        return Text("alert only", "dim")
    output = next((output for output in outputs if output.output == trace.output), None)
    if output is not None and output.winner == trace.rule:
        return Text(one_line(f"→ {trace.output}"), "green")
    if output is not None and trace.rule in output.losers:
        return Text(one_line(f"× {trace.output} overruled"), "yellow")
    return Text(one_line(f"· {trace.output}"), "dim")


def _who(trace: OutputTrace | None) -> Text:
    if trace is None:
        return Text()
    line = Text()
    if trace.winner == "safe" and trace.reason == NO_RULE:
        return line.append(NO_RULE, "dim")
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


# A strip chart in a terminal: distances over the last half minute as lines of dots, limits as dashes -----------------

# The colours of the lines, one for each target in turn, and of limits.
LINES = ("bright_cyan", "bright_magenta", "bright_green", "bright_white")
LIMIT_STYLE = "yellow"

# The scale spans at least this much, so that the noise of a target at rest looks like rest.
SPAN_MIN_M = 0.4

# In fewer columns nothing can be read.
PLOT_WIDTH_MIN = 24

# The dots of a cell, and the bit of each, by row and column, as Unicode numbers them (chapter 21.1, Braille).
ACROSS, DOWN = 2, 4
BRAILLE_BLANK = 0x2800
BRAILLE_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])


# Distances further apart than this are not joined: the loop stood still, and nothing is known of the time between.
JOIN_S = 1.0

# No camera measures further than this; such a figure would only squeeze all others together.
MAX_DISTANCE_M = 1e5


class StripChart(Struct, frozen=True):
    """A chart of distances over time.

    Attributes:
        width: Its columns, axis and labels included.
        height: Its rows, the axis of time included; below 3 nothing can be drawn.
    """

    width: int
    height: int
    unit: LengthUnit = METRE
    limits_m: tuple[float, ...] = ()

    def render(self, lines: Sequence[tuple[str, Sequence[DistanceSample]]], now_s: float) -> list[Text]:
        """Draw samples, each line with its colour, up to a time on their clock; nothing where there is no room."""
        rows, size_m = self.height - 1, self.unit.size_m
        if rows < 2:
            return []
        shown_m = [*self.limits_m, *(_drawn_m(each) for _, samples in lines for each in samples)]
        shown = (each_m / size_m for each_m in shown_m if math.isfinite(each_m))
        scale = chart_scale(shown, SPAN_MIN_M / size_m, rows)
        labels = {row: (f"{label} {self.unit.symbol}", "dim") for row, label in scale.labels()}
        limits = {round(float(scale.position(each_m / size_m))): each_m / size_m for each_m in self.limits_m}
        decimals = min(2, self.unit.decimals_max)
        labels |= {row: (f"{each:.{decimals}f} {self.unit.symbol}", LIMIT_STYLE) for row, each in limits.items()}
        margin = max(len(label) for label, _ in labels.values()) + 2
        if self.width - margin < PLOT_WIDTH_MIN:
            return []
        dots: NDArray[np.intp] = np.zeros((rows * DOWN, (self.width - margin) * ACROSS), np.intp)
        for number, (_, samples) in enumerate(lines, 1):
            if samples:
                self._draw(dots, scale, samples, now_s, number)
        styles = ["", *(colour for colour, _ in lines)]
        plot = []
        cells = dots.reshape(rows, DOWN, -1, ACROSS).swapaxes(1, 2)
        bits = ((cells > 0) * BRAILLE_BITS).sum((2, 3)).tolist()
        for row, drawn in enumerate(map(zip, bits, cells.max((2, 3)).tolist())):
            label, style = labels.get(row, ("", ""))
            blank = ("╌", LIMIT_STYLE) if row in limits else (" ", "")  # some fonts draw circles for Braille's blank
            dotted = (blank if not each else (chr(BRAILLE_BLANK + each), styles[top]) for each, top in drawn)
            axis = (f"{label:>{margin - 2}} ", style), ("┤" if label else "│", "dim")
            plot.append(Text.assemble(*axis, *dotted, no_wrap=True))
        return [*plot, self._time_axis(margin, self.width - margin)]

    def _time_axis(self, margin: int, plot_width: int) -> Text:
        """Draw the axis below, with labels that begin at their times."""
        line = "".join(f" {label} ".ljust(plot_width // 3, "─") for label in ("-30 s", "-20 s", "-10 s"))
        return Text(f"{'└':>{margin}}{line.ljust(plot_width - 4, '─')[: plot_width - 4]} now", "dim")

    def _draw(
        self, dots: NDArray[np.intp], scale: ChartScale, samples: Sequence[DistanceSample], now_s: float, number: int
    ) -> None:
        """Set the dots of a line: every sample, and what joins its figures at the edges of each column of dots.

        Columns are fixed in time, so what was drawn once moves to the left but never changes its shape.
        """
        height, width = dots.shape
        column_s = WINDOW_S / width
        first = math.floor(now_s / column_s) - width + 1
        at_s = np.array([each.at_s for each in samples])
        away_m = np.array([*map(_drawn_m, samples)])
        pauses = np.flatnonzero(np.diff(at_s) > JOIN_S)
        joined_s = np.insert(at_s, pauses + 1, at_s[pauses] + JOIN_S)
        joined_m = np.insert(away_m, pauses + 1, math.nan)
        edges_m = np.interp((first + np.arange(width + 1)) * column_s, joined_s, joined_m, math.nan, math.nan)
        starts_m, ends_m = np.append(edges_m[:-1], away_m), np.append(edges_m[1:], away_m)
        columns = np.append(np.arange(width), np.floor(at_s / column_s) - first)
        is_drawn = np.isfinite(starts_m + ends_m) & (columns >= 0) & (columns < width)
        rows = scale.position(np.sort([starts_m[is_drawn], ends_m[is_drawn]], axis=0) / self.unit.size_m)
        bottoms, tops = np.clip(np.rint(rows * DOWN + (DOWN - 1) / 2).astype(int), 0, height - 1)
        for column, top, bottom in zip(columns[is_drawn].astype(int), tops, bottoms, strict=True):
            dots[top : bottom + 1, column] = number


def _drawn_m(sample: DistanceSample) -> float:
    """Return the distance that is drawn: not a number where there is none."""
    away_m = sample.distance_m
    return away_m if away_m is not None and 0 <= away_m <= MAX_DISTANCE_M else math.nan


class ChartScale(Struct, frozen=True, kw_only=True):
    """A scale over rows of characters, from the middle of the bottom row to that of the top row or near it.

    Attributes:
        low: The figure at the bottom row, in the unit that is shown.
        step: From one label to the next, in the same unit.
    """

    low: float
    step: float
    rows: int
    rows_per_step: int

    def position(self, value: Any) -> Any:
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
    power = math.floor(math.log10((highest - lowest) / steps_max))
    for step in (factor * 10.0**exponent for exponent in (power, power + 1) for factor in (1, 2, 3, 4, 5, 6, 8)):
        low = math.floor(lowest / step + 1e-9) * step
        steps = max(1, math.ceil((highest - low) / step - 1e-9))
        if steps <= steps_max:
            break
    return ChartScale(low=low, step=step, rows=rows, rows_per_step=(rows - 1) // steps)
