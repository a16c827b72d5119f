"""The timeline for the page: what each stretch of time was like, hours long, and what is known of one moment."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import to_builtins

from stadimeter.app.event_log import ENDING, log_files, read_events
from stadimeter.app.timeline import (
    FIGURES,
    HIGH,
    LOW,
    SEEN,
    STATES,
    Names,
    Rows,
    event_log_beside,
    read_rows,
    timeline_folder,
)
from stadimeter.core.clock import DAY_S
from stadimeter.errors import ConfigError
from stadimeter.workbench.server.operations import Desk, operation
from stadimeter.workbench.server.run_of_desk import folder_of

# A step of the answer is one of these, in seconds: each is whole steps of a level of the store.
STEPS_S = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 14400, 43200, 86400)

POINTS_MAX = 4000
SPAN_MAX_S = 366 * DAY_S
EVENTS_MAX = 1000

# Of a moment, the events this long before and after it are told.
NEAR_S = 60.0


@operation
def timeline(desk: Desk, from_: float, to: float, points: int = 1000) -> dict[str, Any]:
    """Answer what was from one time to another, in some number of steps: distances, states of rules, and events.

    The steps begin at whole multiples of their length, so that a part that is asked for again is the same.
    """
    if not (0 <= from_ < to <= from_ + SPAN_MAX_S and 1 <= points <= POINTS_MAX):
        raise ConfigError(f"a timeline is of at most {SPAN_MAX_S / DAY_S:.0f} days, in 1 to {POINTS_MAX} points")
    step_s = next((each for each in STEPS_S if each >= (to - from_) / points), STEPS_S[-1])
    folder = _folder(desk)
    grid = _TimelineGrid(int(from_ // step_s) * step_s, step_s, int(-(-to // step_s)) - int(from_ // step_s))
    for names, rows in read_rows(folder, grid.from_s, to, step_s):
        grid.add(names, rows)
    events = list(islice(read_events(_event_log(desk, folder), from_, to), EVENTS_MAX + 1))
    return {
        "from_s": grid.from_s,
        "step_s": step_s,
        "count": grid.count,
        "targets": {name: _figures(found) for name, found in grid.targets.items()},
        "lanes": [{"rule": rule, "spans": list(grid.spans(states))} for rule, states in grid.rules.items()],
        "events": [to_builtins(each) for each in reversed(events[:EVENTS_MAX])],
        "has_more_events": len(events) > EVENTS_MAX,
        "is_kept": any(folder.glob("*.1")),
    }


def run_time_s(desk: Desk, at_s: float) -> float | None:
    """Return the run's time at a moment of the computer's clock; None where no timeline was kept."""
    rows = [row for _, found in read_rows(_folder(desk), int(at_s), int(at_s) + 1, 1) for row in found]
    return float(rows[-1]["run_s"]) + at_s % 1 if rows else None


class _TimelineGrid:
    """Steps of time that several segments are put into."""

    def __init__(self, from_s: int, step_s: int, count: int) -> None:
        self.from_s = from_s
        self.step_s = step_s
        self.count = count
        self.targets: dict[str, Rows] = {}
        self.rules: dict[str, Rows] = {}

    def add(self, names: Names, rows: Rows) -> None:
        """Take in a segment. Where two meet in one step, the extremes of both stay."""
        at = (rows["unix_s"].astype(int) - self.from_s) // self.step_s
        for number, target in enumerate(names.targets):
            found = self.targets.setdefault(target, np.full((self.count, len(FIGURES)), np.nan))
            before, figures = found[at], rows["figures"][:, number]
            found[at] = np.where(figures[:, SEEN, None] > 0, figures, before)
            found[at, LOW] = np.fmin(before[:, LOW], figures[:, LOW])
            found[at, HIGH] = np.fmax(before[:, HIGH], figures[:, HIGH])
        for number, rule in enumerate(names.rules):
            states = self.rules.setdefault(rule, np.zeros(self.count, int))
            states[at] = np.maximum(states[at], rows["states"][:, number])

    def spans(self, states: Rows) -> Iterator[tuple[int, int, str]]:
        """Yield from when to when a rule was in each state; nothing for a time of which nothing is known."""
        edges = [0, *(np.flatnonzero(np.diff(states)) + 1).tolist(), self.count]
        for begin, end in pairwise(edges):
            if states[begin]:
                state = STATES[min(states[begin], len(STATES) - 1)]
                yield self.from_s + begin * self.step_s, self.from_s + end * self.step_s, str(state)


def _figures(found: Rows) -> dict[str, list[float | None]]:
    return {
        name: [None if each != each else each for each in np.round(found[:, number], 4).tolist()]  # noqa: PLR0124 - NaN
        for number, name in enumerate(FIGURES[:SEEN])
    }


def _folder(desk: Desk) -> Path:
    return timeline_folder(folder_of(desk), desk.configuration)


def _event_log(desk: Desk, folder: Path) -> Path:
    """Return the event log: the one beside the timeline, or else that of the service."""
    beside = event_log_beside(folder)
    return beside if log_files(beside) else folder_of(desk).parent / f"{desk.configuration.stem}{ENDING}"
