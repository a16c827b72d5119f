"""The live view: a run in a terminal, while it runs."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from types import TracebackType
from typing import Self

from rich.console import Console, ConsoleOptions, RenderableType
from rich.live import Live
from rich.text import Text

from stadimeter.app.cycle_record import CycleRecord
from stadimeter.cli.formatting import length_unit
from stadimeter.cli.glyphs import ASCII, UNICODE, Glyphs, heading
from stadimeter.cli.run_history import LookedAt, RunHistory, Snapshot
from stadimeter.cli.run_panels import event_line, header_lines, message_line, output_blocks, rule_blocks
from stadimeter.cli.target_panel import target_lines
from stadimeter.core.decision import RuleStatus
from stadimeter.core.message import Message

REFRESH_S = 0.1
"""The screen is drawn anew this often at most."""

SHARE_MAX = 0.2
"""Drawing takes at most this share of the time: on a slow computer the screen is drawn less often, and the loop goes
on as before."""


class LiveView:
    """Shows a run in a terminal, drawn from the loop's own thread: there is no other.

    Used as a context manager it takes the whole terminal and gives it back at the end. `update` then draws, about ten
    times a second. Without that, `render` may be printed at any time.

    Args:
        trouble: Says what is wrong outside the loop, such as with the broker; an empty string if nothing.
        messages: Returns what was sent to other programs and when, newest first.
        limits_m: Distances to mark in the chart of each target, such as those of its rules.
        real_time_s: A monotonic clock of real time, in seconds. Simulated time would draw too often, or too seldom.

    Raises:
        ConfigError: Distances are not shown in that unit.
    """

    def __init__(
        self,
        title: str,
        *,
        unit: str = "m",
        trouble: Callable[[], str] = str,
        messages: Callable[[], Sequence[tuple[float, Message]]] = tuple,
        limits_m: Mapping[str, Sequence[float]] | None = None,
        console: Console | None = None,
        real_time_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._title = title
        self._unit = length_unit(unit)
        self._trouble = trouble
        self._messages = messages
        self._limits_m = dict(limits_m or {})
        self._console = console or Console()
        self._real_time_s = real_time_s
        self._history = RunHistory()
        self._looked_at = LookedAt()
        self._record: CycleRecord | None = None
        self._live: Live | None = None
        self._draw_at_s = 0.0

    def __enter__(self) -> Self:
        """Take the terminal."""
        self._live = Live(self.render(), console=self._console, screen=True, auto_refresh=False)
        self._live.start(refresh=True)
        self._draw_at_s = self._real_time_s()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give the terminal back as it was."""
        if self._live is not None:
            self._live.stop()
        self._live = None

    def update(self, record: CycleRecord) -> None:
        """Take note of a cycle; draw if it is time to."""
        self._record = record
        self._history.add(record)
        self._looked_at.add(record)
        started_s = self._real_time_s()
        if self._live is None or started_s < self._draw_at_s:
            return
        self._live.update(self.render(), refresh=True)
        ended_s = self._real_time_s()
        self._draw_at_s = max(started_s + REFRESH_S, ended_s + (ended_s - started_s) * (1 / SHARE_MAX - 1))

    def render(self) -> RenderableType:
        """Return the view as it is now; it fits itself to the console that it is printed on."""
        history = self._history
        return LiveScreen(
            snapshot=Snapshot(
                title=self._title,
                unit=self._unit,
                record=self._record,
                started_s=history.started_s,
                frame_rate_hz=history.frame_rate_hz,
                frame_age_s=history.frame_age_s,
                tilts_rad=history.tilts_rad,
                looked_at=self._looked_at.by_target,
                samples={target: tuple(samples) for target, samples in history.samples.items()},
                events=tuple(history.events),
                messages=self._messages(),
                limits_m=self._limits_m,
                trouble=self._trouble(),
            )
        )


WIDE = 100
"""From this many columns on, targets are on the left and the rest on the right."""

JOINED_WIDTH = 76
"""From this many columns on, the figures of a rule or output and the reason behind them share a line."""

Block = tuple[Text, Text]


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveScreen:
    """A snapshot as rich prints it."""

    snapshot: Snapshot

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Text]:
        """Yield the lines, exactly as many and as wide as there is room for."""
        glyphs = ASCII if options.ascii_only else UNICODE
        width, height = options.max_width, options.height or console.height
        yield from screen_lines(self.snapshot, width, height, glyphs)


def screen_lines(snapshot: Snapshot, width: int, height: int, glyphs: Glyphs = UNICODE) -> list[Text]:
    """Lay everything out.

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
    """Share rows out, the most important claim first, up to ``most``. Headings come all together or not at all."""
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
    """Write into the last line how many more there are, if not all are shown."""
    if lines and len(lines) < count:
        lines[-1] = Text(f" and {count - len(lines) + 1} more", "italic dim")
    return lines
