"""Figures of an alarm system, from the events of its alarms, as ISA-18.2 and EEMUA 191 have them.

Thresholds: a flood begins when more than 10 alarms came in 10 minutes, and ends when fewer than 5 did; an alarm that
stands for more than 24 h is stale (both ANSI/ISA-18.2); one that comes three times within a minute chatters, by the
rule of thumb of those who apply it. `docs/fleet.md` has the sources. The figures are meant for one person, who has all
these alarms to deal with, and to find bad alarms by: the target of 150 a day is no part of ISA-18.2 since 2016.
"""

from __future__ import annotations

from collections import Counter, deque
from datetime import datetime
from pathlib import Path
from typing import Any

import msgspec

from stadimeter.app.live.health import percentile
from stadimeter.app.recordings.journal import readable
from stadimeter.config.untrusted_file import lines_of
from stadimeter.core.bounds import MAX_TIME_S
from stadimeter.core.decision import EventKind
from stadimeter.core.words import one_line
from stadimeter.errors import JournalError
from stadimeter.workbench.fleet.devices import MAX_TOPIC_CHARACTERS, AlarmEvent

WINDOW_S = 600.0
FLOOD_BEGINS = 10
FLOOD_ENDS = 5
STALE_ALARM_S = 24 * 3600.0
CHATTERS_S = 60.0
CHATTERS = 3
TOP = 10

MAX_ALARMS = 20_000
MAX_KEPT_TIMES = 100_000
MAX_EVENTS = 1_000_000

_ANNUNCIATED = {EventKind.RAISED, EventKind.REALARMED}


class AlarmFigures:
    """Takes events in order, and has the figures at any time. Times are on one clock, in seconds.

    Attributes:
        passed_over: Events of alarms that there was no room for.
    """

    def __init__(self, began_s: float) -> None:
        self.passed_over = 0
        self._began_s = self._now_s = began_s
        self._counts: Counter[str] = Counter()
        self._raised_s: dict[str, float] = {}
        self._unacknowledged_s: dict[str, float] = {}
        self._last_s: dict[str, deque[float]] = {}
        self._chattering: set[str] = set()
        self._waits_s: deque[float] = deque(maxlen=MAX_KEPT_TIMES)
        self._window: deque[float] = deque(maxlen=MAX_KEPT_TIMES)
        self._peak = self._floods = 0
        self._in_flood_s = 0.0
        self._flood_since_s: float | None = None

    def take(self, at_s: float, alarm: str, kind: str, *, is_annunciated: bool = True) -> None:
        """Take in what happened to an alarm.

        Args:
            at_s: When; a time before that of the event before counts as the same.
            kind: One of `EventKind`; other words are passed over.
            is_annunciated: Whether people were notified. What is shelved is no load for them.
        """
        self._advance(at_s)
        if kind in _ANNUNCIATED:
            if alarm not in self._last_s and len(self._last_s) >= MAX_ALARMS:
                self.passed_over += 1
                return
            self._raised_s.setdefault(alarm, self._now_s)
            if is_annunciated:
                self._annunciate(alarm)
        elif kind in {EventKind.CLEARED, EventKind.RESET}:
            self._raised_s.pop(alarm, None)
        elif kind == EventKind.ACKNOWLEDGED and alarm in self._unacknowledged_s:
            self._waits_s.append(self._now_s - self._unacknowledged_s.pop(alarm))

    def note_standing(self, alarm: str, since_s: float) -> None:
        """Take in that an alarm stood already when the listening began."""
        if len(self._raised_s) < MAX_ALARMS:
            self._raised_s.setdefault(alarm, since_s)

    def figures(self, now_s: float) -> dict[str, Any]:
        """Return the figures from the beginning until now, as ``fleet --figures --json`` prints them."""
        self._advance(now_s)
        total, waits = self._counts.total(), sorted(self._waits_s)
        windows = max(1.0, (self._now_s - self._began_s) / WINDOW_S)
        flood_s = self._in_flood_s + (0.0 if self._flood_since_s is None else self._now_s - self._flood_since_s)
        return {
            "seconds": round(self._now_s - self._began_s, 1),
            "alarms": total,
            "alarms_per_10_min": round(total / windows, 2),
            "most_in_10_min": self._peak,
            "floods": self._floods,
            "flood_seconds": round(flood_s, 1),
            "top": [
                {"alarm": alarm, "count": count, "percent": round(100 * count / total, 1)}
                for alarm, count in self._counts.most_common(TOP)
            ],
            "chattering": sorted(self._chattering),
            "stale": sorted(alarm for alarm, at_s in self._raised_s.items() if self._now_s - at_s > STALE_ALARM_S),
            "acknowledged": len(waits),
            "acknowledge_median_s": percentile(waits, 0.5),
            "acknowledge_p95_s": percentile(waits, 0.95),
            "passed_over": self.passed_over,
        }

    def _annunciate(self, alarm: str) -> None:
        self._counts[alarm] += 1
        self._unacknowledged_s.setdefault(alarm, self._now_s)
        last_s = self._last_s.setdefault(alarm, deque(maxlen=CHATTERS))
        last_s.append(self._now_s)
        if len(last_s) == CHATTERS and last_s[-1] - last_s[0] <= CHATTERS_S:
            self._chattering.add(alarm)
        self._window.append(self._now_s)
        self._peak = max(self._peak, len(self._window))
        if len(self._window) > FLOOD_BEGINS and self._flood_since_s is None:
            self._flood_since_s, self._floods = self._now_s, self._floods + 1

    def _advance(self, now_s: float) -> None:
        """Let the time go on: alarms leave the window, and a flood ends when few are left in it."""
        self._now_s = max(now_s, self._now_s)
        while self._window and self._window[0] <= self._now_s - WINDOW_S:
            left_s = self._window.popleft() + WINDOW_S
            if self._flood_since_s is not None and len(self._window) < FLOOD_ENDS:
                self._in_flood_s += left_s - self._flood_since_s
                self._flood_since_s = None


def figures_of(path: Path) -> dict[str, Any]:
    """Return the figures of a file of lines ``TOPIC PAYLOAD``, as ``mosquitto_sub -v`` writes them.

    They go by the devices' own clocks, from the first event to the last.

    Raises:
        JournalError: It cannot be read, holds no event of an alarm, or holds too many.
    """
    events: set[tuple[float, str, str, bool]] = set()  # a message may come twice
    passed_over = 0
    with readable(path) as file:
        for line in lines_of(file):
            topic, _, payload = line.strip().partition(b" ")
            if not topic.endswith(b"/event/alarm"):
                continue
            try:
                events.add(_read_event(topic.decode().removesuffix("/event/alarm"), payload))
            except (ValueError, RecursionError):
                passed_over += 1
            if len(events) > MAX_EVENTS:
                raise JournalError(f"{path}: more than {MAX_EVENTS} events; divide the file")
    if not events:
        raise JournalError(
            f"{path}: no event of an alarm; `mosquitto_sub -v -t 'stadimeter/+/event/alarm'` writes them"
        )
    ordered = sorted(events)
    figures = AlarmFigures(ordered[0][0])
    figures.passed_over = passed_over
    for at_s, alarm, kind, is_annunciated in ordered:
        figures.take(at_s, alarm, kind, is_annunciated=is_annunciated)
    return figures.figures(ordered[-1][0])


def _read_event(base: str, payload: bytes) -> tuple[float, str, str, bool]:
    event = msgspec.json.decode(payload, type=AlarmEvent)
    at_s = datetime.fromisoformat(event.ts).timestamp()
    if not 0 <= at_s <= MAX_TIME_S:
        raise ValueError("a time before 1970 or after 2286")
    return at_s, one_line(f"{base}/{event.rule}"[:MAX_TOPIC_CHARACTERS]), event.event_type, event.notify
