"""All that there is to see of a run at one moment: what the terminal's live view draws, and the page."""

from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from msgspec import Struct, field

from stadimeter.app.clock import SteppedClock
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.live.health import CONNECTED, Board, LiveHealth, live_health
from stadimeter.app.live.history import WINDOW_S, DistanceSample, RunHistory, Seen
from stadimeter.core.clock import Clock
from stadimeter.core.command import LevelCommand
from stadimeter.core.conditions.compounds import leaves
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.quantities import QUANTITIES, noun_of
from stadimeter.core.conditions.remembered import RememberedCondition
from stadimeter.core.decision import Decision, Event, OutputTrace
from stadimeter.core.detection import Detection, RejectedCandidate
from stadimeter.core.measurement import MeasurementStatus, Track
from stadimeter.core.message import Message
from stadimeter.core.plan import BaseOutput, Plan
from stadimeter.core.rule import AlarmRule, AnyRule, FollowRule, RampRule
from stadimeter.core.rules.explaining import Reasons, explain


class RunSnapshot(Struct, frozen=True, kw_only=True):
    """All that there is to see of a run at one moment.

    Attributes:
        record: The newest cycle; None before the first.
        seen: The newest frame, and what was found in exactly this frame; None before the first.
        started_s: The time of the first cycle, on the run's monotonic clock.
        samples: The recent distances of each target, oldest first.
        events: Newest first.
        messenger: Where messages to other programs go, and how that is; None if there is no messenger.
        messages: The messages to other programs, each with its time, newest first.
        health: How the run is doing.
        narration: What happens in a simulated world; empty if there is nothing to say.
        plan: Its rules, outputs and targets, as they are after the newest reload; None if there is no plan.
        has_corners: By target, whether its outline is corners in order, or else points on a rim.
        run: What the run is: its configuration and so on.
        recording: The recording under way; None if there is none.
    """

    record: CycleRecord | None = None
    seen: Seen | None = None
    started_s: float = 0.0
    samples: Mapping[str, Sequence[DistanceSample]] = field(default_factory=dict)
    events: Sequence[Event] = ()
    messenger: Mapping[str, Any] | None = None
    messages: Sequence[tuple[float, Message]] = ()
    health: LiveHealth = field(default_factory=LiveHealth)
    narration: str = ""
    plan: Plan | None = None
    has_corners: Mapping[str, bool] = field(default_factory=dict)
    run: Mapping[str, object] = field(default_factory=dict)
    recording: Mapping[str, object] | None = None

    @property
    def looked_at(self) -> Mapping[str, Sequence[RejectedCandidate]]:
        """The rejected candidates of each target that the newest frame does not show, the most like it first."""
        return looked_at(self.seen.record) if self.seen is not None else {}

    @property
    def limits_m(self) -> Mapping[str, Sequence[float]]:
        """The distances at which rules begin, by target, nearest first, to mark them in a chart."""
        rules = self.plan.rules if self.plan is not None else ()
        reasons = self.record.decision.reasons if self.record is not None else None
        if isinstance(reasons, Reasons) and reasons.plan is self.plan:
            rules = reasons.judged.rules  # with thresholds that operators have set
        found: dict[str, set[float]] = defaultdict(set)
        for rule in rules:
            found[rule.target].update(_limits_m(rule))
        return {target: sorted(values) for target, values in found.items()}

    @property
    def tilts_rad(self) -> Mapping[str, float]:
        """Tilt of each flat target that was measured in the newest frame."""
        seen = self.seen.record.observation.measurements if self.seen is not None else ()
        return {each.target: each.tilt_rad for each in seen if each.tilt_rad is not None}


def why(decision: Decision, rule: str) -> str:
    """Return why a rule does what it does, in short; the reason alone if read from a file."""
    if isinstance(decision.reasons, Reasons):
        return explain(decision, rule, with_probability=False).sentence
    return decision.reasons.get(rule, "")


def looked_at(record: CycleRecord) -> Mapping[str, Sequence[RejectedCandidate]]:
    """Return the rejected candidates in a frame, for each target that was not measured in it."""
    return {
        measured.target: record.rejected.get(measured.target, ())
        for measured in record.observation.measurements
        if measured.status is not MeasurementStatus.MEASURED
    }


def _limits_m(rule: AnyRule) -> tuple[float, ...]:
    match rule:
        case AlarmRule(condition=DistanceCondition(above=above_m, below=below_m)):
            return tuple(limit_m for limit_m in (above_m, below_m) if limit_m is not None)
        case RampRule(quantity="distance" | "depth"):
            return (rule.start,)
        case FollowRule():
            return (rule.distance_m,)
        case _:
            return ()


class LiveFeed(Struct):
    """The view of a run for those who watch it, from any thread.

    Attributes:
        clock: The run's clock.
        around: Returns what a run has beside its cycles, by the names of a snapshot, and what is wrong outside the loop
            as ``trouble``.
        unix_time_s: The computer's clock.
    """

    clock: Clock
    history: RunHistory = field(default_factory=RunHistory)
    around: Callable[[], Mapping[str, Any]] = dict
    board: Board = field(default_factory=Board)
    unix_time_s: Callable[[], float] = time.time

    def pace(self) -> float:
        """Return the pace of a simulation or a recording of late, as a share of the speed that was asked for.

        1 for a live camera, and where it shall pass as fast as the computer can.
        """
        asked = self.clock.speed if isinstance(self.clock, SteppedClock) else None
        speed = self.history.speed
        return speed / asked if asked and speed is not None else 1.0

    def snapshot(self, window_s: float = WINDOW_S) -> RunSnapshot:
        """Return all there is to see now, with the distances of this long."""
        history, around = self.history, {**self.around()}
        record, link, trouble = history.record, around.get("messenger"), around.pop("trouble", "")
        broker = link["trouble"] or CONNECTED if link is not None else ""
        return RunSnapshot(
            record=record,
            seen=history.seen,
            started_s=history.started_s,
            samples=history.samples_after(record.observation.now_s - window_s if record is not None else 0.0),
            events=tuple(history.events),
            health=live_health(history, self.board, broker, trouble, self.pace()),
            **around,
        )

    def cycle_age_s(self) -> float:
        """Return the age of the newest cycle in real time: a loop that hangs, also on a stepped clock, grows old."""
        history = self.history
        return history.real_time_s() - history.cycle_at_s if history.cycle_at_s is not None else 0.0

    def unix_offset_s(self) -> float:
        """Return the time by which the computer's clock is ahead of the run's."""
        return self.unix_time_s() - self.clock.now_s()

    def wall_clock(self) -> Callable[[float], float]:
        """Return what gives moments of the run by the computer's clock."""
        return self.history.wall_clock(self.clock.now_s(), self.unix_time_s())


# A snapshot as JSON has it -------------------------------------------------------------------------
#
# SI units, pixels, radians. What is not known is null, never NaN: JSON has no such number.


OUTLINE_POINTS_MAX = 64
REJECTED_MAX = 8
MESSAGES_MAX = 10

# What a rule's trace and its snapshot call the same.
TRACE_FACTS = ("active", "acknowledged", "inhibits", "chattering", "first_out", "output")


def shared_data(snapshot: RunSnapshot, number: int, now_s: float, unix_offset_s: float) -> dict[str, Any]:
    """Return the part of a snapshot that all who watch get.

    Args:
        number: Counts the snapshots.
        now_s: The run's clock when it was taken.
        unix_offset_s: What the computer's clock is ahead of it.
    """
    record = snapshot.record
    decision = record.decision if record is not None else None
    return {
        "n": number,
        "now_s": _rounded(now_s),
        "unix_s": _rounded(now_s + unix_offset_s),
        "frame": frame_data(snapshot.seen, unix_offset_s),
        "targets": [_target(snapshot, track) for track in decision.tracks] if decision is not None else [],
        "rules": list(_rules(snapshot.plan, decision)) if decision is not None else [],
        "outputs": list(_outputs(snapshot)),
        "figures": list(_remembered(snapshot.plan, decision)) if decision is not None else [],
        "safety": _safety(decision),
        "health": _health(snapshot),
        "messenger": snapshot.messenger,
        "messages": [_message(at_s, message) for at_s, message in snapshot.messages[:MESSAGES_MAX]],
        "recording": snapshot.recording,
        "narration": snapshot.narration,
        "run": snapshot.run,
    }


def events_data(events: Iterable[Event], unix_s: Callable[[float], float]) -> list[dict[str, Any]]:
    """Return events as JSON has them; `unix_s` returns when a moment of the run was by the computer's clock."""
    return [
        {
            "number": event.sequence,
            "at_s": _rounded(event.at_s),
            "unix_s": _rounded(unix_s(event.at_s)),
            "kind": event.kind.value,
            "source": event.source,
            "severity": event.severity.value,
            "reason": event.reason,
            "by": event.by,
        }
        for event in events
    ]


def samples_data(samples: Mapping[str, Iterable[DistanceSample]]) -> dict[str, Any]:
    """Return by target a list of time, distance or null, and standard deviation."""
    return {
        name: [(_rounded(at_s), _rounded(distance_m, 4), _rounded(sigma_m, 4)) for at_s, distance_m, sigma_m in found]
        for name, found in samples.items()
    }


def frame_data(seen: Seen | None, unix_offset_s: float) -> dict[str, Any] | None:
    """Return the known facts of a frame beside its picture; None if there is none."""
    stamp = seen.record.observation.frame if seen is not None else None
    if seen is None or stamp is None:
        return None
    return {
        "sequence": stamp.sequence,
        "captured_at_s": _rounded(stamp.captured_at_s),
        "captured_unix_s": _rounded(stamp.captured_at_s + unix_offset_s),
        "width_px": seen.frame.width_px if seen.frame is not None else 0,
        "height_px": seen.frame.height_px if seen.frame is not None else 0,
    }


def outline_of(detection: Detection, *, has_corners: bool) -> list[list[float]]:
    """Return the outline of a target in order around it: its corners, or points on its rim, at most 64 of them."""
    points = detection.outline_px
    points = points[np.isfinite(points).all(axis=1)]
    if not has_corners and len(points):
        centre = points.mean(axis=0)
        points = points[np.argsort(np.arctan2(points[:, 1] - centre[1], points[:, 0] - centre[0]))]
    if len(points) > OUTLINE_POINTS_MAX:
        points = points[np.linspace(0, len(points) - 1, OUTLINE_POINTS_MAX).astype(int)]
    outline: list[list[float]] = np.round(points, 1).tolist()
    return outline


def _target(snapshot: RunSnapshot, track: Track) -> dict[str, Any]:
    found = next((each for each in _detections(snapshot) if each.target == track.target), None)
    has_corners = snapshot.has_corners.get(track.target, False)
    return {
        "name": track.target,
        "status": track.status.value,
        "is_valid": track.is_valid,
        **_figures(track, "distance_m", "sigma_m", "bearing_rad", "elevation_rad", digits=4),
        **_figures(track, "closing_mps", "closing_sigma_mps"),
        "tilt_rad": _rounded(snapshot.tilts_rad.get(track.target), 4),
        "reason": track.reason,
        "thresholds_m": [_rounded(limit_m, 4) for limit_m in snapshot.limits_m.get(track.target, ())],
        "detection": _detection(found, has_corners=has_corners) if found is not None else None,
        "rejected": [_candidate(each) for each in (found.rejected[:REJECTED_MAX] if found is not None else ())],
    }


def _detections(snapshot: RunSnapshot) -> tuple[Detection, ...]:
    return snapshot.seen.record.detections if snapshot.seen is not None else ()


def _detection(found: Detection, *, has_corners: bool) -> dict[str, Any]:
    return {
        "status": found.status.value,
        "reason": found.reason,
        "centre_px": _pixels(found.centre_px),
        **_figures(found, "width_px", "height_px", "quality", digits=2),
        "outline_px": outline_of(found, has_corners=has_corners),
        "has_corners": has_corners,
    }


def _candidate(rejected: RejectedCandidate) -> dict[str, Any]:
    return {
        "centre_px": _pixels(rejected.centre_px),
        "size_px": _rounded(rejected.size_px, 1),
        "corners_px": [_pixels(corner) for corner in rejected.corners_px],
        "reason": rejected.reason,
    }


def _rules(plan: Plan | None, decision: Decision) -> Iterator[dict[str, Any]]:
    rules = {rule.name: rule for rule in plan.rules} if plan is not None else {}
    for trace in decision.rules:
        rule = rules.get(trace.rule)
        alarm = rule if isinstance(rule, AlarmRule) else None
        yield {
            "rule": trace.rule,
            "status": trace.status.value,
            **{name: getattr(trace, name) for name in TRACE_FACTS},
            "target": rule.target if rule is not None else "",
            "severity": rule.severity.value if rule is not None else "",
            "is_alarm": alarm is not None,
            "needs_ack": alarm is not None and alarm.ack == "required",
            "latches": alarm is not None and alarm.latch,
            "counts": alarm is not None and _counts(alarm),
            "set_thresholds": _set_thresholds(decision, trace.rule),
            "reason": why(decision, trace.rule),
        }


def _counts(alarm: AlarmRule) -> bool:
    """Check whether a reset lets a rule count anew."""
    return any(isinstance(leaf, RememberedCondition) and leaf.rules for leaf in leaves(alarm.condition))


def _remembered(plan: Plan | None, decision: Decision) -> Iterator[dict[str, Any]]:
    for figure in plan.named_figures if plan is not None else ():
        yield {
            "name": figure.name,
            "value": _rounded(decision.figures.get(figure.name), 4),
            "unit": QUANTITIES[figure.quantity].unit,
            "words": f"the {figure.statistic} of the {noun_of(figure.quantity)} of {figure.target} {figure.window}",
        }


def _set_thresholds(decision: Decision, rule: str) -> list[str]:
    found = decision.reasons.record_of(rule) if isinstance(decision.reasons, Reasons) else None
    return [each.key for each in found[1].thresholds] if found is not None else []


# Of what an output does; each is null where it does not have it, and all while it is out of order.
_APPLIED = ("level", "linear_mps", "angular_radps", "tilt_radps")


def _outputs(snapshot: RunSnapshot) -> Iterator[dict[str, Any]]:
    record = snapshot.record
    if record is None:
        return
    applied = {command.output: command for command in record.applied}
    faults = {fault.output: fault.reason for fault in record.observation.output_faults}
    traces = {trace.output: trace for trace in record.decision.outputs}
    for command in record.decision.commands:
        name = command.output
        yield {
            "output": name,
            "kind": "level" if isinstance(command, LevelCommand) else "motion",
            **_figures(applied.get(name), *_APPLIED),
            **_commanded(traces.get(name, OutputTrace(output=name, winner=""))),
            "fault": faults.get(name, ""),
            **_max_speeds(snapshot.plan, name),
        }


def _commanded(trace: OutputTrace) -> dict[str, Any]:
    return {name: getattr(trace, name) for name in ("winner", "reason", "losers", "held_by")}


def _max_speeds(plan: Plan | None, name: str) -> dict[str, Any]:
    outputs = plan.outputs if plan is not None else ()
    base = next((each for each in outputs if each.name == name and isinstance(each, BaseOutput)), None)
    speeds = _figures(base, "linear_max_mps", "angular_max_radps")
    return {"max_linear_mps": speeds["linear_max_mps"], "max_angular_radps": speeds["angular_max_radps"]}


def _safety(decision: Decision | None) -> dict[str, Any]:
    if decision is None:
        return {"mode": "starting", "reason": "no cycle yet"}
    return {"mode": decision.safety.value, "reason": decision.safety_reason}


def _health(snapshot: RunSnapshot) -> dict[str, Any]:
    health = snapshot.health
    median_s, p95_s = health.cycle_s
    return {
        "frame_rate_hz": _rounded(health.frame_rate_hz, 1),
        **_figures(health, "frame_age_s", "latency_s", "latency_p95_s"),
        "cycle_ms": {"p50": _milliseconds(median_s), "p95": _milliseconds(p95_s)},
        "dropped_frames": health.dropped_frames,
        "temperature_c": _rounded(health.board.temperature_c, 1),
        "throttling": health.board.throttling,
        "broker": health.broker,
        "disk_free_bytes": health.board.disk_free_bytes,
        "memory_bytes": health.board.memory_bytes,
        "trouble": health.trouble,
        "mounting": health.mounting.status.value if health.mounting is not None else None,
        "notes": [note._asdict() for note in health.notes],
    }


def _message(at_s: float, message: Message) -> dict[str, Any]:
    return {"at_s": _rounded(at_s), "topic": message.topic, "payload": message.payload}


def _pixels(point: Iterable[float]) -> list[float | None]:
    return [_rounded(each, 1) for each in point]


def _milliseconds(seconds: float | None) -> float | None:
    return None if seconds is None else _rounded(seconds * 1e3)


def _figures(known: object, *names: str, digits: int = 3) -> dict[str, float | None]:
    """Return figures by their names, rounded; null for what is not known."""
    return {name: _rounded(getattr(known, name, None), digits) for name in names}


def _rounded(value: float | None, digits: int = 3) -> float | None:
    if value is None or not math.isfinite(value):
        return None
    return round(float(value), digits)
