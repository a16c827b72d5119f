"""The parts of the live view that are not about one target: the top line, rules, outputs, events and messages."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Sequence

from msgspec import Struct
from rich.text import Text

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.live.health import Note
from stadimeter.app.live.snapshot import why
from stadimeter.cli.formatting import (
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
from stadimeter.cli.strip_chart import StripChart
from stadimeter.core.command import Command, LevelCommand, TwistCommand
from stadimeter.core.decision import Event, OutputTrace, RuleStatus, RuleTrace, SafetyMode, Severity
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.message import Message
from stadimeter.core.words import one_line

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
