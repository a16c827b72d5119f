"""The parts of the live view that are not about one target: the top line, rules, outputs, events and messages."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

from rich.text import Text

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.live.health import LiveHealth, Note
from stadimeter.app.live.snapshot import why
from stadimeter.cli.formatting import (
    LengthUnit,
    format_age,
    format_level,
    format_speed,
    format_time,
    format_turn,
    in_unit,
)
from stadimeter.cli.glyphs import Glyphs
from stadimeter.cli.keyboard import Key, Shown
from stadimeter.core.command import Command, LevelCommand, TwistCommand
from stadimeter.core.decision import Event, OutputTrace, RuleStatus, RuleTrace, SafetyMode, Severity
from stadimeter.core.message import Message

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
SAFETY_STYLES = {
    SafetyMode.STARTING: "bold black on yellow",
    SafetyMode.ACTIVE: "bold black on green",
    SafetyMode.STALE: "bold white on red",
    SafetyMode.STOPPED: "bold white on red",
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
    ("ACTIVE", "outputs may act: frames are fresh; STARTING, STALE, STOPPED: outputs are at their safe values"),
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


def header_lines(shown: Shown, width: int, glyphs: Glyphs) -> list[Text]:
    """Return the top line: what runs, whether outputs may act, how fresh the frames are; below it, what is wrong."""
    snapshot, health = shown.snapshot, shown.snapshot.health
    record = snapshot.record
    if record is None:
        return [glyphs.fit(Text.assemble((f" {glyphs.words(shown.title)} ", "bold"), " waiting for a frame"), width)]
    mode = record.decision.safety
    badge = Text(" PAUSED ", PAUSED_STYLE) if shown.is_paused else Text(f" {mode.value.upper()} ", SAFETY_STYLES[mode])
    age = "no frame" if health.frame_age_s is None else f"age {format_age(health.frame_age_s)}"
    now = format_time(record.observation.now_s - snapshot.started_s)
    frames = f"{health.frame_rate_hz:.1f} fps  {age}  " if width >= FRAMES_WIDTH else ""
    right = Text.assemble(badge, f"  {frames}", (f"{now} ", "bold"))
    left = glyphs.fit(Text(f" {glyphs.words(shown.title)}", "bold"), max(0, width - right.cell_len - 1))
    return [
        glyphs.fit(Text.assemble(left, " ", right), width),
        *(line for words in _warnings(health, record) for line in _warning(in_unit(words, shown.unit), width, glyphs)),
    ]


def _warning(words: str, width: int, glyphs: Glyphs) -> list[Text]:
    return glyphs.hang(Text(" ! ", "yellow"), Text(glyphs.words(words), "yellow"), width)


def narration_lines(shown: Shown, width: int, glyphs: Glyphs) -> list[Text]:
    """Return what happens in a simulated world."""
    words = glyphs.words(in_unit(shown.snapshot.narration, shown.unit))
    return glyphs.hang(Text(" "), Text(words, "bold bright_cyan"), width) if words else []


def footer_line(keys: Sequence[Key], width: int, glyphs: Glyphs) -> Text:
    """Return the keys that there is room for, with what each would do now."""
    line = Text()
    for key in keys or (CTRL_C,):
        hint = Text.assemble(" ", (key.name, "bold reverse"), f" {glyphs.words(key.words)} ")
        if line.cell_len + hint.cell_len > width:
            break
        line.append_text(hint)
    return line


def explanation_lines(shown: Shown, width: int, glyphs: Glyphs) -> list[Text]:
    """Return what the keys do and what the screen shows, in place of it."""
    keys = [(key.name, f"{key.does}; again: {key.undoes}" if key.undoes else key.does) for key in shown.keys or ()]
    states = "  ".join(f"{dot} {status.value}" for dot, status in zip(glyphs.dots, RuleStatus, strict=True))
    rows = [*keys, ("Ctrl-C", "stop every output at once, and quit"), *SCREEN, ("states", states)]
    return [
        line
        for name, words in rows
        for line in glyphs.hang(Text(f" {name:<9} ", "bold"), Text(glyphs.words(words)), width)
    ]


def _warnings(health: LiveHealth, record: CycleRecord) -> list[str]:
    warnings = [record.decision.safety_reason]
    fault = record.observation.camera_fault
    if record.decision.safety is not SafetyMode.ACTIVE and fault not in health.trouble:
        warnings.append(
            fault
        )  # a slow camera has nothing new in many a cycle; that is worth saying only if it stops us
    return [words for words in (*warnings, *health.warnings) if words]


@dataclass(frozen=True, slots=True)
class Block:
    """A rule or an output: its figures, and the words behind them, which take further lines if they are long.

    Attributes:
        is_quiet: Whether the words may be left away where there is no room for all.
    """

    figures: Text
    words: Text
    is_quiet: bool = False

    def lines(self, width: int, glyphs: Glyphs) -> list[Text]:
        """Return all of it: the words behind the figures if there is room for them, else below."""
        beside = Text.assemble(self.figures, "  ")
        if beside.cell_len + self.words.cell_len > width and width < JOINED_WIDTH:
            return [self.figures, *glyphs.hang(Text(" " * BELOW), self.words, width)]
        return glyphs.hang(beside, self.words, width)

    def joined(self) -> Text:
        """Return it as one line, however long."""
        return Text.assemble(self.figures, "  ", self.words)


# From this many columns on, words that take several lines stand behind the figures; in fewer, below.
JOINED_WIDTH = 76

# Words below figures begin with this many spaces.
BELOW = 5


def rule_blocks(record: CycleRecord, unit: LengthUnit, glyphs: Glyphs) -> list[Block]:
    """Return what each rule does, and why."""
    names = _column([trace.rule for trace in record.decision.rules])
    outputs = _column([_drives(trace, record.decision.outputs)[0] for trace in record.decision.rules], 28)
    return [_rule_block(trace, record, unit, glyphs, names, outputs) for trace in record.decision.rules]


def _rule_block(
    trace: RuleTrace, record: CycleRecord, unit: LengthUnit, glyphs: Glyphs, name_width: int, output_width: int
) -> Block:
    style = RULE_STYLES[trace.status]
    drives, drives_style = _drives(trace, record.decision.outputs)
    dot = glyphs.dots[list(RuleStatus).index(trace.status)]
    words = why(record.decision, trace.rule)
    for said in (f"{trace.status.value}: ", f"; it commands '{trace.output}'"):  # which the figures show
        words = words.removeprefix(said).removesuffix(said)
    return Block(
        Text.assemble(
            (f" {dot} ", style),
            glyphs.fit(Text(glyphs.words(trace.rule), "bold"), name_width),
            (f"  {trace.status.value:<8}{' ' if trace.acknowledged else '!'} ", style),
            glyphs.fit(Text(glyphs.words(drives), drives_style), output_width),
        ),
        Text(glyphs.words(in_unit(words, unit)), "dim" if trace.status is RuleStatus.IDLE else ""),
        is_quiet=trace.status in {RuleStatus.IDLE, RuleStatus.UNKNOWN},
    )


def _drives(trace: RuleTrace, outputs: Sequence[OutputTrace]) -> tuple[str, str]:
    """Return the part of a rule in its output, or what inhibits it, and a style."""
    if trace.gates:
        return ", ".join(trace.gates), "yellow"
    if trace.output is None:
        return "alert only", "dim"
    output = next((output for output in outputs if output.output == trace.output), None)
    if output is not None and output.winner == trace.rule:
        return f"→ {trace.output}", "green"
    if output is not None and trace.rule in output.losers:
        return f"× {trace.output} overruled", "yellow"
    return f"· {trace.output}", "dim"


def output_blocks(record: CycleRecord, unit: LengthUnit, width: int, glyphs: Glyphs) -> list[Block]:
    """Return what each output does, and who commands it. The reason of a rule stands beside that rule."""
    applied = {command.output: command for command in record.applied}
    faults = {fault.output: fault.reason for fault in record.observation.output_faults}
    traces = {trace.output: trace for trace in record.decision.outputs}
    names = _column([command.output for command in record.decision.commands])
    blocks = []
    for command in record.decision.commands:
        name = glyphs.fit(Text(glyphs.words(command.output), "bold"), names)
        shown = applied.get(command.output)
        value = _value(shown, unit, max(6, min(20, width // 4)), glyphs) if shown else _broken()
        who = _who(traces.get(command.output), glyphs)
        if command.output in faults:
            who = Text(glyphs.words(faults[command.output]), "bold red")
        elif shown and (asked := _difference(command, shown, unit)):
            who = Text.assemble((f"asked for {asked}, ", "yellow"), who)
        rests = command.output not in faults and getattr(traces.get(command.output), "winner", "") == "safe"
        blocks.append(Block(Text.assemble(" ", name, "  ", value), who, is_quiet=rests))
    return blocks


def _broken() -> Text:
    return Text("out of order", "bold red")


def _value(command: Command, unit: LengthUnit, width: int, glyphs: Glyphs) -> Text:
    if isinstance(command, LevelCommand):
        return _bar(command, width, glyphs)
    return _twist(command, unit, glyphs)


def _bar(command: LevelCommand, width: int, glyphs: Glyphs) -> Text:
    full = round(command.level * width)
    if command.level > 0:
        full = max(1, full)
    return Text.assemble(
        (glyphs.bar * full, "bold bright_cyan"),
        (glyphs.bar_rest * (width - full), "dim"),
        f" {format_level(command.level):>5}",
    )


def _twist(command: TwistCommand, unit: LengthUnit, glyphs: Glyphs) -> Text:
    speed, turn = command.linear_mps, command.angular_radps
    along = glyphs.forwards if speed > 0 else glyphs.backwards if speed < 0 else glyphs.standing
    round_about = glyphs.turns_left if turn > 0 else glyphs.turns_right if turn < 0 else " "
    style = "bold bright_cyan" if speed or turn else "dim"
    return Text.assemble(
        (along, style), f" {format_speed(speed, None, unit):>9} ", (round_about, style), f" {format_turn(turn):>11}"
    )


def _who(trace: OutputTrace | None, glyphs: Glyphs) -> Text:
    if trace is None:
        return Text()
    line = Text()
    if trace.winner == "safe":
        line.append("safe value", "dim")
    else:
        line.append("by ", "dim").append(glyphs.words(trace.winner), "yellow" if trace.winner == "safety" else "green")
    if trace.losers:
        line.append(glyphs.words(f" over {', '.join(trace.losers)}"), "yellow")
    return line.append(glyphs.words(f": {trace.reason}") if trace.reason else "", "dim")


def _difference(asked: Command, applied: Command, unit: LengthUnit) -> str:
    """Return what was asked for if the driver did something clearly different; rounding to its own steps is not."""
    if isinstance(asked, LevelCommand) and isinstance(applied, LevelCommand):
        return format_level(asked.level) if abs(asked.level - applied.level) > 0.015 else ""
    if isinstance(asked, TwistCommand) and isinstance(applied, TwistCommand):
        away = max(abs(asked.linear_mps - applied.linear_mps), abs(asked.angular_radps - applied.angular_radps) / 4)
        return f"{format_speed(asked.linear_mps, None, unit)} {format_turn(asked.angular_radps)}" if away > 0.02 else ""
    return ""


def event_block(event: Event, started_s: float, unit: LengthUnit, glyphs: Glyphs) -> tuple[Text, Text]:
    """Return one event: when, and what happened to whom and why."""
    what = f"{event.source} {event.kind.value.replace('_', ' ')}"
    return Text(f"{format_time(event.at_s - started_s):>8}  ", "dim"), Text.assemble(
        (glyphs.words(what), SEVERITY_STYLES[event.severity]),
        glyphs.words(f": {in_unit(event.reason, unit)}") if event.reason else "",
    )


def message_line(at_s: float, message: Message, started_s: float, glyphs: Glyphs) -> Text:
    """Return one message: when, to which topic, and what."""
    return Text.assemble(
        (f"{format_time(at_s - started_s):>8}  ", "dim"),
        (glyphs.words(message.topic), "bright_cyan"),
        (glyphs.words(f"  {_essence(message.payload)}"), "dim"),
    )


def note_lines(notes: Sequence[Note], glyphs: Glyphs) -> list[Text]:
    """Return the run's health, a line for each thing."""
    column = _column([note.what for note in notes])
    return [
        Text.assemble(
            (f" {note.what:<{column}}  ", "dim"), (glyphs.words(note.words), "" if note.is_good else "yellow")
        )
        for note in notes
    ]


def _essence(payload: str) -> str:
    """Return what a JSON object says, without what is only of use to programs; other text as it is."""
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
    return min(width_max, max((len(name) for name in names), default=0))
