"""The parts of the live view that are not about one target: the top line, rules, outputs, events and messages."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

from rich.text import Text

from stadimeter.app.cycle_record import CycleRecord
from stadimeter.cli.formatting import LengthUnit, format_age, format_level, format_speed, format_time, format_turn
from stadimeter.cli.glyphs import Glyphs
from stadimeter.cli.run_history import Snapshot
from stadimeter.core.command import Command, LevelCommand, TwistCommand
from stadimeter.core.decision import Decision, Event, OutputTrace, RuleStatus, RuleTrace, SafetyMode, Severity
from stadimeter.core.message import Message
from stadimeter.core.rules.explaining import explain
from stadimeter.core.rules.reasons import Reasons

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
}
SEVERITY_STYLES = {
    Severity.INFO: "bold",
    Severity.WARNING: "yellow",
    Severity.ALARM: "red",
    Severity.SAFETY: "bold magenta",
}
NAMES_WIDTH_MAX = 16
"""Names longer than this are cut, so that what comes behind them stays in sight."""

PROGRAMS_ONLY = frozenset({"v", "ts", "seq", "id", "since"})
"""Keys of a message that a person does not look at."""

FRAMES_WIDTH = 56
"""From this many columns on the top line has room for what is known of the frames."""


def header_lines(snapshot: Snapshot, width: int, glyphs: Glyphs) -> list[Text]:
    """Return the top line: what runs, whether outputs may act, how fresh the frames are; below it, what is wrong."""
    record = snapshot.record
    if record is None:
        return [glyphs.fit(Text.assemble((f" {glyphs.words(snapshot.title)} ", "bold"), " waiting for a frame"), width)]
    mode = record.decision.safety
    badge = Text(f" {mode.value.upper()} ", SAFETY_STYLES[mode])
    age = "no frame" if snapshot.frame_age_s is None else f"age {format_age(snapshot.frame_age_s)}"
    now = format_time(record.observation.now_s - snapshot.started_s)
    frames = f"{snapshot.frame_rate_hz:.1f} fps  {age}  " if width >= FRAMES_WIDTH else ""
    right = Text.assemble(badge, f"  {frames}", (f"{now} ", "bold"))
    left = glyphs.fit(Text(f" {glyphs.words(snapshot.title)}", "bold"), max(0, width - right.cell_len - 1))
    return [
        glyphs.fit(Text.assemble(left, " ", right), width),
        *(glyphs.fit(Text(f" ! {glyphs.words(words)}", "yellow"), width) for words in _warnings(snapshot, record)),
    ]


def _warnings(snapshot: Snapshot, record: CycleRecord) -> list[str]:
    warnings = [record.decision.safety_reason]
    fault = record.observation.camera_fault
    if record.decision.safety is not SafetyMode.ACTIVE and fault not in snapshot.trouble:
        warnings.append(
            fault
        )  # a slow camera has nothing new in many a cycle; that is worth saying only if it stops us
    return [words for words in (*warnings, snapshot.trouble) if words]


def rule_blocks(record: CycleRecord, glyphs: Glyphs) -> list[tuple[Text, Text]]:
    """Return what each rule does, and why, as two lines each that may be joined."""
    names = _column([trace.rule for trace in record.decision.rules])
    outputs = _column([_drives(trace, record.decision.outputs)[0] for trace in record.decision.rules], 28)
    return [_rule_block(trace, record, glyphs, names, outputs) for trace in record.decision.rules]


def _rule_block(
    trace: RuleTrace, record: CycleRecord, glyphs: Glyphs, name_width: int, output_width: int
) -> tuple[Text, Text]:
    style = RULE_STYLES[trace.status]
    drives, drives_style = _drives(trace, record.decision.outputs)
    dot = glyphs.dots[list(RuleStatus).index(trace.status)]
    return Text.assemble(
        (f" {dot} ", style),
        glyphs.fit(Text(glyphs.words(trace.rule), "bold"), name_width),
        (f"  {trace.status.value:<8}{' ' if trace.acknowledged else '!'} ", style),
        glyphs.fit(Text(glyphs.words(drives), drives_style), output_width),
    ), Text(glyphs.words(why(record.decision, trace.rule)), "dim" if trace.status is RuleStatus.IDLE else "")


def why(decision: Decision, rule: str) -> str:
    """Return why a rule does what it does, as ``stadimeter explain``; the reason alone if read from a file."""
    if isinstance(decision.reasons, Reasons):
        return explain(decision, rule).sentence
    return decision.reasons.get(rule, "")


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


def output_blocks(record: CycleRecord, unit: LengthUnit, width: int, glyphs: Glyphs) -> list[tuple[Text, Text]]:
    """Return what each output does, and who commands it, as two lines each that may be joined."""
    applied = {command.output: command for command in record.applied}
    faults = {fault.output: fault.reason for fault in record.observation.output_faults}
    traces = {trace.output: trace for trace in record.decision.outputs}
    names = _column([command.output for command in record.decision.commands])
    blocks = []
    for command in record.decision.commands:
        name = glyphs.fit(Text(glyphs.words(command.output), "bold"), names)
        shown = applied.get(command.output)
        value = _value(shown, unit, max(6, min(20, width // 4)), glyphs) if shown else _broken()
        who = _who(traces.get(command.output), record.decision.reasons, glyphs)
        if command.output in faults:
            who = Text(glyphs.words(faults[command.output]), "bold red")
        elif shown and (asked := _difference(command, shown)):
            who = Text.assemble((f"asked for {asked}, ", "yellow"), who)
        blocks.append((Text.assemble(" ", name, "  ", value), who))
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


def _who(trace: OutputTrace | None, reasons: Mapping[str, str], glyphs: Glyphs) -> Text:
    if trace is None:
        return Text()
    line = Text()
    if trace.winner == "safe":
        line.append("safe value", "dim")
    else:
        line.append("by ", "dim").append(glyphs.words(trace.winner), "yellow" if trace.winner == "safety" else "green")
    if trace.losers:
        line.append(glyphs.words(f" over {', '.join(trace.losers)}"), "yellow")
    reason = trace.reason or reasons.get(trace.winner, "")
    return line.append(glyphs.words(f": {reason}") if reason else "", "dim")


def _difference(asked: Command, applied: Command) -> str:
    """Return what was asked for if the driver did something clearly different; rounding to its own steps is not."""
    if isinstance(asked, LevelCommand) and isinstance(applied, LevelCommand):
        return format_level(asked.level) if abs(asked.level - applied.level) > 0.015 else ""
    if isinstance(asked, TwistCommand) and isinstance(applied, TwistCommand):
        away = max(abs(asked.linear_mps - applied.linear_mps), abs(asked.angular_radps - applied.angular_radps) / 4)
        return f"{format_speed(asked.linear_mps)} {format_turn(asked.angular_radps)}" if away > 0.02 else ""
    return ""


def event_line(event: Event, started_s: float, glyphs: Glyphs) -> Text:
    """Return one event: when, what, to whom, why."""
    what = f"{event.source} {event.kind.value.replace('_', ' ')}"
    return Text.assemble(
        (f"{format_time(event.at_s - started_s):>8}  ", "dim"),
        (glyphs.words(what), SEVERITY_STYLES[event.severity]),
        glyphs.words(f": {event.reason}") if event.reason else "",
    )


def message_line(at_s: float, message: Message, started_s: float, glyphs: Glyphs) -> Text:
    """Return one message: when, to which topic, and what."""
    return Text.assemble(
        (f"{format_time(at_s - started_s):>8}  ", "dim"),
        (glyphs.words(message.topic), "bright_cyan"),
        (glyphs.words(f"  {_essence(message.payload)}"), "dim"),
    )


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
