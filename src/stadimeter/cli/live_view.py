"""The live view: a run in a terminal, while it runs."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from types import TracebackType
from typing import Self

from rich.console import Console, ConsoleOptions, RenderableType
from rich.live import Live
from rich.text import Text

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.live.snapshot import LiveFeed
from stadimeter.app.live.watching import live_feed
from stadimeter.app.loop import Loop
from stadimeter.cli.formatting import length_unit
from stadimeter.cli.glyphs import ASCII, UNICODE, Glyphs, heading
from stadimeter.cli.keyboard import RunKeys, Shown
from stadimeter.cli.run_panels import (
    Block,
    event_block,
    explanation_lines,
    footer_line,
    header_lines,
    message_line,
    narration_lines,
    note_lines,
    output_blocks,
    rule_blocks,
)
from stadimeter.cli.strip_chart import WINDOW_S
from stadimeter.cli.target_panel import figure_rows, target_lines

# The screen is drawn anew this often at most.
REFRESH_S = 0.1

# Drawing takes at most this share of the time: on a slow computer the screen is drawn less often, and the loop goes
# on as before.
SHARE_MAX = 0.2


class LiveView:
    """Shows a run in a terminal, drawn from the loop's own thread: there is no other.

    Used as a context manager it takes the whole terminal and gives it back at the end. `update` then draws, about ten
    times a second. Without that, `render` may be printed at any time.

    Args:
        feed: Where snapshots of the run come from.
        keys: What keys do; they are attended to after each cycle.
        real_time_s: A monotonic clock of real time, in seconds. Simulated time would draw too often, or too seldom.

    Raises:
        ConfigError: Distances are not shown in that unit.
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
        self._unit = length_unit(unit)
        self._feed = feed
        self._keys = keys
        self._console = console or Console()
        self._real_time_s = real_time_s
        self._live: Live | None = None
        self._draw_at_s = 0.0

    @classmethod
    def of(cls, loop: Loop, title: str, *, unit: str, keys: RunKeys | None) -> Self:
        """Return the view of a run."""
        return cls(title, live_feed(loop), unit=unit, keys=keys)

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

    def update(self, _record: CycleRecord) -> None:
        """Attend to the keys after a cycle, which the feed knows; draw if it is time to."""
        if self._keys is not None:
            self._keys.attend(self._draw)
        started_s = self._real_time_s()
        if started_s < self._draw_at_s:
            return
        self._draw()
        ended_s = self._real_time_s()
        self._draw_at_s = max(started_s + REFRESH_S, ended_s + (ended_s - started_s) * (1 / SHARE_MAX - 1))

    def _draw(self) -> None:
        if self._live is not None:
            self._live.update(self.render(), refresh=True)

    def render(self) -> RenderableType:
        """Return the view as it is now; it fits itself to the console that it is printed on."""
        keys = self._keys
        return LiveScreen(
            shown=Shown(
                snapshot=self._feed.snapshot(WINDOW_S),
                title=self._title,
                unit=self._unit,
                keys=keys.keys if keys is not None else None,
                is_paused=keys is not None and keys.is_paused,
                is_explained=keys is not None and keys.is_explained,
            )
        )


# From this many rows on there is room for the narration and the keys.
FRAMED_HEIGHT = 10

# From this many columns on, targets are on the left and the rest on the right.
WIDE = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveScreen:
    """A snapshot as rich prints it."""

    shown: Shown

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Text]:
        """Yield the lines, exactly as many and as wide as there is room for."""
        glyphs = ASCII if options.ascii_only else UNICODE
        width, height = options.max_width, options.height or console.height
        yield from screen_lines(self.shown, width, height, glyphs)


def screen_lines(shown: Shown, width: int, height: int, glyphs: Glyphs = UNICODE) -> list[Text]:
    """Lay everything out.

    Returns:
        Exactly `height` lines of exactly `width` columns.
    """
    lines = header_lines(shown, width, glyphs)[: max(1, height // 4)]
    footer: list[Text] = []
    if height >= FRAMED_HEIGHT:
        lines += narration_lines(shown, width, glyphs)[: height // 6]
        footer = [footer_line(shown.keys, width, glyphs)] if shown.keys is not None else []
    rows = height - len(lines) - len(footer)
    if shown.is_explained:
        lines += explanation_lines(shown, width, glyphs)[:rows]
    elif shown.snapshot.record is not None:
        body = _wide if width >= WIDE else _narrow
        lines += body(shown, shown.snapshot.record, width, rows, glyphs)
    lines = [*lines, *(Text() for _ in range(height - len(lines) - len(footer))), *footer]
    for line in lines:
        line.no_wrap, line.overflow = True, "crop"
    return [glyphs.fit(line, width) for line in lines[:height]]


def _narrow(shown: Shown, record: CycleRecord, width: int, height: int, glyphs: Glyphs) -> list[Text]:
    """Put everything in one column; what matters most gets its rows first."""
    targets = len(record.decision.tracks)
    rest = _Rest.of(shown, record, width, height, glyphs)
    rules, outputs = len(rest.rules), len(rest.outputs)
    rows = grant_rows(
        height,
        [
            ("targets", targets), ("outputs", min(outputs, 2)), ("rules", min(rules, 3)), ("targets", targets),
            ("events", 1), ("outputs", outputs - 2), ("rules", rules - 3), ("messages", 1),
            ("headings", rest.headings), ("targets", _figure_rows(shown, record, width, glyphs) - 2 * targets),
            ("outputs", rest.loud(rest.outputs) - outputs), ("rules", rest.loud(rest.rules) - rules),
            ("events", rest.newest - 1), ("outputs", rest.full(rest.outputs) - rest.loud(rest.outputs)),
            ("targets", 5), ("rules", rest.full(rest.rules) - rest.loud(rest.rules)), ("events", 1), ("messages", 1),
            ("events", 1), ("targets", 5), ("health", 1 + len(rest.health)), ("targets", height),
        ],
        rest.most(),
    )  # fmt: skip
    return [*_targets(shown, record, width, rows["targets"], glyphs), *rest.lines(rows)]


def _wide(shown: Shown, record: CycleRecord, width: int, height: int, glyphs: Glyphs) -> list[Text]:
    """Put targets on the left, the rest on the right."""
    left_width = width * 11 // 20
    right_width = width - left_width - 2
    rest = _Rest.of(shown, record, right_width, height, glyphs)
    rows = grant_rows(
        height,
        [
            ("outputs", len(rest.outputs)), ("rules", len(rest.rules)), ("events", 1), ("messages", 1),
            ("headings", rest.headings), ("events", 2), ("messages", 1),
            ("rules", rest.full(rest.rules) - len(rest.rules)),
            ("outputs", rest.full(rest.outputs) - len(rest.outputs)),
            ("events", 3), ("messages", 2), ("health", 1 + len(rest.health)), ("messages", 5), ("events", height),
        ],
        rest.most(),
    )  # fmt: skip
    left = _targets(shown, record, left_width, height, glyphs)
    return [
        Text.assemble(glyphs.fit(one, left_width), "  ", glyphs.fit(other, right_width))
        for one, other in zip_longest(left, rest.lines(rows), fillvalue=Text())
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


def _figure_rows(shown: Shown, record: CycleRecord, width: int, glyphs: Glyphs) -> int:
    """Return the rows that all targets take without their charts."""
    return sum(figure_rows(shown, track, width, glyphs) for track in record.decision.tracks)


def _targets(shown: Shown, record: CycleRecord, width: int, rows: int, glyphs: Glyphs) -> list[Text]:
    tracks = record.decision.tracks
    if not tracks or rows <= 0:
        return []
    each, rest = divmod(rows, len(tracks))
    if each == 0:
        lines = [line for track in tracks[:rows] for line in target_lines(shown, track, width, 1, glyphs)]
        return with_more(lines, len(tracks))
    return [
        line
        for number, track in enumerate(tracks)
        for line in target_lines(shown, track, width, each + (number < rest), glyphs)
    ]


# A rule or an output, and all its lines.
_Wrapped = tuple[Block, list[Text]]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rest:
    """Rules, outputs, events, messages and health, before it is known how many rows there are for them."""

    width: int
    glyphs: Glyphs
    rules: Sequence[_Wrapped]
    outputs: Sequence[_Wrapped]
    events: Sequence[list[Text]]
    messages: Sequence[Text]
    health: Sequence[Text]

    @classmethod
    def of(cls, shown: Shown, record: CycleRecord, width: int, height: int, glyphs: Glyphs) -> Self:
        """Put everything into words."""
        unit, started_s = shown.unit, shown.snapshot.started_s
        events, messages = shown.snapshot.events[:height], shown.snapshot.messages[:height]
        rules, outputs = rule_blocks(record, unit, glyphs), output_blocks(record, unit, width, glyphs)
        return cls(
            width=width,
            glyphs=glyphs,
            rules=[(block, block.lines(width, glyphs)) for block in rules],
            outputs=[(block, block.lines(width, glyphs)) for block in outputs],
            events=[glyphs.hang(*event_block(event, started_s, unit, glyphs), width) for event in events],
            messages=[message_line(at_s, sent, started_s, glyphs) for at_s, sent in messages],
            health=note_lines(shown.snapshot.health.notes, glyphs),
        )

    @property
    def headings(self) -> int:
        return 4 if self.messages else 3

    @staticmethod
    def full(blocks: Sequence[_Wrapped]) -> int:
        """Return the rows of blocks with all their words."""
        return sum(len(lines) for _, lines in blocks)

    @staticmethod
    def loud(blocks: Sequence[_Wrapped]) -> int:
        """Return their rows when those that are quiet have no more than one line."""
        return sum(1 if block.is_quiet else len(lines) for block, lines in blocks)

    @property
    def newest(self) -> int:
        """The rows of the newest event."""
        return len(self.events[0]) if self.events else 1

    def most(self) -> dict[str, int]:
        """Return how many rows each section can fill; health with its heading, for it comes with one or not at all."""
        of_rules, of_outputs = self.full(self.rules), self.full(self.outputs)
        health = 1 + len(self.health)
        return {"rules": of_rules, "outputs": of_outputs, "messages": len(self.messages), "health": health}

    def lines(self, rows: Counter[str]) -> list[Text]:
        """Return what fits into the rows, under headings if there is room for these."""
        sections = {
            "rules": self._blocks(self.rules, rows["rules"]),
            "outputs": self._blocks(self.outputs, rows["outputs"]),
            "events": self._newest(rows["events"]),
            **({"messages": list(self.messages[: rows["messages"]])} if self.messages else {}),
            **({"health": list(self.health[: rows["health"] - 1])} if rows["health"] > 1 else {}),
        }
        return [
            line
            for name, section in sections.items()
            for line in ([heading(name, self.width, self.glyphs), *section] if rows["headings"] else section)
        ]

    def _blocks(self, blocks: Sequence[_Wrapped], rows: int) -> list[Text]:
        """Return every block on a line at least; with all its words as long as there are rows, those that act first."""
        by_need = sorted(range(len(blocks)), key=lambda number: blocks[number][0].is_quiet)
        if rows < len(blocks):
            return with_more([blocks[number][0].joined() for number in by_need[:rows]], len(blocks))
        shown: dict[int, list[Text]] = {}
        free = rows - len(blocks)
        for number in by_need:
            block, whole = blocks[number]
            if block.is_quiet and len(whole) > 1 + free:
                whole = [block.figures]
            shown[number] = self._cut(whole, 1 + free)
            free -= len(shown[number]) - 1
        return [line for number in range(len(blocks)) for line in shown[number]]

    def _newest(self, rows: int) -> list[Text]:
        """Return as many events as there are rows for."""
        lines: list[Text] = []
        for event in self.events:
            lines += self._cut(event, rows - len(lines))
        return lines

    def _cut(self, lines: list[Text], rows: int) -> list[Text]:
        """Return lines as far as there are rows; the last one shows that there would be more."""
        if 0 < rows < len(lines):
            lines[rows - 1].append(" " * self.width)
        return lines[:rows]


def with_more(lines: list[Text], count: int) -> list[Text]:
    """Write into the last line how many more there are, if not all are shown."""
    if lines and len(lines) < count:
        lines[-1] = Text(f" and {count - len(lines) + 1} more", "italic dim")
    return lines
