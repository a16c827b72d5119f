"""The figures of a run as metric families of Prometheus, for programs that keep them.

What is not known is left out: a 0 would say that a rule does not act. So is what a loop that hangs found last.
Names follow https://prometheus.io/docs/practices/naming/.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from enum import StrEnum
from typing import Any, NamedTuple

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.live.health import CONNECTED, LiveHealth
from stadimeter.app.live.history import RunHistory
from stadimeter.app.live.snapshot import LiveFeed
from stadimeter.core.decision import EventKind, RuleStatus, SafetyMode
from stadimeter.core.measurement import TrackStatus

# Figures of a cycle older than this are not those of now: outputs are at their safe values long before.
STALE_S = 2.0

_Values = Iterable[tuple[Mapping[str, str], float | None]]


class Family(NamedTuple):
    """A metric with its samples: what follows its name, the labels, and the value of each."""

    name: str
    kind: str
    about: str
    samples: Sequence[tuple[str, Mapping[str, str], float]]


def metric_families(feed: LiveFeed, deliveries: Callable[[], Sequence[Mapping[str, Any]]]) -> list[Family]:
    """Return all that is known of a run now. May be called from any thread; it does not ask the loop."""
    snapshot, history = feed.snapshot(0.0), feed.history
    health, cycle_age_s = snapshot.health, feed.cycle_age_s() if history.cycles else None
    run = snapshot.run
    about = {"version": str(run.get("version")), "configuration": str(run.get("title"))}
    found = [
        _labelled("build_info", "What runs: always 1.", [(about, 1.0)]),
        _gauge("start_time_seconds", "When the run began, since 1970.", run.get("started_unix_s")),
        _gauge("cycle_age_seconds", "Age of the newest cycle: it grows while the loop hangs.", cycle_age_s),
        _gauge("frame_age_seconds", "Age of the newest picture.", _sum(health.frame_age_s, cycle_age_s)),
        *_counters(history),
        *_times(history, health),
        *_deliveries(deliveries()),
        *_board(health),
    ]
    if snapshot.record is not None and cycle_age_s is not None and cycle_age_s <= STALE_S:
        found += [_gauge("frame_rate_hertz", "Pictures a second, of late.", health.frame_rate_hz)]
        found += [*_targets(snapshot.record), *_rules(snapshot.record), *_outputs(snapshot.record)]
    return [each for each in found if each.samples]


def _counters(history: RunHistory) -> Iterator[Family]:
    yield _labelled("cycles", "Cycles since the start.", [({}, history.cycles)], "counter")
    yield _labelled("frames", "Pictures that a cycle took.", [({}, history.frames)], "counter")
    yield _labelled("frames_dropped", "Pictures that no cycle took.", [({}, history.dropped_frames)], "counter")
    counts = [({"kind": kind.value}, float(history.event_counts[kind.value])) for kind in EventKind]
    yield _labelled("events", "Events since the start.", counts, "counter")


def _times(history: RunHistory, health: LiveHealth) -> Iterator[Family]:
    """Yield summaries: quantiles of the newest pictures, count and sum of all."""
    busy, late = "Computing time of a cycle with a picture.", "From the capture of a picture to its commands."
    for name, about, sum_s, (median_s, p95_s) in (
        ("cycle_seconds", busy, history.cycle_times_sum_s, health.cycle_s),
        ("latency_seconds", late, history.data_ages_sum_s, (health.latency_s, health.latency_p95_s)),
    ):
        quantiles = [({"quantile": "0.5"}, median_s), ({"quantile": "0.95"}, p95_s)]
        family = _labelled(name, about, quantiles, "summary")
        yield family._replace(samples=[*family.samples, ("_sum", {}, sum_s), ("_count", {}, float(history.frames))])


def _deliveries(figures: Sequence[Mapping[str, Any]]) -> Iterator[Family]:
    waiting = [({"to": each["to"]}, each["waiting"]) for each in figures]
    yield _labelled("deliveries_waiting", "Messages and notifications that are not delivered yet.", waiting)
    given_up = [({"to": each["to"]}, each["given_up"]) for each in figures]
    yield _labelled("deliveries_given_up", "Messages and notifications given up.", given_up, "counter")


def _board(health: LiveHealth) -> Iterator[Family]:
    board = health.board
    throttling = [({"reason": words}, 1.0) for words in board.throttling]
    yield _gauge("processor_temperature_celsius", "Temperature of the processor.", board.temperature_c)
    yield _labelled("processor_throttled", "What is wrong with supply and heat now; absent if unknown.", throttling)
    yield _gauge("disk_free_bytes", "Free space where the configuration is.", board.disk_free_bytes)
    yield _gauge("resident_memory_bytes", "Memory in use by the run.", board.memory_bytes)
    is_connected = health.broker == CONNECTED if health.broker else None
    yield _gauge("broker_connected", "Whether the broker is connected; absent without one.", is_connected)


def _targets(record: CycleRecord) -> Iterator[Family]:
    tracks = record.decision.tracks
    valid = [({"target": each.target}, each) for each in tracks if each.is_valid]
    for name, about, attribute in (
        ("distance_meters", "Filtered distance; absent while none may be acted on.", "distance_m"),
        ("distance_sigma_meters", "Standard deviation of the distance.", "sigma_m"),
        ("closing_meters_per_second", "Speed of approach.", "closing_mps"),
    ):
        yield _labelled(f"target_{name}", about, [(labels, getattr(each, attribute)) for labels, each in valid])
    statuses = [({"target": each.target}, each.status) for each in tracks]
    yield _states("target_status", "Whether a target is tracked.", "status", TrackStatus, statuses)


def _rules(record: CycleRecord) -> Iterator[Family]:
    rules = [({"rule": each.rule}, each) for each in record.decision.rules]
    active = [(labels, each.active_or_unknown) for labels, each in rules]
    yield _labelled("rule_active", "Whether a rule is active; absent while that is unknown.", active)
    statuses = [(labels, each.status) for labels, each in rules]
    yield _states("rule_status", "What a rule is doing.", "status", RuleStatus, statuses)
    unseen = [(labels, not each.acknowledged) for labels, each in rules]
    yield _labelled("rule_unacknowledged", "Whether an alarm waits for a person.", unseen)
    inhibited = [(labels, bool(each.inhibits)) for labels, each in rules]
    yield _labelled("rule_inhibited", "Whether it is shelved, suppressed, out of service or only observed.", inhibited)


def _outputs(record: CycleRecord) -> Iterator[Family]:
    faulty = {fault.output for fault in record.observation.output_faults}
    faults = [({"output": each.output}, each.output in faulty) for each in record.decision.commands]
    yield _labelled("output_fault", "Whether an output is out of order.", faults)
    about = "Whether outputs may act: active, or why not."
    yield _states("safety_mode", about, "mode", SafetyMode, [({}, record.decision.safety)])


def _states(
    name: str, about: str, label: str, states: Iterable[StrEnum], found: Iterable[tuple[Mapping[str, str], StrEnum]]
) -> Family:
    """Return a state set: a sample for each state, 1 for the one that is."""
    every = tuple(states)
    values = [({**labels, label: each.value}, each is now) for labels, now in found for each in every]
    return _labelled(name, about, values)


def _gauge(name: str, about: str, value: Any) -> Family:
    return _labelled(name, about, [({}, value)])


def _labelled(name: str, about: str, values: _Values, kind: str = "gauge") -> Family:
    suffix = "_total" if kind == "counter" else ""
    known = [(suffix, labels, float(value)) for labels, value in values if value is not None and math.isfinite(value)]
    return Family(f"stadimeter_{name}", kind, about, known)


def _sum(first_s: float | None, second_s: float | None) -> float | None:
    return None if first_s is None or second_s is None else first_s + second_s
