"""The timeline for the page: what each stretch of time was like, hours long, and what is known of one moment."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import to_builtins

from stadimeter.app.control.client import HELLO_WAIT_S, ask
from stadimeter.app.control.recording import LAST
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
from stadimeter.config.loader import load_configuration
from stadimeter.core.alarms.machine import thresholds_of
from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.compounds import leaves
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.rule import AlarmRule, AnyRule, FollowRule, RampRule
from stadimeter.core.rules.explaining import explain
from stadimeter.errors import ConfigError, ControlError, StadimeterError
from stadimeter.workbench.replay import RecordingIndex, decisions, read_index, read_recording, replay_run
from stadimeter.workbench.server.operations import Desk, operation
from stadimeter.workbench.server.recordings import began_unix_s, recordings, recordings_of
from stadimeter.workbench.server.run_of_desk import folder_of, run_socket

# A step of the answer is one of these, in seconds: each is whole steps of a level of the store.
STEPS_S = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 14400, 43200, 86400)

POINTS_MAX = 4000
SPAN_MAX_S = 366 * DAY_S
EVENTS_MAX = 1000


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


# The run explains the last minute itself.
RUN_REMEMBERS_S = 60.0

# A moment of a long recording is decided again from this long before it. Of an alarm that stands since before that, the
# state alone is told.
BEFORE_S = 60.0

# The events this long before and after a moment are told with it.
NEAR_S = 30.0


@operation
def marks(desk: Desk, from_: float, to: float) -> dict[str, Any]:
    """Answer the recordings of a time, and the distances at which the rules of the configuration begin."""
    return {"clips": list(_clips(desk, from_, to)), "thresholds": _thresholds(desk)}


def _clips(desk: Desk, from_s: float, to_s: float) -> Iterator[dict[str, Any]]:
    for each in recordings(desk)["recordings"]:
        began_s = each.get("began_unix_s") or each["unix_s"]
        ended_s = each.get("ended_unix_s") or began_s + (each["seconds"] or 0.0)
        if began_s < to_s and ended_s >= from_s and not each["damage"]:
            yield {"name": each["name"], "from_s": began_s, "to_s": ended_s, "clip_of": each.get("clip_of")}


def _thresholds(desk: Desk) -> list[dict[str, Any]]:
    """Return the thresholds of distance by the configuration as it is saved; none where it cannot be used."""
    try:
        found = desk.configuration.stat()
        return desk.remember("thresholds", (found.st_mtime_ns, found.st_size), lambda: _read_thresholds(desk))
    except (ConfigError, OSError):
        return []


def _read_thresholds(desk: Desk) -> list[dict[str, Any]]:
    rules = load_configuration(desk.configuration, with_tests=False).plan.rules
    return [each for rule in rules for each in _thresholds_of(rule)]


def _thresholds_of(rule: AnyRule) -> Iterator[dict[str, Any]]:
    def named(key: str, value_m: float, target: str = "") -> dict[str, Any]:
        return {"rule": rule.name, "target": target or rule.target, "key": key, "value_m": value_m}

    match rule:
        case AlarmRule():
            parts = list(leaves(rule.condition))
            for key, found in thresholds_of(rule).items():
                if isinstance(part := parts[found.leaf], DistanceCondition):
                    yield named(key, found.value, part.target)
        case RampRule(quantity="distance" | "depth"):
            yield named("ramp", rule.start)
        case FollowRule():
            yield named("follow", rule.distance_m)


@operation
def moment(desk: Desk, at: float) -> dict[str, Any]:
    """Answer what there is to say of a moment: by the run, by a recording that holds it, or by the timeline alone."""
    second = timeline(desk, int(at), int(at) + 1, 1)
    near = timeline(desk, max(0.0, at - NEAR_S), at + NEAR_S, 1)["events"]
    known = _by_run(desk, at) or _by_recording(desk, at) or {"by": "timeline", "rules": _by_states(second)}
    targets = [_target(name, found["mean_m"][0], found["sigma_m"][0]) for name, found in second["targets"].items()]
    return {"unix_s": at, "recording": None, "targets": targets, "events": near, **known}


def _target(name: str, distance_m: float | None, sigma_m: float | None) -> dict[str, Any]:
    """Return a target by the names of a recording's moment."""
    is_valid = distance_m is not None
    status = "" if is_valid else "not measured"
    return {"name": name, "is_valid": is_valid, "status": status, "distance_m": distance_m, "sigma_m": sigma_m}


def _by_states(second: dict[str, Any]) -> list[dict[str, str]]:
    lanes = ((lane["rule"], spans) for lane in second["lanes"] if (spans := lane["spans"]))
    return [{"rule": rule, "status": spans[0][2], "reason": ""} for rule, spans in lanes]


def _by_run(desk: Desk, at_s: float) -> dict[str, Any] | None:
    if time.time() - at_s > RUN_REMEMBERS_S:
        return None
    with suppress(ControlError):
        found = ask(run_socket(desk), "explain", {"at_unix_s": at_s}, wait_s=HELLO_WAIT_S)["rules"]
        rules = [{"rule": each["rule"], "status": each["status"], "reason": each["sentence"]} for each in found]
        return {"by": "run", "rules": rules}
    return None


def _by_recording(desk: Desk, at_s: float) -> dict[str, Any] | None:
    """Explain by a recording that holds the moment, decided again up to it; None where there is none."""
    run_s = run_time_s(desk, at_s)
    for name, path in reversed(recordings_of(desk).items()):
        with suppress(StadimeterError, OSError):  # damaged, only just begun, or gone
            if path.stat().st_mtime < at_s - 1:
                continue
            since_s, index = at_s - began_unix_s(read_recording(path).header, at_s + 1), read_index(path)
            if since_s >= 0 and run_s is not None:
                since_s = run_s - index.moment(0.0).cycle.record().observation.now_s
            if 0 <= since_s <= index.seconds:
                shown = None if name.startswith(f"{LAST}/") else path.name
                held = {"recording": shown, "since_s": since_s, "held_by": name}
                return {"by": "recording", **held, "rules": _decided(index, since_s)}
    return None


def _decided(index: RecordingIndex, since_s: float) -> list[dict[str, str]]:
    """List what each rule did at a moment of a recording, and why if deciding it again comes to the same."""
    recorded = index.moment(since_s).cycle.record()
    until_s = recorded.observation.now_s
    run = replay_run(index.recording, None)
    from_s = until_s - BEFORE_S if since_s > BEFORE_S else None
    decided = decisions(index.recording, run.configuration.plan, from_s=from_s)
    again = next((decision for _, observation, decision in decided if observation.now_s >= until_s), None)
    same = {each.rule for each in again.rules if each in recorded.decision.rules} if again is not None else set()
    return [
        {
            "rule": trace.rule,
            "status": trace.status.value,
            "reason": explain(again, trace.rule).sentence if again is not None and trace.rule in same else "",
        }
        for trace in recorded.decision.rules
    ]
