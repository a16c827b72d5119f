"""The live view: a run in a terminal, while it runs."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import zip_longest
from types import TracebackType
from typing import Self

from msgspec import Struct
from rich.console import Console, ConsoleOptions, RenderableType
from rich.live import Live
from rich.text import Text

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.live.snapshot import LiveFeed
from stadimeter.app.loop import Loop
from stadimeter.app.watching import live_feed
from stadimeter.cli.formatting import length_unit
from stadimeter.cli.keyboard import RunKeys, Shown
from stadimeter.cli.layout import fit, heading
from stadimeter.cli.run_panels import (
    WINDOW_S,
    Block,
    event_lines,
    explanation_lines,
    figure_rows,
    footer_line,
    header_lines,
    message_line,
    narration_lines,
    note_lines,
    output_blocks,
    rule_blocks,
    target_lines,
)

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
            Shown(
                snapshot=self._feed.snapshot(WINDOW_S),
                title=self._title,
                unit=self._unit,
                keys=keys.keys if keys is not None else None,
                is_paused=keys is not None and keys.is_paused,
                is_explained=keys is not None and keys.is_explained,
            )
        )


def live_view_of(loop: Loop, title: str, unit: str, keys: RunKeys | None = None) -> LiveView:
    """Return the live view of a run, not shown yet; `unit` is that of distances."""
    return LiveView(title, live_feed(loop), unit=unit, keys=keys)


# From this many rows on there is room for the narration and the keys.
FRAMED_HEIGHT = 10

# From this many columns on, targets are on the left and the rest on the right.
WIDE = 100


class LiveScreen(Struct, frozen=True):
    """A snapshot as rich prints it."""

    shown: Shown

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Text]:
        """Yield the lines, exactly as many and as wide as there is room for."""
        yield from screen_lines(self.shown, options.max_width, options.height or console.height)


def screen_lines(shown: Shown, width: int, height: int) -> list[Text]:
    """Lay everything out.

    Returns:
        Exactly `height` lines of exactly `width` columns.
    """
    lines = header_lines(shown, width)[: max(1, height // 4)]
    footer: list[Text] = []
    if height >= FRAMED_HEIGHT:
        lines += narration_lines(shown, width)[: height // 6]
        footer = [footer_line(shown, width)] if shown.keys is not None else []
    rows = height - len(lines) - len(footer)
    if shown.is_explained:
        lines += explanation_lines(shown, width)[:rows]
    elif shown.snapshot.record is not None:
        lines += _body(shown, shown.snapshot.record, width, rows)
    lines = [*lines, *(Text() for _ in range(height - len(lines) - len(footer))), *footer]
    for line in lines:
        line.no_wrap, line.overflow = True, "crop"
    return [fit(line, width) for line in lines[:height]]


def _body(shown: Shown, record: CycleRecord, width: int, height: int) -> list[Text]:
    """Put everything in one column, or in a wide terminal targets on the left."""
    is_wide = width >= WIDE
    left_width = width * 11 // 20 if is_wide else width
    right_width = width - left_width - 2 if is_wide else width
    rest = _rest(shown, record, right_width, height)
    rows = _share_rows(shown, record, left_width, height, rest, is_wide=is_wide)
    left = _target_lines(shown, record, left_width, height if is_wide else rows["targets"])
    right = _lay_out(rest, rows, right_width)
    if not is_wide:
        return [*left, *right]
    return [
        Text.assemble(fit(one, left_width), "  ", fit(other, right_width))
        for one, other in zip_longest(left, right, fillvalue=Text())
    ]


class _Rest(Struct, frozen=True, kw_only=True):
    """Rules, outputs, events, messages and health, before it is known how many rows there are for them."""

    rules: Sequence[Block]
    outputs: Sequence[Block]
    events: Sequence[list[Text]]
    messages: Sequence[Text]
    health: Sequence[Text]


def _rest(shown: Shown, record: CycleRecord, width: int, height: int) -> _Rest:
    snapshot = shown.snapshot
    return _Rest(
        rules=rule_blocks(shown, record, width),
        outputs=output_blocks(shown, record, width),
        events=[event_lines(shown, event, width) for event in snapshot.events[:height]],
        messages=[message_line(shown, at_s, sent) for at_s, sent in snapshot.messages[:height]],
        health=note_lines(snapshot.health.notes),
    )


def _share_rows(
    shown: Shown, record: CycleRecord, width: int, height: int, rest: _Rest, *, is_wide: bool
) -> Counter[str]:
    """Return the number of rows each section gets; targets get none where they stand beside the others."""
    tracks = record.decision.tracks
    targets, rules, outputs = len(tracks), len(rest.rules), len(rest.outputs)
    figures = sum(figure_rows(shown, track, width) for track in tracks)  # of all targets, without their charts
    all_rules, all_outputs = (sum(len(each.lines) for each in blocks) for blocks in (rest.rules, rest.outputs))
    loud_rules, loud_outputs = (
        sum(1 if each.is_quiet else len(each.lines) for each in blocks) for blocks in (rest.rules, rest.outputs)
    )
    health = 1 + len(rest.health)  # with its heading, for it comes with one or not at all
    most = {"rules": all_rules, "outputs": all_outputs, "messages": len(rest.messages), "health": health}
    return grant_rows(
        height,
        [
            ("targets", targets), ("outputs", min(outputs, 2)), ("rules", min(rules, 3)), ("targets", targets),
            ("events", 1), ("outputs", outputs - 2), ("rules", rules - 3), ("messages", 1),
            ("headings", 4 if rest.messages else 3), ("targets", figures - 2 * targets),
            ("outputs", loud_outputs - outputs), ("rules", loud_rules - rules),
            ("events", len(rest.events[0]) - 1 if rest.events else 0), ("outputs", all_outputs - loud_outputs),
            ("targets", 5), ("rules", all_rules - loud_rules), ("events", 1), ("messages", 1), ("events", 1),
            ("targets", 5), ("health", health), ("targets", height), ("messages", 5), ("events", height),
        ],
        most | {"targets": 0} if is_wide else most,
    )  # fmt: skip


def grant_rows(free: int, claims: Sequence[tuple[str, int]], most: Mapping[str, int]) -> Counter[str]:
    """Share rows out, the most important claim first, up to ``most``. Headings come all together or not at all."""
    rows: Counter[str] = Counter()
    for name, wanted in claims:
        granted = int(max(0, min(free, wanted, most.get(name, math.inf) - rows[name])))
        if name == "headings" and granted < wanted:
            continue
        rows[name] += granted
        free -= granted
    return rows


def _target_lines(shown: Shown, record: CycleRecord, width: int, rows: int) -> list[Text]:
    tracks = record.decision.tracks
    if not tracks or rows <= 0:
        return []
    each, more = divmod(rows, len(tracks))
    lines = [
        line
        for number, track in enumerate(tracks if each else tracks[:rows])
        for line in target_lines(shown, track, width, each + (number < more))
    ]
    return lines if each else _with_more(lines, len(tracks))


def _lay_out(rest: _Rest, rows: Counter[str], width: int) -> list[Text]:
    """Return the lines that fit into the rows, under headings if there is room for these."""
    sections = {
        "rules": _fit_blocks(rest.rules, rows["rules"], width),
        "outputs": _fit_blocks(rest.outputs, rows["outputs"], width),
        "events": _fit_events(rest.events, rows["events"], width),
        **({"messages": rest.messages[: rows["messages"]]} if rest.messages else {}),
        **({"health": rest.health[: rows["health"] - 1]} if rows["health"] > 1 else {}),
    }
    return [
        line
        for name, section in sections.items()
        for line in ([heading(name, width), *section] if rows["headings"] else section)
    ]


def _fit_blocks(blocks: Sequence[Block], rows: int, width: int) -> list[Text]:
    """Return every block on a line at least; with all its words as long as there are rows, those that act first."""
    by_need = sorted(range(len(blocks)), key=lambda number: blocks[number].is_quiet)
    if rows < len(blocks):
        return _with_more([blocks[number].joined for number in by_need[:rows]], len(blocks))
    shown: dict[int, list[Text]] = {}
    free = rows - len(blocks)
    for number in by_need:
        block = blocks[number]
        whole = [block.figures] if block.is_quiet and len(block.lines) > 1 + free else block.lines
        shown[number] = _cut(whole, 1 + free, width)
        free -= len(shown[number]) - 1
    return [line for number in range(len(blocks)) for line in shown[number]]


def _fit_events(events: Sequence[list[Text]], rows: int, width: int) -> list[Text]:
    lines: list[Text] = []
    for event in events:
        lines += _cut(event, rows - len(lines), width)
    return lines


def _cut(lines: list[Text], rows: int, width: int) -> list[Text]:
    """Return lines as far as there are rows; the last one shows that there would be more."""
    if 0 < rows < len(lines):
        lines[rows - 1].append(" " * width)
    return lines[:rows]


def _with_more(lines: list[Text], count: int) -> list[Text]:
    """Write into the last line how many more there are, if not all are shown."""
    if lines and len(lines) < count:
        lines[-1] = Text(f" and {count - len(lines) + 1} more", "italic dim")
    return lines
