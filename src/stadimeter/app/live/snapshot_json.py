"""A snapshot as JSON, in parts: what all who watch get is put into words once, and only the rest for each of them.

SI units, pixels, radians. What is not known is null, never NaN: JSON has no such number.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from typing import Any

import numpy as np

from stadimeter.app.live.history import Sample, Samples, Seen
from stadimeter.app.live.snapshot import Snapshot, why
from stadimeter.core.command import Command, LevelCommand
from stadimeter.core.decision import Decision, Event, OutputTrace, RuleTrace
from stadimeter.core.detection import Detection, RejectedCandidate
from stadimeter.core.message import Message
from stadimeter.core.plan import BaseOutput, Plan
from stadimeter.core.rule import AlarmRule
from stadimeter.core.track import Track

OUTLINE_POINTS_MAX = 64
REJECTED_MAX = 8
MESSAGES_MAX = 10
SAMPLES_AT_ONCE = 100
"""So many are put into words in one go: the interpreter gives the loop its turn in between."""

_JSON = json.JSONEncoder(separators=(",", ":"), allow_nan=False)


def shared_json(snapshot: Snapshot, number: int, now_s: float, unix_offset_s: float) -> str:
    """Return what all who watch get of a snapshot, as a JSON object without the brace that closes it.

    Args:
        number: Counts the snapshots.
        now_s: The run's clock when it was taken.
        unix_offset_s: What the computer's clock is ahead of it.
    """
    record = snapshot.record
    decision = record.decision if record is not None else None
    shared = {
        "n": number,
        "now_s": _rounded(now_s),
        "unix_s": _rounded(now_s + unix_offset_s),
        "frame": frame_data(snapshot.seen, unix_offset_s),
        "targets": [_target(snapshot, track) for track in decision.tracks] if decision is not None else [],
        "rules": [_rule(snapshot, trace) for trace in decision.rules] if decision is not None else [],
        "outputs": list(_outputs(snapshot)),
        "safety": _safety(decision),
        "health": _health(snapshot),
        "messages": [_message(at_s, message) for at_s, message in snapshot.messages[:MESSAGES_MAX]],
        "recording": snapshot.recording,
        "narration": snapshot.narration,
        "run": snapshot.run,
    }
    return _JSON.encode(shared)[:-1]


def events_json(events: Iterable[Event], unix_offset_s: float) -> str:
    """Return events as a JSON list; `unix_offset_s` is what the computer's clock is ahead of the run's."""
    return _JSON.encode([_event(each, unix_offset_s) for each in events])


def samples_json(samples: Mapping[str, Samples]) -> str:
    """Return distances as a JSON object: by target a list of time, distance or null, and standard deviation."""
    return "{" + ",".join(f"{_JSON.encode(name)}:[{','.join(_listed(found))}]" for name, found in samples.items()) + "}"


def frame_data(seen: Seen | None, unix_offset_s: float) -> dict[str, Any] | None:
    """Return what is known of a frame beside its picture; None if there is none."""
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


def _listed(samples: Samples) -> Iterator[str]:
    each = iter(samples)
    while some := list(islice(each, SAMPLES_AT_ONCE)):
        yield _JSON.encode([_sample(sample) for sample in some])[1:-1]


def _sample(sample: Sample) -> list[float | None]:
    return [_rounded(sample.at_s), _rounded(sample.distance_m, 4), _rounded(sample.sigma_m, 4)]


def _target(snapshot: Snapshot, track: Track) -> dict[str, Any]:
    found = next((each for each in _detections(snapshot) if each.target == track.target), None)
    has_corners = snapshot.has_corners.get(track.target, False)
    return {
        "name": track.target,
        "status": track.status.value,
        "is_valid": track.is_valid,
        "distance_m": _rounded(track.distance_m, 4),
        "sigma_m": _rounded(track.sigma_m, 4),
        "closing_mps": _rounded(track.closing_mps, 3),
        "closing_sigma_mps": _rounded(track.closing_sigma_mps, 3),
        "bearing_rad": _rounded(track.bearing_rad, 4),
        "elevation_rad": _rounded(track.elevation_rad, 4),
        "tilt_rad": _rounded(snapshot.tilts_rad.get(track.target), 4),
        "reason": track.reason,
        "thresholds_m": [_rounded(limit_m, 4) for limit_m in snapshot.limits_m.get(track.target, ())],
        "detection": _detection(found, has_corners=has_corners) if found is not None else None,
        "rejected": [_candidate(each) for each in (found.rejected[:REJECTED_MAX] if found is not None else ())],
    }


def _detections(snapshot: Snapshot) -> tuple[Detection, ...]:
    return snapshot.seen.record.detections if snapshot.seen is not None else ()


def _detection(found: Detection, *, has_corners: bool) -> dict[str, Any]:
    return {
        "status": found.status.value,
        "reason": found.reason,
        "centre_px": _pixels(found.centre_px),
        "width_px": _rounded(found.width_px, 2),
        "height_px": _rounded(found.height_px, 2),
        "outline_px": outline_of(found, has_corners=has_corners),
        "has_corners": has_corners,
        "quality": _rounded(found.quality, 2),
    }


def _candidate(rejected: RejectedCandidate) -> dict[str, Any]:
    return {
        "centre_px": _pixels(rejected.centre_px),
        "size_px": _rounded(rejected.size_px, 1),
        "corners_px": [_pixels(corner) for corner in rejected.corners_px],
        "reason": rejected.reason,
    }


def _rule(snapshot: Snapshot, trace: RuleTrace) -> dict[str, Any]:
    rules = snapshot.plan.rules if snapshot.plan is not None else ()
    rule = next((each for each in rules if each.name == trace.rule), None)
    alarm = rule if isinstance(rule, AlarmRule) else None
    return {
        "rule": trace.rule,
        "status": trace.status.value,
        "active": trace.active,
        "acknowledged": trace.acknowledged,
        "gates": trace.gates,
        "chattering": trace.chattering,
        "first_out": trace.first_out,
        "output": trace.output,
        "target": rule.target if rule is not None else "",
        "severity": rule.severity.value if rule is not None else "",
        "is_alarm": alarm is not None,
        "needs_ack": alarm is not None and alarm.needs_ack,
        "latches": alarm is not None and alarm.latch,
        "reason": why(snapshot.record.decision, trace.rule) if snapshot.record is not None else "",
    }


def _outputs(snapshot: Snapshot) -> Iterator[dict[str, Any]]:
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
            **_value(command, applied.get(name)),
            **_commanded(traces.get(name)),
            "fault": faults.get(name, ""),
            **_most(snapshot.plan, name),
        }


def _value(asked: Command, applied: Command | None) -> dict[str, Any]:
    """Return what an output really does; null if nobody knows, for it is out of order."""
    is_level = isinstance(asked, LevelCommand)
    return {
        "kind": "level" if is_level else "motion",
        "level": _rounded(getattr(applied, "level", None), 3),
        "linear_mps": _rounded(getattr(applied, "linear_mps", None), 3),
        "angular_radps": _rounded(getattr(applied, "angular_radps", None), 3),
    }


def _commanded(trace: OutputTrace | None) -> dict[str, Any]:
    if trace is None:
        return {"winner": "", "reason": "", "losers": (), "held_by": ""}
    return {"winner": trace.winner, "reason": trace.reason, "losers": trace.losers, "held_by": trace.held_by}


def _most(plan: Plan | None, name: str) -> dict[str, Any]:
    found = next((each for each in plan.outputs if each.name == name), None) if plan is not None else None
    base = found if isinstance(found, BaseOutput) else None
    return {
        "max_linear_mps": _rounded(base.linear_max_mps if base is not None else None),
        "max_angular_radps": _rounded(base.angular_max_radps if base is not None else None),
    }


def _safety(decision: Decision | None) -> dict[str, Any]:
    if decision is None:
        return {"mode": "starting", "reason": "no cycle yet"}
    return {"mode": decision.safety.value, "reason": decision.safety_reason}


def _health(snapshot: Snapshot) -> dict[str, Any]:
    health = snapshot.health
    median_s, p95_s = health.cycle_s
    return {
        "frame_rate_hz": _rounded(health.frame_rate_hz, 1),
        "frame_age_s": _rounded(health.frame_age_s),
        "latency_s": _rounded(health.latency_s),
        "cycle_ms": {"p50": _milliseconds(median_s), "p95": _milliseconds(p95_s)},
        "dropped_frames": health.dropped_frames,
        "temperature_c": _rounded(health.board.temperature_c, 1),
        "throttling": health.board.throttling,
        "broker": health.broker,
        "disk_free_bytes": health.board.disk_free_bytes,
        "memory_bytes": health.board.memory_bytes,
        "trouble": health.trouble,
        "notes": [{"what": note.what, "words": note.words, "is_good": note.is_good} for note in health.notes],
    }


def _event(event: Event, unix_offset_s: float) -> dict[str, Any]:
    return {
        "number": event.sequence,
        "at_s": _rounded(event.at_s),
        "unix_s": _rounded(event.at_s + unix_offset_s),
        "kind": event.kind.value,
        "source": event.source,
        "severity": event.severity.value,
        "reason": event.reason,
        "by": event.by,
    }


def _message(at_s: float, message: Message) -> dict[str, Any]:
    return {"at_s": _rounded(at_s), "topic": message.topic, "payload": message.payload}


def _pixels(point: Iterable[float]) -> list[float | None]:
    return [_rounded(each, 1) for each in point]


def _milliseconds(seconds: float | None) -> float | None:
    return None if seconds is None else _rounded(seconds * 1e3)


def _rounded(value: float | None, digits: int = 3) -> float | None:
    if value is None or not math.isfinite(value):
        return None
    return round(float(value), digits)
