"""Where everything goes: the live view laid out for the terminal that there is, from 20x5 upwards."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest

from rich.console import Console, ConsoleOptions
from rich.text import Text

from stadimeter.app.cycle_record import CycleRecord
from stadimeter.cli.glyphs import ASCII, UNICODE, Glyphs
from stadimeter.cli.run_panels import event_line, header_lines, message_line, output_blocks, rule_blocks
from stadimeter.cli.snapshot import Snapshot, heading
from stadimeter.cli.target_panel import target_lines
from stadimeter.core.decision import RuleStatus

WIDE = 100
"""From this many columns on, targets are on the left and the rest on the right."""

JOINED_WIDTH = 76
"""From this many columns on, the figures of a rule or output and the reason behind them share a line."""

Block = tuple[Text, Text]


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveScreen:
    """A snapshot as rich prints it.

    Attributes:
        snapshot: What is shown.
    """

    snapshot: Snapshot

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Text]:
        """Yield the lines, exactly as many and as wide as there is room for."""
        glyphs = ASCII if options.ascii_only else UNICODE
        width, height = options.max_width, options.height or console.height
        yield from screen_lines(self.snapshot, width, height, glyphs)


def screen_lines(snapshot: Snapshot, width: int, height: int, glyphs: Glyphs = UNICODE) -> list[Text]:
    """Lay everything out.

    Args:
        snapshot: What is shown.
        width: How many columns there are.
        height: How many rows there are.
        glyphs: The characters to draw with.

    Returns:
        Exactly `height` lines of exactly `width` columns.
    """
    lines = header_lines(snapshot, width, glyphs)[: max(1, height // 4)]
    if snapshot.record is not None:
        body = _wide if width >= WIDE else _narrow
        lines += body(snapshot, snapshot.record, width, height - len(lines), glyphs)
    lines += [Text() for _ in range(height - len(lines))]
    for line in lines:
        line.no_wrap, line.overflow = True, "crop"
    return [glyphs.fit(line, width) for line in lines[:height]]


def _narrow(snapshot: Snapshot, record: CycleRecord, width: int, height: int, glyphs: Glyphs) -> list[Text]:
    """Put everything in one column; what matters most gets its rows first."""
    targets, rules, outputs = _counts(record)
    headings = 4 if snapshot.messages else 3
    second = 0 if width >= JOINED_WIDTH else 1
    rows = grant_rows(
        height,
        [
            ("targets", targets), ("outputs", min(outputs, 2)), ("rules", min(rules, 3)), ("targets", targets),
            ("events", 1), ("outputs", outputs), ("rules", rules), ("headings", headings), ("events", 2),
            ("targets", 7), ("messages", 1), ("events", 1), ("outputs", second * outputs), ("rules", second * rules),
            ("targets", height),
        ],
        {"outputs": outputs * (1 + second), "rules": rules * (1 + second), "messages": len(snapshot.messages)},
    )  # fmt: skip
    return [*_targets(snapshot, record, width, rows["targets"], glyphs), *_rest(snapshot, record, width, rows, glyphs)]


def _wide(snapshot: Snapshot, record: CycleRecord, width: int, height: int, glyphs: Glyphs) -> list[Text]:
    """Put targets on the left, the rest on the right."""
    _, rules, outputs = _counts(record)
    headings = 4 if snapshot.messages else 3
    left_width = width * 11 // 20
    right_width = width - left_width - 2
    second = 0 if right_width >= JOINED_WIDTH else 1
    rows = grant_rows(
        height,
        [
            ("outputs", outputs), ("rules", rules), ("events", 1), ("headings", headings), ("events", 3),
            ("messages", 2), ("rules", second * rules), ("outputs", second * outputs), ("events", 3), ("messages", 7),
            ("events", height),
        ],
        {"outputs": outputs * (1 + second), "rules": rules * (1 + second), "messages": len(snapshot.messages)},
    )  # fmt: skip
    left = _targets(snapshot, record, left_width, height, glyphs)
    right = _rest(snapshot, record, right_width, rows, glyphs)
    return [
        Text.assemble(glyphs.fit(one, left_width), "  ", glyphs.fit(other, right_width))
        for one, other in zip_longest(left, right, fillvalue=Text())
    ]


def grant_rows(free: int, claims: Sequence[tuple[str, int]], most: dict[str, int]) -> Counter[str]:
    """Share rows out.

    Args:
        free: How many rows there are.
        claims: Who wants how many more, the most important claim first.
        most: Nobody named here gets more than this in all.

    Returns:
        How many rows each got. Headings come all together or not at all.
    """
    rows: Counter[str] = Counter()
    for name, wanted in claims:
        granted = int(max(0, min(free, wanted, most.get(name, math.inf) - rows[name])))
        if name == "headings" and granted < wanted:
            continue
        rows[name] += granted
        free -= granted
    return rows


def _counts(record: CycleRecord) -> tuple[int, int, int]:
    decision = record.decision
    return len(decision.tracks), len(decision.rules), len(decision.commands)


def _targets(snapshot: Snapshot, record: CycleRecord, width: int, rows: int, glyphs: Glyphs) -> list[Text]:
    tracks = record.decision.tracks
    if not tracks or rows <= 0:
        return []
    each, rest = divmod(rows, len(tracks))
    if each == 0:
        lines = [line for track in tracks[:rows] for line in target_lines(snapshot, track, width, 1, glyphs)]
        return with_more(lines, len(tracks))
    return [
        line
        for number, track in enumerate(tracks)
        for line in target_lines(snapshot, track, width, each + (number < rest), glyphs)
    ]


def _rest(snapshot: Snapshot, record: CycleRecord, width: int, rows: Counter[str], glyphs: Glyphs) -> list[Text]:
    """Return rules, outputs, events and messages, under their headings if there is room for these."""
    blocks = rule_blocks(record, glyphs)
    if rows["rules"] < len(blocks):  # what does something comes first when not all can be shown
        is_idle = [trace.status is RuleStatus.IDLE for trace in record.decision.rules]
        blocks = [block for _, block in sorted(zip(is_idle, blocks, strict=True), key=lambda pair: pair[0])]
    sections = {
        "rules": _stacked(blocks, rows["rules"], 5),
        "outputs": _stacked(output_blocks(record, snapshot.unit, width, glyphs), rows["outputs"], 3),
        "events": [event_line(event, snapshot.started_s, glyphs) for event in snapshot.events][: rows["events"]],
    }
    if snapshot.messages:
        newest = snapshot.messages[: rows["messages"]]
        sections["messages"] = [message_line(at_s, sent, snapshot.started_s, glyphs) for at_s, sent in newest]
    return [
        line
        for name, section in sections.items()
        for line in ([heading(name, width, glyphs), *section] if rows["headings"] else section)
    ]


def _stacked(blocks: Sequence[Block], rows: int, indent: int) -> list[Text]:
    """Return blocks as two lines each if there are rows for all of them, else as one."""
    if rows >= 2 * len(blocks):
        return [line for first, second in blocks for line in (first, Text(" " * indent).append_text(second))]
    return with_more([Text.assemble(first, "  ", second) for first, second in blocks[:rows]], len(blocks))


def with_more(lines: list[Text], count: int) -> list[Text]:
    """Say in the last line how many there are that are not shown, if any."""
    if lines and len(lines) < count:
        lines[-1] = Text(f" and {count - len(lines) + 1} more", "italic dim")
    return lines
